"""When measurements were taken: clocks, stamps, and what loggers do to them."""
