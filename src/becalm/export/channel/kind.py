"""Export a channel as the library's own C: a single filter, with or without a gate, or an IMM."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from becalm.cleaning.channels.causal_channel import CausalChannel
from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.errors import RecipeError
from becalm.export.channel.modes_text import modes_interface
from becalm.export.channel.reference import ChannelReference, ModesReference
from becalm.export.channel.text import channel_interface, write_interface
from becalm.export.design import Design
from becalm.export.kind import Floating, Span
from becalm.export.number_type import NumberType
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Reference

_LEAST_IN_FLOAT, _MOST_IN_FLOAT = 1e-30, 1e15  # range of the noise's standard deviation in float, in unit


class Sizes(NamedTuple):
    """The array sizes of all filters of one export."""

    states: frozenset[int]  # numbers of states of the single filters
    mode_states: frozenset[int]  # numbers of states of the IMMs
    modes: int  # largest number of modes, rounded up to an even number because two modes run at a time

    @property
    def most_states(self) -> int:
        """Return the number of states of the largest filter."""
        return max(self.states | self.mode_states)

    @classmethod
    def of(cls, designs: Iterable[Design]) -> Sizes:
        """Return the sizes for these filters."""
        all_designs = list(designs)
        modes = [len(one.modes.modes) for one in all_designs if one.modes is not None]
        return cls(
            frozenset(one.states for one in all_designs if one.modes is None),
            frozenset(one.states for one in all_designs if one.modes is not None),
            2 * ((max(modes, default=1) + 1) // 2),
        )


@dataclass(frozen=True)
class WholeChannel(Floating):
    """The library's own channel, with limits, gate or modes, covariance, and sensor monitoring.

    Attributes
    ----------
    recipe : ChannelRecipe
        Recipe of the channel.
    sizes : Sizes
        Array sizes of all filters of the export.
    """

    recipe: ChannelRecipe
    sizes: Sizes

    @classmethod
    def for_design(cls, number: NumberType, recipe: ChannelRecipe, design: Design) -> WholeChannel:
        """Return the kind of a filter that is the only one of its export."""
        return cls(number, recipe, Sizes.of([design]))

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter as C.

        Raises
        ------
        RecipeError
            If float cannot represent the noise of the readings.
        """
        if not self.number.is_double and not _LEAST_IN_FLOAT <= design.noise_std <= _MOST_IN_FLOAT:
            raise RecipeError(
                f"{design.name}: its noise is {design.noise_std:.3g}{design.unit_after}; float can represent one from"
                f" {_LEAST_IN_FLOAT:g} to {_MOST_IN_FLOAT:g}{design.unit_after}. Use --precision float64."
            )
        settings, most_states = self._settings(design), self.sizes.most_states
        largest = min(design.largest, settings.limits.largest)
        if design.modes is None:
            interface = channel_interface(design, settings, most_states)
        else:
            gap_limit = Filter(self.recipe, design.step_s, 0).gap_limit
            interface = modes_interface(design.modes, settings, gap_limit, prefix, (most_states, self.sizes.modes))
        return write_interface(interface, design, prefix, self.number, largest)

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return a new reference, with which the C filter is compared."""
        if design.modes is None:
            return ChannelReference(self._settings(design))
        return ModesReference(self._limited_recipe(), design.step_s)

    def _settings(self, design: Design) -> ChannelSettings:
        return CausalChannel(self._limited_recipe(), design.step_s).settings

    def _limited_recipe(self) -> ChannelRecipe:
        """Return the recipe, with its largest valid reading limited to `greatest` of the number type."""
        limits, greatest = self.recipe.limits or LimitsRecipe(), self.number.greatest
        limits_recipe = limits.model_copy(update={"largest": min(limits.largest or greatest, greatest)})
        return self.recipe.model_copy(update={"limits": limits_recipe})
