"""How a signal is judged: with truth, and without."""
