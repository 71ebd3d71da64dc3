"""Web pages: the tuner, and the live page of a stream. Only this machine can open them, and only with a token."""
