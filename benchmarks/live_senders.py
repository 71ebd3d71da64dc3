"""Send rows in numbered messages for `live_kills.py`, each again until the broker has acknowledged it."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from becalm.live.messages.encoding import Encoder

Floats = NDArray[np.float64]

_PAUSE_S = 0.01
_PATIENCE_S = 2.0


class Sender:
    """Sends rows, one message at a time.

    Parameters
    ----------
    port : int
        Port of the broker.
    names : sequence of str
        Names of the channels.
    stamps, values : (N,), (N, m) float arrays
        Rows to send.
    message_rows : int
        Number of rows in a message.
    """

    def __init__(self, port: int, names: Sequence[str], stamps: Floats, values: Floats, message_rows: int) -> None:
        self._port, self._names, self._stamps, self._values = port, names, stamps, values
        self._message_rows, self._encoder = message_rows, Encoder("arrow", dict.fromkeys(names, "m/s^2"))
        self._stop, self._ended = threading.Event(), threading.Event()
        self.rows = 0
        """Number of rows that the broker has acknowledged."""

    def stop(self) -> None:
        """Stop to send."""
        self._stop.set()

    def finish(self) -> bool:
        """Stop to send, and wait until all messages are acknowledged; return whether that took less than 60 s."""
        self._stop.set()
        return self._ended.wait(60.0)

    def _message(self) -> bytes:
        some = slice(self.rows, self.rows + self._message_rows)
        columns: dict[str, Floats] = {"time": self._stamps[some]}
        columns |= {name: self._values[some, number] for number, name in enumerate(self._names)}
        return self._encoder.message(columns, self.rows)


class JetStreamSender(Sender):
    """Creates a stream `drive` and publishes to it; a message that is sent again has the same id."""

    def run(self) -> None:
        """Send until `stop` or `finish` is called."""
        asyncio.run(self._run())
        self._ended.set()

    async def _run(self) -> None:
        import nats

        async def quiet(_: Exception) -> None:
            return

        client = await nats.connect(
            f"nats://127.0.0.1:{self._port}", max_reconnect_attempts=-1, reconnect_time_wait=0.1, error_cb=quiet
        )
        stream = client.jetstream()
        await stream.add_stream(name="drive", subjects=["drive"])
        while not self._stop.is_set():
            message, number = self._message(), self.rows
            while True:
                try:
                    await stream.publish("drive", message, timeout=_PATIENCE_S, headers={"Nats-Msg-Id": str(number)})
                except Exception:
                    await asyncio.sleep(_PAUSE_S)
                    continue
                break
            self.rows += self._message_rows
            await asyncio.sleep(_PAUSE_S)
        await client.close()


class MqttSender(Sender):
    """Publishes to the topic `drive`, with QoS 1."""

    def run(self) -> None:
        """Send until `stop` or `finish` is called."""
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        acknowledged: set[int] = set()
        client = Client(CallbackAPIVersion.VERSION2, client_id="sender", clean_session=False)
        client.on_publish = lambda _client, _data, number, *_: acknowledged.add(number)
        client.reconnect_delay_set(1, 1)
        client.connect("127.0.0.1", self._port)
        client.loop_start()
        while not self._stop.is_set():
            number = client.publish("drive", self._message(), qos=1).mid  # paho sends it again until it is acknowledged
            while number not in acknowledged:
                time.sleep(_PAUSE_S / 10)
            acknowledged.clear()
            self.rows += self._message_rows
            self._stop.wait(_PAUSE_S)
        client.disconnect()
        client.loop_stop()
        self._ended.set()
