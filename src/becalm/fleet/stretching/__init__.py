"""Clean a very long recording in stretches of time: each warms up on the rows before it, and the seams are checked."""
