"""Remove the noise from sensor signals.

becalm takes a recording and returns the signal with a standard uncertainty per sample. It uses a Kalman filter whose
model and noise variances it identifies from the recording::

    recording = becalm.read("drive.csv")
    out = becalm.clean(recording)
    out.signal, out.sigma, out.recipe
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from becalm.cleaning.pipeline import clean
    from becalm.cleaning.recipes.recipe import Recipe
    from becalm.cleaning.tuning import Wishes, tune
    from becalm.core.filter.filtering import kalman_filter
    from becalm.core.filter.smoothing import kalman_smoother
    from becalm.core.model import components
    from becalm.core.model.model import Model
    from becalm.core.online import Online
    from becalm.core.recording import Recording
    from becalm.files.inputs.opening import read
    from becalm.files.outputs.writing import write

__all__ = [
    "Model",
    "Online",
    "Recipe",
    "Recording",
    "Wishes",
    "clean",
    "components",
    "kalman_filter",
    "kalman_smoother",
    "read",
    "tune",
    "write",
]

_MODULES = {
    "Model": "becalm.core.model.model",
    "Online": "becalm.core.online",
    "Recipe": "becalm.cleaning.recipes.recipe",
    "Recording": "becalm.core.recording",
    "Wishes": "becalm.cleaning.tuning",
    "clean": "becalm.cleaning.pipeline",
    "kalman_filter": "becalm.core.filter.filtering",
    "kalman_smoother": "becalm.core.filter.smoothing",
    "read": "becalm.files.inputs.opening",
    "tune": "becalm.cleaning.tuning",
    "write": "becalm.files.outputs.writing",
}


def __getattr__(name: str) -> object:
    """Import a public name on its first use, so that `import becalm` stays fast."""
    if name == "components":
        return import_module("becalm.core.model.components")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'becalm' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
