"""Everyone who looks at a stream, as one: the counts, the log, what notices silence, and systemd."""

from __future__ import annotations

import time
from collections.abc import Sequence

from becalm.live.block import Loss, Output
from becalm.live.watching.logs import Log
from becalm.live.watching.meter import Meter, State
from becalm.live.watching.watchdog import Silence, Systemd

_SAID_EVERY_S = 10.0


class Watch:
    """Hears of all that happens to a stream, and tells it wherever somebody looks.

    Parameters
    ----------
    meter : Meter
        Counts.
    log : Log or None
        Gets a line for what matters; None keeps none.
    silent_s : float
        After how long a source that says nothing is called silent.
    """

    def __init__(self, meter: Meter, log: Log | None = None, silent_s: float = 10.0) -> None:
        self.meter, self._log = meter, log
        self._silence, self._systemd = Silence(silent_s), Systemd()
        self._state: State = "starting"
        self._said_s = 0.0

    def state(self, state: State, says: str = "") -> None:
        """Hear what the stream is doing now."""
        self.meter.state(state, says)
        if state == self._state:
            return
        self._state = state
        if state in ("learning", "running"):
            self._systemd.ready()
        elif state in ("stopping", "ended"):
            self._systemd.stopping()
        self._systemd.status(f"{state}: {says}" if says else state)
        if self._log is not None:
            tell = self._log.warning if state in ("away", "full", "failed", "silent") else self._log.info
            tell(state, **({"says": says} if says else {}))

    def tuned(self, recipe: str) -> None:
        """Hear that rows go through another recipe (TOML) from now on."""
        self.meter.tuned(recipe)
        if self._log is not None:
            self._log.info("tuned anew")

    def refused(self, says: str) -> None:
        """Hear of something that was asked of a running stream and cannot be; it goes on as it was."""
        if self._log is not None:
            self._log.error("refused", says=says)

    def turned(self, block_came: bool) -> tuple[Loss, ...]:
        """Hear that the main loop came round; return what its source's silence, or the end of it, is worth telling."""
        self.meter.turned()
        self._systemd.alive()
        said = self._silence.came() if block_came else self._silence.waited()
        if said is not None:
            self.state("silent" if self._silence.silent else "running", said.says)
        if self._log is not None and time.monotonic() - self._said_s > _SAID_EVERY_S:
            self._said_s = time.monotonic()
            self._log.turn()
        return () if said is None else (said,)

    def told(self, output: Output) -> None:
        """Hear of rows that sinks have got, and of what is told with them."""
        self.meter.told(output)
        self._say(output.losses)

    def lost(self, losses: Sequence[Loss]) -> None:
        """Hear what happened to a stream that has no rows yet."""
        self.meter.lost(losses)
        self._say(losses)

    def _say(self, losses: Sequence[Loss]) -> None:
        if self._log is not None:
            for loss in losses:
                self._log.loss(loss)

    def close(self) -> None:
        """Let go."""
        self._systemd.close()
