"""Write a recipe's filters as C: make the texts of all files of a bundle, by their paths.

A bundle contains the filters, golden vectors, a program that runs the vectors, layouts for other tools and a README.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.core.arrays import Floats
from becalm.errors import RecipeError, UsageError
from becalm.export.channel.kind import Sizes, WholeChannel
from becalm.export.channel.sources import OWN_NAMES, sources_of
from becalm.export.design import Design, design_of
from becalm.export.facts import cost_words, facts_of, reset_words
from becalm.export.kind import Kind, NewReference, Raw, Span
from becalm.export.kinds import kind_of
from becalm.export.layouts import layouts
from becalm.export.naming import comment, identifier, identifiers
from becalm.export.number_type import FLOAT, Precision
from becalm.export.shared_parts import WrittenChannel, channel_context
from becalm.export.templates import render
from becalm.export.vector_text import bits_of, vector_texts
from becalm.export.vectors import Vector, extremes, golden_vectors
from becalm.export.word_length import refuse_coarse
from becalm.installation import version

_LARGEST_UHZ = (1 << 62) - 1  # largest rate that the C code contains, in microhertz


class ExportOptions(NamedTuple):
    """The options of an export.

    Attributes
    ----------
    precision : {"float32", "float64", "q31"}
        Number type of the filters.
    gain : {"auto", "settled", "full"}
        "full" is a filter with a covariance, "settled" one without; with "auto", `kind_of` chooses.
    channels : tuple of str or None
        Names of the channels to export; None for all channels that are filtered.
    spans : mapping of str to (float, float)
        Least and greatest reading by channel, in unit; by default the saturation limits of the recipe, if any.
    recorded : mapping of str to (N,) float array
        Readings of a real recording by channel, in unit; a golden vector is made from them.
    """

    precision: Precision = "float32"
    gain: str = "auto"
    channels: tuple[str, ...] | None = None
    spans: Mapping[str, Span] = {}
    recorded: Mapping[str, Floats] = {}


class Exported(NamedTuple):
    """One exported channel."""

    name: str
    prefix: str  # of the channel's names in C
    design: Design
    kind: Kind
    written: WrittenChannel
    vectors: list[Vector]
    new_reference: NewReference
    jump_ends: Raw  # (2,) least and greatest reading of a check whose readings jump between the two


class Bundle(NamedTuple):
    """An export in C.

    Attributes
    ----------
    stem : str
        Prefix of file names and C names.
    files : dict of str to str
        Texts by their paths.
    channels : list of Exported
        The channels, in the order of the recipe.
    notes : list of str
        Notes for the user.
    """

    stem: str
    files: dict[str, str]
    channels: list[Exported]
    notes: list[str]

    @property
    def needs_nan(self) -> bool:
        """Return whether the C tests for NaN in a way that -ffast-math breaks, so that this flag must not be used."""
        return any(isinstance(one.kind, WholeChannel) for one in self.channels)


def bundle_of(recipe: Recipe, name: str, options: ExportOptions) -> Bundle:
    """Write a recipe's filters as C.

    Parameters
    ----------
    recipe : Recipe
        Recipe of the channels.
    name : str
        Name of the recipe; file names and C names are made from it.
    options : ExportOptions
        The options of the export.

    Raises
    ------
    RecipeError
        If no channel is filtered, the numbers of the recipe do not make a valid filter, or the precision or the gain
        does not support a filter.
    UsageError
        If a channel is not in the recipe, or the precision or the gain does not exist.
    """
    stem, (filtered, notes) = stem_of(name), choose_channels(recipe, options.channels)
    prefixes = identifiers((f"{stem}_{channel.name}" for channel, _ in filtered), stem)
    kinds = [kind_of(channel, design, options.precision, options.gain) for channel, design in filtered]
    sizes = Sizes.of(
        design for (_, design), kind in zip(filtered, kinds, strict=True) if isinstance(kind, WholeChannel)
    )
    channels = [
        _export(
            channel, design, prefix, replace(kind, sizes=sizes) if isinstance(kind, WholeChannel) else kind, options
        )
        for (channel, design), prefix, kind in zip(filtered, prefixes, kinds, strict=True)
    ]
    texts = _files(recipe, name, stem, options, channels, notes, sources_of(sizes, stem))
    return Bundle(stem, texts, channels, notes)


def stem_of(name: str) -> str:
    """Return the prefix of file names and C names; it differs from the prefixes of the library's own C."""
    stem = identifier(name, "filters")
    return f"{stem}_filters" if stem in OWN_NAMES else stem


def choose_channels(
    recipe: Recipe, channels: Sequence[str] | None
) -> tuple[list[tuple[ChannelRecipe, Design]], list[str]]:
    """Return the channels to export with their filters, and notes for the user.

    Raises
    ------
    RecipeError
        If no channel is filtered, or the numbers of a channel do not make a valid filter.
    UsageError
        If a channel is not in the recipe.
    """
    names, step_s = [channel.name for channel in recipe.channel], 1 / recipe.nominal_rate_hz
    if missing := [name for name in channels or () if name not in names]:
        raise UsageError(f"The recipe has no channel {missing[0]!r}; it has {', '.join(names)}.")
    notes, filtered = [], []
    if recipe.mode != "causal":
        notes.append(
            f"The recipe is {recipe.mode}, but a controller knows only the past: the export is the causal filter, as in"
            " becalm live. To tune a filter for causal use: becalm tune FILE --causal."
        )
    for channel in recipe.channel:
        if channels is not None and channel.name not in channels:
            continue
        design = design_of(channel, step_s)
        if design is None:
            notes.append(f"{channel.name} passes unchanged, and is left out.")
        else:
            filtered.append((channel, design))
    if not filtered:
        raise RecipeError("No channel of the recipe is filtered, so there is nothing to export.")
    return filtered, notes


def _export(channel: ChannelRecipe, design: Design, prefix: str, kind: Kind, options: ExportOptions) -> Exported:
    low, high = design.limits.rails
    span = options.spans.get(channel.name, (low, high) if np.isfinite(high - low) else None)
    if span is not None and kind.number is FLOAT:
        refuse_coarse(design, kind.number, span)
    written = kind.write(design, prefix, span)
    new_reference = partial(kind.reference, channel, design, written)

    def rounded(readings: Floats) -> Floats:
        """Round readings to those that the C code can take."""
        return kind.in_unit(kind.raw(readings, written), written)

    vectors = golden_vectors(design, rounded, new_reference, options.recorded.get(channel.name))
    jump_ends = kind.raw(extremes(design, span, written.largest), written)
    return Exported(channel.name, prefix, design, kind, written, vectors, new_reference, jump_ends)


def _files(  # noqa: PLR0913
    recipe: Recipe,
    name: str,
    stem: str,
    options: ExportOptions,
    channels: Sequence[Exported],
    notes: Sequence[str],
    native: Mapping[str, str],
) -> dict[str, str]:
    """Return the texts of all files of a bundle, by their paths."""
    context = _context(recipe, name, stem, options, channels, notes)
    context["native"] = [path for path in native if path.endswith(".c")]
    context["native_headers"] = [path for path in native if path.endswith(".h")]
    vectors = render("vectors.h.jinja", context)
    context["vectors_hash"] = hashlib.sha256(vectors.encode()).hexdigest()
    templates = {
        "becalm.h": "becalm.h.jinja",
        f"{stem}.h": "header.h.jinja",
        f"{stem}.c": "source.c.jinja",
        "main.c": "main.c.jinja",
        "Makefile": "Makefile.jinja",
        "README.md": "README.md.jinja",
    }
    texts = {f"{stem}_vectors.h": vectors} | {path: render(template, context) for path, template in templates.items()}
    return texts | layouts(context, native) | dict(native)


def _context(  # noqa: PLR0913
    recipe: Recipe, name: str, stem: str, options: ExportOptions, channels: Sequence[Exported], notes: Sequence[str]
) -> dict[str, Any]:
    rate_hz = recipe.nominal_rate_hz
    return {
        "title": comment(name),
        "recipe_name": comment(name),
        "stem": stem,
        "guard": stem.upper(),
        "version": version(),
        "recipe_hash": hashlib.sha256(recipe.to_toml().encode()).hexdigest(),
        "rate_hz": f"{rate_hz:.9g}",
        "step_s": f"{1 / rate_hz:.9g}",
        "rate_uhz": f"{min(round(rate_hz * 1e6), _LARGEST_UHZ)}ULL"
        if rate_hz * 1e6 > 4e9
        else f"{round(rate_hz * 1e6)}UL",
        "precision": options.precision,
        "notes": [comment(note) for note in notes],
        "reals": channels[0].kind.words,
        "channels": [_channel(one, recipe) for one in channels],
    }


def _channel(one: Exported, recipe: Recipe) -> dict[str, Any]:
    (channel_recipe,) = (channel for channel in recipe.channel if channel.name == one.name)
    return {
        **channel_context(one.design, one.prefix, one.kind.number),
        "title": comment(f"{one.name}, {one.design.unit}" if one.design.unit else one.name),
        "reset_words": reset_words(one.design),
        "facts": [comment(fact) for fact in facts_of(channel_recipe, one.design, one.written)],
        "header": one.written.header,
        "source": one.written.source,
        "state_bytes": one.written.state_bytes,
        "table_bytes": one.written.table_bytes,
        "cost": cost_words(one.written),
        "whole": isinstance(one.kind, WholeChannel),
        "settles": one.design.settles,
        "forgets": not isinstance(one.kind, WholeChannel) or one.design.restarts_after_gap,
        "switches": one.design.modes is not None,
        "bits": one.kind.bits,
        "expected_type": one.kind.expected_type,
        "thrown": bits_of(one.jump_ends),
        "vectors": vector_texts(one.vectors, one.kind, one.design, one.written, one.new_reference),
    }
