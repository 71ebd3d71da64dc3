"""State-space models of signals, and the matrices that filters need from them."""
