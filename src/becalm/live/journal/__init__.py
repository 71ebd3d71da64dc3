"""The embedded default sink: rows, state and position in one transaction, rolled into Parquet."""
