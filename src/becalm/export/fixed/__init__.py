"""Export a settled gain in fixed point.

It is the filter of `settled` in integers; its reference is that of `settled`, with the limits of the integers.
"""
