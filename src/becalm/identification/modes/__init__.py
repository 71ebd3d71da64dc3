"""Several modes of a channel: which a record shows, and what each is."""
