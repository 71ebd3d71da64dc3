"""One connection to a NATS server, and the thread with its event loop; a reconnection needs a new object."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import importlib.util
import threading
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any, TypeVar

from becalm.errors import BecalmError, InputError, UsageError
from becalm.live.brokers.remote import Remote, variable
from becalm.live.optional_libraries import import_optional

if TYPE_CHECKING:
    import ssl

    from nats.aio.client import Client
    from nats.js import JetStreamContext
    from nats.js.api import StreamInfo

PORT = 4222
_ANSWER_S = 10.0  # longest wait for an answer of the server, in seconds
_PING_S = 10  # interval between pings of the server, in seconds
_T = TypeVar("_T")


def stream_of(remote: Remote) -> str:
    """Return the name of the stream in an address.

    Raises
    ------
    UsageError
        If the address has no stream, or a name that is not possible.
    """
    stream = remote.path
    if not stream or set(stream) & set(" .*>/\\\t"):
        raise UsageError(
            f"{remote.address} names {f'the stream {stream!r}' if stream else 'no stream'}; a stream's name has no "
            f"dots, slashes, stars or blanks: nats://{remote.host}/PUMP?subject=plant.pump"
        )
    return stream


def check_subject(info: StreamInfo, subject: str) -> None:
    """Check that a stream stores a subject; otherwise no message of it would ever arrive.

    Raises
    ------
    InputError
        If the stream does not store the subject.
    """
    patterns = info.config.subjects
    if patterns and not any(matches_subject(pattern, subject) for pattern in patterns):
        raise InputError(
            f"The stream {info.config.name} holds {', '.join(patterns)}, and not {subject}; choose one of these by "
            f"subject=, or add the subject: nats stream edit {info.config.name} --subjects ..."
        )


def matches_subject(pattern: str, subject: str) -> bool:
    """Return whether a pattern of subjects, such as plant.* or plant.>, matches a subject."""
    tokens, words = pattern.split("."), subject.split(".")
    if tokens[-1] == ">" and len(words) >= len(tokens):
        tokens = tokens[:-1]
        words = words[: len(tokens)]
    return len(tokens) == len(words) and all(token in ("*", word) for token, word in zip(tokens, words, strict=True))


class NatsLink:
    """A connection to a NATS server, and the thread that serves it.

    Parameters
    ----------
    remote : Remote
        The server.
    """

    def __init__(self, remote: Remote) -> None:
        self._remote = remote
        self.changed = threading.Condition()
        """Notified when the connection ends; the owner of the connection may also notify it of messages."""
        self._failure: BecalmError | None = None
        self._errors: list[BaseException] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._thread: threading.Thread | None = None
        self._client: Client | None = None
        self._context: ssl.SSLContext | None = None

    @property
    def client(self) -> Client:
        """Return nats-py's client, to be used on the connection's thread."""
        if self._client is None:
            raise self._remote.away("the connection is closed")
        return self._client

    @property
    def stream_api(self) -> JetStreamContext:
        """Return nats-py's JetStream context, to be used on the connection's thread."""
        return self.client.jetstream(timeout=_ANSWER_S / 2)

    def connect(self, *, reached: bool) -> None:
        """Connect.

        Parameters
        ----------
        reached : bool
            True if the server was reached before.

        Raises
        ------
        AwayError
            If the server cannot be reached now.
        BecalmError
            If the server refuses the connection.
        """
        import_optional("nats:", "nats.aio.client", "nats-py")
        from nats.aio.client import Client

        options = self._connect_options()
        self._client = client = Client()
        started: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(started)), name="nats", daemon=True)
        self._thread.start()
        started.result()
        try:
            self.call(self._connect_client(client, options))
            self._check_tls(client)
        except BecalmError:
            self.close()
            raise
        except Exception as cause:
            self.close()
            raise self._error_of(cause, reached=reached) from cause

    def call(self, work: Coroutine[Any, Any, _T]) -> _T:
        """Run a coroutine on the connection's thread, and return its result; raises the errors of the coroutine too.

        Raises
        ------
        AwayError
            If it takes longer than 10 s, or the connection is closed.
        """
        if self._loop is None:
            work.close()
            raise self._remote.away("the connection is closed")
        running = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return running.result(_ANSWER_S)
        except concurrent.futures.TimeoutError as cause:
            running.cancel()
            raise self._remote.away("it does not answer") from cause

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Start a coroutine on the connection's thread, after the coroutines started earlier; do not wait for it."""
        if self._loop is None:
            work.close()
        else:
            asyncio.run_coroutine_threadsafe(work, self._loop)

    def stream_info(self, name: str, *, reached: bool) -> StreamInfo:
        """Return the server's information about a stream.

        Raises
        ------
        InputError
            If there is no such stream, or the server has no JetStream.
        AwayError
            If the server does not answer now.
        """
        from nats.errors import Error
        from nats.js.errors import NotFoundError, ServiceUnavailableError

        where = f"{self._remote.host}:{self._remote.port}"
        try:
            return self.call(self.stream_api.stream_info(name))
        except NotFoundError as cause:
            raise InputError(
                f"NATS at {where} has no stream {name!r}; create it: "
                f"nats stream add {name} --subjects SUBJECT --storage file --defaults"
            ) from cause
        except ServiceUnavailableError as cause:
            if reached:
                raise self._remote.away("JetStream does not answer") from cause
            raise InputError(f"NATS at {where} has no JetStream; start it with nats-server -js -sd FOLDER.") from cause
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause

    @property
    def ended(self) -> bool:
        """Return whether the connection was lost or ended by an error."""
        return self._failure is not None

    def end(self, failure: BecalmError) -> None:
        """Record the error that ended the connection."""
        with self.changed:
            self._failure = self._failure or failure
            self.changed.notify_all()

    def check(self) -> None:
        """Raise the error that ended the connection, if any."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Close the connection and end its thread; may be called twice."""
        loop, self._loop = self._loop, None
        if loop is None or self._stop is None or self._thread is None:
            return
        loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()
        self._client = None

    async def _serve(self, started: concurrent.futures.Future[None]) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        started.set_result(None)
        await self._stop.wait()
        if self._client is not None:
            with contextlib.suppress(Exception):  # errors while closing do not matter
                await asyncio.wait_for(self._client.close(), 1.0)  # nats-py waits forever after a failed handshake

    async def _connect_client(self, client: Client, options: dict[str, Any]) -> None:
        async def failed(cause: BaseException) -> None:
            self._errors.append(cause)

        async def closed() -> None:
            self.end(self._remote.away(f"the connection ended ({self._last_error() or 'without an error'})"))

        host = f"[{self._remote.host}]" if ":" in self._remote.host else self._remote.host  # brackets for IPv6
        await client.connect(
            f"nats://{host}:{self._remote.port}",
            error_cb=failed,
            closed_cb=closed,
            allow_reconnect=False,
            max_reconnect_attempts=1,
            reconnect_time_wait=0,
            connect_timeout=max(1, int(_ANSWER_S / 2)),
            ping_interval=_PING_S,
            name="becalm",
            **options,
        )

    def _connect_options(self) -> dict[str, Any]:
        """Return nats-py's options for login and TLS."""
        login, creds = self._remote.login(), self._remote.address.options.get("creds")
        secrets = {"user": login.user, "password": login.password, "token": login.token}
        options: dict[str, Any] = {
            name: self._tls_checked(secret) for name, secret in secrets.items() if secret is not None
        }
        if creds is not None:
            if importlib.util.find_spec("nkeys") is None:
                raise UsageError("nats: creds= needs nkeys; type: pip install nkeys")
            options["user_credentials"] = creds
        self._context = self._remote.tls()
        if self._context is not None:
            options |= {"tls": self._context, "tls_hostname": self._remote.host}
        return options

    def _tls_checked(self, secret: str) -> Callable[[], str]:
        """Return a function for nats-py that checks TLS and then returns a secret."""

        def checked_secret() -> str:
            self._check_tls(self.client)
            return secret

        return checked_secret

    def _check_tls(self, client: Client) -> None:
        """Raise an InputError if TLS is required but the server does not use it; nats-py would send plain text."""
        if self._context is not None and not client._server_info.get("tls_required"):
            where = f"{self._remote.host}:{self._remote.port}"
            raise InputError(f"{where} does not use TLS; switch it on there, or leave out tls, ca and cert here.")

    def _last_error(self) -> BaseException | None:
        return self._errors[-1] if self._errors else None

    def _error_of(self, cause: BaseException, *, reached: bool) -> BecalmError:
        """Return the error to raise for a failed connection."""
        from nats.errors import NoServersError

        if isinstance(cause, NoServersError):  # it has no reason; the last error of the client has one
            cause = self._last_error() or cause
        text = str(cause).lower()
        if "authorization" in text or "authentication" in text:
            return InputError(
                f"{self._remote.host}:{self._remote.port} refuses the login; set "
                f"{variable(self._remote.address, 'USER')} and {variable(self._remote.address, 'PASSWORD')} (or "
                f"{variable(self._remote.address, 'TOKEN')}), or give a file by password_file=FILE or creds=FILE."
            )
        return self._remote.failed(cause, reached=reached)
