"""What a browser sees: a page to tune on, and one that watches a stream; open to this machine only, with a token."""
