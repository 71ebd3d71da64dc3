"""A switching bank, in floating point."""

from __future__ import annotations

from becalm.export.kind import Floating


class Bank(Floating):
    """To be."""
