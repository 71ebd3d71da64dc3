"""The honest competitors: what people use today."""
