"""Repeat the studies of three papers, with simulations in place of recordings that are not public."""
