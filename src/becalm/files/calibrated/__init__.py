"""Read a file with the calibrations of its sensors, and apply another calibration to a clean file."""
