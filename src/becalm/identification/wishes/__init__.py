"""What a person asks for: one dial, what noise left costs in lag, what a delay buys."""
