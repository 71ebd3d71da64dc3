"""Open a recording of any length, with one time base or several."""
