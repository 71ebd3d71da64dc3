"""Classic filters, for comparison with the Kalman filter."""
