"""Write clean recordings, at once or chunk by chunk."""
