"""The command line. Data go to stdout and messages to stderr; an exception's class determines the exit code."""
