"""Models of signals in state space, and what is made of them."""
