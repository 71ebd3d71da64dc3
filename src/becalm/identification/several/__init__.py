"""Several channels together: full Q and R, and the paper's cost of one."""
