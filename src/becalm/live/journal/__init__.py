"""The journal, the default sink: rows, state and position in one SQLite transaction, later moved to Parquet files."""
