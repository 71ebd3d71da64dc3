"""Where the real recordings lie that the studies look at; where they do not, a study says so and goes on."""

from __future__ import annotations

from pathlib import Path

RECORDINGS = Path(__file__).parents[4] / "shared" / "data"
"""Beside a working copy of the project."""
