"""Check that the libraries that serve pages are installed."""

from __future__ import annotations

from importlib.util import find_spec

from becalm.errors import UsageError

_NEEDED = ("starlette", "uvicorn", "websockets")


def need_app() -> None:
    """Check that the libraries are installed; call this before importing a module that needs them.

    Raises
    ------
    UsageError
        If a library is not installed.
    """
    if missing := [name for name in _NEEDED if find_spec(name) is None]:
        raise UsageError(f"Pages need {', '.join(missing)}, which must be installed; type: pip install 'becalm[app]'")
