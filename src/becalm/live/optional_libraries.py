"""Import the optional library of a transport, or say what to install."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from becalm.errors import UsageError


def wanted(whose: str, module: str, package: str = "", extra: str = "live") -> Any:
    """Return a module that is not here in every installation.

    Parameters
    ----------
    whose : str
        What needs it, as a person typed that.
    module : str
        Its name.
    package : str
        What it is called where it is installed from, if that is another name.
    extra : str
        The extra of becalm that brings it.

    Raises
    ------
    UsageError
        If it is not here.
    """
    try:
        return import_module(module)
    except ImportError as cause:
        raise UsageError(f"{whose} needs {package or module}; type: pip install 'becalm[{extra}]'") from cause
