"""The commands of the command line, one module each; a command is imported when it runs."""
