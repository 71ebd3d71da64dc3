"""Export a filter with a table of gains and then a settled gain, in floating point."""

from __future__ import annotations

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.export.design import Design
from becalm.export.kind import Floating, Span, distance_bound
from becalm.export.settled.reference import SettledReference
from becalm.export.settled.text import schedule_in, write_settled
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Reference


class Settled(Floating):
    """The kind of filter with a table of gains and then a settled gain, in floating point."""

    @property
    def has_covariance(self) -> bool:
        """Return whether the filter has a covariance, so that it treats missing readings as becalm does: False."""
        return False

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter as C; `span` is the least and the greatest reading, in unit, or None if they are unknown.

        Raises
        ------
        RecipeError
            If the filter has no steady state, or the word length of the number type is too short.
        """
        return write_settled(design, prefix, self.number, distance_bound(span))

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return a new reference, with which the C filter is compared."""
        return SettledReference(design, schedule_in(design, self.number), written.largest)
