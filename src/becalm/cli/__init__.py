"""A thin sheet over all of it: data to stdout, talk to stderr, exit codes on the errors."""
