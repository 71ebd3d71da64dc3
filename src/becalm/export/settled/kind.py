"""Export a settled gain after a table of gains in floating point."""

from __future__ import annotations

from becalm.cleaning.recipe import ChannelRecipe
from becalm.export.design import Design
from becalm.export.kind import Floating, Span, apart
from becalm.export.settled.reference import SettledReference
from becalm.export.settled.text import schedule_in, written_settled
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Reference


class Settled(Floating):
    """The kind of filter with a settled gain after a table of gains, in floating point."""

    @property
    def bridges(self) -> bool:
        """Return whether it continues after missing readings as becalm does: False, without a covariance."""
        return False

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter as C; `span` is the least and the greatest reading, in unit, if they are known.

        Raises
        ------
        RecipeError
            If the filter has no steady state, or its word length is too short.
        """
        return written_settled(design, prefix, self.number, apart(span))

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return a new reference that the filter is compared with."""
        return SettledReference(design, schedule_in(design, self.number), written.largest)
