"""The command line: data on stdout, messages on stderr, exit codes from the exceptions."""
