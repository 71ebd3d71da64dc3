"""Read a folder of Parquet files as one recording, as Spark, Hive, Delta and people write them."""
