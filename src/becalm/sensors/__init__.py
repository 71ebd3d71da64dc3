"""Convert the output of sensors, in volts or counts, to the measured quantity."""
