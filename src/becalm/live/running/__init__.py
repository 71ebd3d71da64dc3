"""Run a stream: read, queue, filter and commit in threads; start it, and change its recipe."""
