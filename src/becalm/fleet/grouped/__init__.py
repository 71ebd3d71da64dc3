"""Sensors that share files: told apart by columns, brought together through files that tasks hand to each other.

Three kinds of tasks: the first reads the columns that tell sensors apart, and nothing else; the second parts the rows
of files into strips, each of one sensor and in the order of time; the third merges the strips of a sensor into one
file, from which it is cleaned as any other. So values, types and units are those of the lake, rows of equal times stay
in the order of their files and of the rows in these, and no sample passes through Spark.
"""
