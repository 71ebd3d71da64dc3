"""A full covariance, in floating point."""

from __future__ import annotations

from becalm.cleaning.recipe import ChannelRecipe
from becalm.export.design import Design
from becalm.export.full.reference import FullReference
from becalm.export.full.text import written_full
from becalm.export.kind import Floating, Span, apart
from becalm.export.vectors import Reference
from becalm.export.written import Written


class Full(Floating):
    """A covariance that is carried: for gates, for filters that never settle, and for readings that go missing."""

    def write(self, design: Design, prefix: str, span: Span | None) -> Written:
        """Write a filter."""
        return written_full(design, prefix, self.number, apart(span))

    def reference(self, recipe: ChannelRecipe, design: Design, written: Written) -> Reference:
        """Return what it is held against, at the start."""
        return FullReference(recipe, design, written.largest)
