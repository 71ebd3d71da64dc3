"""A settled gain in fixed point."""

from __future__ import annotations


class Fixed:
    """To be."""
