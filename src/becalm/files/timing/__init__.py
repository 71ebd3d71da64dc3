"""When rows were: the time column, what it says, and what loggers did to it."""
