"""Export a settled gain after a table of gains, without covariance or division."""
