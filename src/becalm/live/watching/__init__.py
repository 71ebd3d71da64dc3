"""Whoever looks at a stream from outside: counts, a status file, metrics, logs, and what notices a standstill."""
