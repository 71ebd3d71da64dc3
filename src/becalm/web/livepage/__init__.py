"""The live page: what it shows of a stream, and how it is told."""
