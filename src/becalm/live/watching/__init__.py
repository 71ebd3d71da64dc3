"""Monitor a stream: counts, a status file, metrics, logs and a watchdog."""
