"""Sensors that share files: told apart by columns, and brought together through files that tasks leave each other.

There are three kinds of tasks: the first reads the columns that tell sensors apart, and nothing else; the second parts
the rows of files into strips, each of one sensor and in the order of time; the third merges the strips of a sensor into
one file, from which it is cleaned as any other, long ones in stretches of time. So values, types and units are those of
the lake, and rows of equal times stay in the order of the files' names and of the rows in these. The staging takes as
much room beside the output as the lake does.

No sample passes through Spark, whose own sort and shuffle cost more, and which reads no nanoseconds, no unsigned
numbers of 64 bits and no units as they are.
"""
