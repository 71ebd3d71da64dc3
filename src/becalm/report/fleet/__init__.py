"""The report on a fleet: its rows, their order, and its page."""
