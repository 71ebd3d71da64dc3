"""The papers re-run, and the simulations that stand in for recordings that are not public."""
