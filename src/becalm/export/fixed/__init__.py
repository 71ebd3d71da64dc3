"""A settled gain in whole numbers.

It is the filter of `settled` in other numbers, and is held against that one's specification: this room alone imports
from another.
"""
