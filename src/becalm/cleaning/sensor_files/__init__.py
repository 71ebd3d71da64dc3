"""Sensor files: the calibration of each sensor, and the calibration of an accelerometer from rests in many poses."""
