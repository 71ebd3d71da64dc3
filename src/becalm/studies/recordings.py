"""Name the folder of the real recordings for the studies; a study leaves out what is absent, and says so."""

from __future__ import annotations

from pathlib import Path

RECORDINGS = Path(__file__).parents[4] / "shared" / "data"
"""Folder next to a working copy of the project."""
