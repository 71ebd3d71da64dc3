"""Clean sensors that share files: columns identify them, and temporary files gather the rows of each.

There are three kinds of tasks. The first counts the rows of each sensor, and reads only the columns that identify
sensors. The second splits the rows of files into strips, each of one sensor and in the order of time. The third merges
the strips of a sensor into one file, from which it is cleaned like any other sensor; long ones are cleaned in stretches
of time. Values, types and units stay those of the lake. Rows of equal times stay in the order of the files' names, and
of the rows in them. The temporary files are next to the output. They need about as much disk space as the lake; those
of long sensors need twice as much.

No sample passes through Spark. Spark's own sort and shuffle cost more, and it does not preserve nanoseconds, unsigned
64-bit integers or units.
"""
