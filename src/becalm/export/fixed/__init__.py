"""Export a filter with a settled gain in fixed point.

It is the filter of the folder `settled`, in integers. Its reference is that of `settled`, with the integers' limits.
"""
