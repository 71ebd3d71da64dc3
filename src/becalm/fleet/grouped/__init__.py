"""Clean sensors that share files: columns identify the sensors, and temporary files gather the rows of each sensor.

There are three kinds of tasks. The first kind counts the rows of each sensor in a file; it reads only the columns that
identify sensors. The second kind splits a file into strips: a strip has rows of one sensor, sorted by time. The third
kind merges the strips of a sensor into one file and cleans this file like any other; long sensors are cleaned in
stretches of time. Values, types and units are the same as in the lake. Rows of equal times keep the order of the files'
names, and within a file the order of its rows. The temporary files are next to the output. They need about as much disk
space as the lake; for long sensors they need twice as much.

No sample passes through Spark. Spark's own sort and shuffle cost more, and Spark does not preserve nanoseconds,
unsigned 64-bit integers or units.
"""
