"""What tests take from files: their tables."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from becalm.files.source import RawTable

Tables = Callable[[Path], tuple[RawTable, ...]]
