"""What is wrong with a sensor, its measurements and its noise."""
