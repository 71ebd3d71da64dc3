"""Import the optional library of a transport, or raise an error that names the package to install."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from becalm.errors import UsageError


def import_optional(whose: str, module: str, package: str = "", extra: str = "live") -> Any:
    """Return an optional module.

    Parameters
    ----------
    whose : str
        Option or address that needs the module, as the user typed it.
    module : str
        Name of the module.
    package : str
        Name of the package to install, if it differs from the module's name.
    extra : str
        Extra of becalm that installs the package.

    Raises
    ------
    UsageError
        If the module is not installed.
    """
    try:
        return import_module(module)
    except ImportError as cause:
        raise UsageError(f"{whose} needs {package or module}; type: pip install 'becalm[{extra}]'") from cause
