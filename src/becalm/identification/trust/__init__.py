"""How far a tuning may be trusted: what it does not know, and how long errors last."""
