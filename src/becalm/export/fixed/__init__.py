"""Export a settled gain in fixed point.

It is the filter of `settled` in integers, and is compared with that one's specification; no other folder here imports
from another.
"""
