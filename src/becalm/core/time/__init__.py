"""The times of measurements: clocks, time stamps, and faults of loggers."""
