"""Clean sensors that share files: columns identify them, and temporary files bring the rows of each together.

There are three kinds of tasks. The first reads only the columns that identify sensors. The second splits the rows of
files into strips, each of one sensor and in the order of time. The third merges the strips of a sensor into one file,
from which it is cleaned like any other sensor; long ones are cleaned in stretches of time. Values, types and units stay
those of the lake, and rows of equal times stay in the order of the files' names and of the rows in them. The temporary
files need as much disk space, next to the output, as the lake.

No sample passes through Spark. Spark's own sort and shuffle cost more, and it does not preserve nanoseconds, unsigned
64-bit integers or units.
"""
