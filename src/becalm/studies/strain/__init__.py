"""The strain paper."""
