"""A settled gain after a table of gains, in floating point."""

from __future__ import annotations

from becalm.cleaning.recipe import ChannelRecipe
from becalm.export.design import Design
from becalm.export.kind import Floating, Span, apart
from becalm.export.settled.reference import SettledReference
from becalm.export.settled.text import schedule_in, written_settled
from becalm.export.vectors import Reference
from becalm.export.written import WrittenChannel


class Settled(Floating):
    """A settled gain after a table of gains."""

    @property
    def bridges(self) -> bool:
        """Whether it goes on after missing readings as becalm does: it keeps its gain."""
        return False

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter."""
        return written_settled(design, prefix, self.number, apart(span))

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return what it is held against, at the start."""
        return SettledReference(design, schedule_in(design, self.number), written.largest)
