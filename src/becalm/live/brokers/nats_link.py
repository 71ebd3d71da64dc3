"""One connection to a NATS server, and the thread whose event loop serves it; whoever wants another makes another."""

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
from becalm.live.optional_libraries import wanted

if TYPE_CHECKING:
    import ssl

    from nats.aio.client import Client
    from nats.js import JetStreamContext
    from nats.js.api import StreamInfo

PORT = 4222
_ANSWER_S = 10.0
_PING_S = 10
_T = TypeVar("_T")


def stream_of(remote: Remote) -> str:
    """Return the stream that an address names.

    Raises
    ------
    UsageError
        If it names none that can be.
    """
    stream = remote.path
    if not stream or set(stream) & set(" .*>/\\\t"):
        raise UsageError(
            f"{remote.address} names {f'the stream {stream!r}' if stream else 'no stream'}; a stream's name has no "
            f"dots, slashes, stars or blanks: nats://{remote.host}/PUMP?subject=plant.pump"
        )
    return stream


def check_subject(info: StreamInfo, subject: str) -> None:
    """Refuse a subject that a stream does not hold: nothing would ever come of it.

    Raises
    ------
    InputError
        If it does not.
    """
    held = info.config.subjects
    if held and not any(holds(pattern, subject) for pattern in held):
        raise InputError(
            f"The stream {info.config.name} holds {', '.join(held)}, and not {subject}; name one of these by subject=, "
            f"or let it hold that: nats stream edit {info.config.name} --subjects ..."
        )


def holds(pattern: str, subject: str) -> bool:
    """Return whether a pattern of subjects, as plant.* or plant.>, holds one."""
    wanted, words = pattern.split("."), subject.split(".")
    if wanted[-1] == ">" and len(words) >= len(wanted):
        wanted = wanted[:-1]
        words = words[: len(wanted)]
    return len(wanted) == len(words) and all(want in ("*", word) for want, word in zip(wanted, words, strict=True))


class NatsLink:
    """A connection, and the thread that serves it.

    Parameters
    ----------
    remote : Remote
        The server.
    """

    def __init__(self, remote: Remote) -> None:
        self._remote = remote
        self.changed = threading.Condition()
        """Told when the connection ends; those who wait for messages may share it."""
        self._failure: BecalmError | None = None
        self._refused: list[BaseException] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._thread: threading.Thread | None = None
        self._client: Client | None = None
        self._context: ssl.SSLContext | None = None

    @property
    def client(self) -> Client:
        """The connection as nats-py has it, for what runs on its thread."""
        if self._client is None:
            raise self._remote.away("the connection is closed")
        return self._client

    @property
    def stream_api(self) -> JetStreamContext:
        """JetStream as nats-py has it, for what runs on its thread."""
        return self.client.jetstream(timeout=_ANSWER_S / 2)

    def connect(self, *, reached: bool) -> None:
        """Connect.

        Parameters
        ----------
        reached : bool
            Whether the server was ever reached before.

        Raises
        ------
        AwayError
            If it cannot be reached now.
        BecalmError
            If it refuses.
        """
        wanted("nats:", "nats.aio.client", "nats-py")
        from nats.aio.client import Client

        asks = self._asks()
        self._client = client = Client()
        started: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(started)), name="nats", daemon=True)
        self._thread.start()
        started.result()
        try:
            self.call(self._connected(client, asks))
            self._check_private(client)
        except BecalmError:
            self.close()
            raise
        except Exception as cause:
            self.close()
            raise self._why(cause, reached=reached) from cause

    def call(self, work: Coroutine[Any, Any, _T]) -> _T:
        """Run something on the connection's thread, and return what it returns.

        Raises
        ------
        AwayError
            If it takes too long, or the connection is closed. What it raises itself goes through.
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
        """Run something on the connection's thread, after all that was started before; nobody waits for it."""
        if self._loop is None:
            work.close()
        else:
            asyncio.run_coroutine_threadsafe(work, self._loop)

    def stream_info(self, name: str, *, reached: bool) -> StreamInfo:
        """Return what the server tells of a stream.

        Raises
        ------
        InputError
            If there is no such stream, or the server has no JetStream.
        AwayError
            If it cannot tell now.
        """
        from nats.errors import Error
        from nats.js.errors import NotFoundError, ServiceUnavailableError

        where = f"{self._remote.host}:{self._remote.port}"
        try:
            return self.call(self.stream_api.stream_info(name))
        except NotFoundError as cause:
            raise InputError(
                f"NATS at {where} has no stream {name!r}; make it: "
                f"nats stream add {name} --subjects SUBJECT --storage file --defaults"
            ) from cause
        except ServiceUnavailableError as cause:
            if reached:
                raise self._remote.away("JetStream does not answer") from cause
            raise InputError(f"NATS at {where} has no JetStream; start it by nats-server -js -sd FOLDER.") from cause
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause

    @property
    def ended(self) -> bool:
        """Whether the connection ended by itself."""
        return self._failure is not None

    def end(self, failure: BecalmError) -> None:
        """Hear why nothing more will come."""
        with self.changed:
            self._failure = self._failure or failure
            self.changed.notify_all()

    def check(self) -> None:
        """Raise what ended the connection, if anything did."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """End the connection and its thread; harmless twice."""
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
            with contextlib.suppress(Exception):  # it is over: nothing is lost by a bad end
                await asyncio.wait_for(self._client.close(), 1.0)  # nats-py waits for ever after a failed handshake

    async def _connected(self, client: Client, asks: dict[str, Any]) -> None:
        async def failed(cause: BaseException) -> None:
            self._refused.append(cause)

        async def closed() -> None:
            self.end(self._remote.away(f"the connection ended ({self._last() or 'by itself'})"))

        await client.connect(
            f"nats://{self._remote.host}:{self._remote.port}",
            error_cb=failed,
            closed_cb=closed,
            allow_reconnect=False,
            max_reconnect_attempts=1,
            reconnect_time_wait=0,
            connect_timeout=max(1, int(_ANSWER_S / 2)),
            ping_interval=_PING_S,
            name="becalm",
            **asks,
        )

    def _asks(self) -> dict[str, Any]:
        """Return who enters, and how the way is kept private."""
        login, creds = self._remote.login(), self._remote.address.options.get("creds")
        told = {"user": login.user, "password": login.password, "token": login.token}
        asks: dict[str, Any] = {name: self._guarded(secret) for name, secret in told.items() if secret is not None}
        if creds is not None:
            if importlib.util.find_spec("nkeys") is None:
                raise UsageError("nats: creds= needs nkeys; pip install nkeys")
            asks["user_credentials"] = creds
        self._context = self._remote.tls()
        if self._context is not None:
            asks |= {"tls": self._context, "tls_hostname": self._remote.host}
        return asks

    def _guarded(self, secret: str) -> Callable[[], str]:
        """Return what tells a secret to nats-py when it is about to send it."""

        def told() -> str:
            self._check_private(self.client)
            return secret

        return told

    def _check_private(self, client: Client) -> None:
        """Refuse a server that does not speak TLS where TLS is asked for: nats-py would go on in the clear."""
        if self._context is not None and not client._server_info.get("tls_required"):
            where = f"{self._remote.host}:{self._remote.port}"
            raise InputError(f"{where} does not speak TLS; switch it on there, or leave tls, ca and cert away here.")

    def _last(self) -> BaseException | None:
        return self._refused[-1] if self._refused else None

    def _why(self, cause: BaseException, *, reached: bool) -> BecalmError:
        """Return what a failure to connect means."""
        from nats.errors import NoServersError

        if isinstance(cause, NoServersError):  # says nothing; what was heard before does
            cause = self._last() or cause
        said = str(cause).lower()
        if "authorization" in said or "authentication" in said:
            return InputError(
                f"{self._remote.host}:{self._remote.port} refuses who comes; set "
                f"{variable(self._remote.address, 'USER')} and {variable(self._remote.address, 'PASSWORD')} (or "
                f"{variable(self._remote.address, 'TOKEN')}), or name a file by password_file=FILE or creds=FILE."
            )
        return self._remote.failed(cause, reached=reached)
