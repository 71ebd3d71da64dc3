"""The mathematics, on arrays only: this package does not know files, users or networks."""
