"""Report a stream's events to the counts, the log, the silence watchdog and systemd."""

from __future__ import annotations

import time
from collections.abc import Sequence

from becalm.live.block import Loss, Output
from becalm.live.watching.logs import Log
from becalm.live.watching.meter import Meter, State
from becalm.live.watching.watchdog import Silence, Systemd

_LOG_LOSSES_S = 10.0  # interval between calls of `Log.log_due_losses`, in seconds


class Watch:
    """Receives the events of a stream, and passes them to meter, log and systemd.

    Parameters
    ----------
    meter : Meter
        Counts rows, losses and commits.
    log : Log or None
        Gets a line for each important event; None for no log.
    silent_s : float
        Time without rows after which the source counts as silent, in seconds.
    """

    def __init__(self, meter: Meter, log: Log | None = None, silent_s: float = 10.0) -> None:
        self.meter, self._log = meter, log
        self._silence, self._systemd = Silence(silent_s), Systemd()
        self._state: State = "starting"
        self._losses_logged_s = 0.0

    def state(self, state: State, says: str = "") -> None:
        """Report the current state of the stream."""
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
            log = self._log.warning if state in ("away", "full", "failed", "silent") else self._log.info
            log(state, **({"says": says} if says else {}))

    def record_retuning(self, recipe: str) -> None:
        """Report another recipe (TOML) for all following rows."""
        self.meter.set_recipe(recipe)
        if self._log is not None:
            self._log.info("tuned anew")

    def record_refusal(self, says: str) -> None:
        """Report a refused request to a running stream; the stream continues unchanged."""
        if self._log is not None:
            self._log.error("refused", says=says)

    def record_iteration(self, has_rows: bool) -> tuple[Loss, ...]:
        """Record an iteration of the main loop; `has_rows` is True if it got rows, not only losses, from the source.

        Returns
        -------
        tuple of Loss
            A loss if the source has just become silent, or has just ended its silence; otherwise empty.
        """
        self.meter.record_iteration()
        self._systemd.ping_watchdog()
        loss = self._silence.record_rows() if has_rows else self._silence.record_no_rows()
        if loss is not None:
            self.state("silent" if self._silence.silent else "running", loss.says)
        if self._log is not None and time.monotonic() - self._losses_logged_s > _LOG_LOSSES_S:
            self._losses_logged_s = time.monotonic()
            self._log.log_due_losses()
        return () if loss is None else (loss,)

    def record(self, output: Output) -> None:
        """Report rows that were passed to the sinks, and their losses."""
        self.meter.record(output)
        self._log_losses(output.losses)

    def record_losses(self, losses: Sequence[Loss]) -> None:
        """Report losses that no output carries, because the stream has no rows yet."""
        self.meter.count_losses(losses)
        self._log_losses(losses)

    def _log_losses(self, losses: Sequence[Loss]) -> None:
        if self._log is not None:
            for loss in losses:
                self._log.loss(loss)

    def close(self) -> None:
        """Close the connection to systemd."""
        self._systemd.close()
