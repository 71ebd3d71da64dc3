"""What text says: cells as numbers, headers as names and units, and what cannot be understood."""
