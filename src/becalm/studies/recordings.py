"""Name the folder of the real recordings; a study leaves out recordings that are missing, and says so."""

from __future__ import annotations

from pathlib import Path

RECORDINGS = Path(__file__).parents[4] / "shared" / "data"
"""Folder of recordings, next to a working copy of the project."""
