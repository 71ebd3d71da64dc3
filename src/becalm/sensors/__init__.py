"""From what a sensor puts out, volts or counts, to what it measures."""
