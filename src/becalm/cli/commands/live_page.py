"""Serve the live page of a stream in a thread."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from becalm.live.running.retuning import Retune
from becalm.live.watching.meter import Meter
from becalm.web.access import Access, AccessOptions, PageOptions, token_of
from becalm.web.livepage.feed import Feed
from becalm.web.livepage.page import LivePage
from becalm.web.livepage.session import converse
from becalm.web.serving import Server, listen
from becalm.web.site import Page, html_of, site

if TYPE_CHECKING:
    from collections.abc import Callable


_OPTIONS = AccessOptions("--page-host", "--page")
_SWITCH_S = 5e-4  # Python's thread switch interval, short so that the page does not delay the filters


class Served(NamedTuple):
    """A page that is being served."""

    feed: Feed
    """The sink whose rows the page shows."""

    says: tuple[str, ...]
    """Messages for the terminal. They must not go to the log, because the address contains the token."""


def serve(asked: PageOptions, meter: Meter, retune: Retune, warn: Callable[[str], object], stack: ExitStack) -> Served:
    """Serve the live page until `stack` is closed.

    Raises
    ------
    UsageError
        If the port cannot be used, or the token file has no token.
    """
    stack.callback(sys.setswitchinterval, sys.getswitchinterval())
    sys.setswitchinterval(_SWITCH_S)
    page = LivePage(Feed(warn), meter, retune)
    token = token_of(asked.token_file)
    listener = listen(asked.host, asked.port, _OPTIONS)
    access = Access(asked.host, listener.getsockname()[1], token, _OPTIONS)
    shown = Page(html_of("live.html"), partial(converse, page), page.routes)
    stack.enter_context(Server(listener, site(shown, access)))
    stack.callback(page.close)
    warning = () if access.warning is None else (access.warning,)
    return Served(page.feed, (f"The stream is shown at {access.url}", *warning))
