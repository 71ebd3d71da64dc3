"""A full covariance, in floating point."""

from __future__ import annotations

from becalm.export.kind import Floating


class Full(Floating):
    """To be."""
