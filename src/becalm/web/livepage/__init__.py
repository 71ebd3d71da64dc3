"""The live page, which shows a stream while it runs."""
