"""Web pages: the tuner, and the live page of a stream. A browser needs a token to open them."""
