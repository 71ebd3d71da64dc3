"""Where Q and R come from."""
