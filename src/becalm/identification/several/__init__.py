"""Identify Q and R: of a model with several channels by likelihood, or of an IMU by step and spectrum."""
