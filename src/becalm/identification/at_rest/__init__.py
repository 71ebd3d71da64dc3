"""Identify the noise of a sensor at rest: find rests, measure R and Allan deviations, convert datasheet numbers."""
