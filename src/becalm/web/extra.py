"""Whether the libraries that serve a page are here."""

from __future__ import annotations

from importlib.util import find_spec

from becalm.errors import UsageError

_NEEDED = ("starlette", "uvicorn", "websockets")


def need_app() -> None:
    """Look for them before anything that needs them is loaded.

    Raises
    ------
    UsageError
        If one is not here.
    """
    if missing := [name for name in _NEEDED if find_spec(name) is None]:
        raise UsageError(f"Pages are served by {', '.join(missing)}, not here; type: pip install 'becalm[app]'")
