"""Folders of Parquet files that are one recording, as Spark, Hive, Delta and people leave them."""
