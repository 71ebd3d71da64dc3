"""A bank that switches, back over rows that were filtered: the doors for Python, from the end or with a fixed lag."""

from __future__ import annotations

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_settling import LOAD, SAVE
from becalm.core.kernel_switching import SwitchingTrace, write_modes
from becalm.core.kernel_switching_ahead import Outlook, Return, new_outlook, new_return, transfer_outlook
from becalm.core.kernel_switching_back import Pairs, end_of_record, new_pairs, smooth_row, take_back
from becalm.core.kernel_switching_row import Bank, BankSizes, Beliefs, new_beliefs, transfer_beliefs


@compiled_part
def come_back(  # noqa: PLR0913
    sizes: BankSizes,
    bank: Bank,
    steps: Integers,
    filtered: Floats,
    rows: tuple[int, int],
    first: int,
    now: Beliefs,
    own: Beliefs,
    ahead: Outlook,
    way: Return,
    pairs: Pairs,
    trace: SwitchingTrace,
) -> None:
    """Smooth the rows from the one up to the other, from `ahead`, of the row after them; write from `first` on."""
    for k in range(rows[1] - 1, rows[0] - 1, -1):
        transfer_beliefs(sizes, now, filtered[k], LOAD)
        if not now.mu[0] > 0.0:
            break
        if ahead.known[0] > 0.0 and steps[k + 1] >= 0:
            smooth_row(sizes, bank, steps[k + 1], now, ahead, way, pairs, own)
        else:
            end_of_record(sizes, now, ahead, own)
        take_back(sizes, bank, filtered[k], now, ahead)
        write_modes(sizes, bank, first + k, own, trace)


@compiled
def switch_backward(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, steps: Integers, filtered: Floats, later: Floats, first: int, trace: SwitchingTrace
) -> None:
    """Smooth some rows, given the filtered beliefs after each, (N, K); they are written from row `first` on.

    `filtered` has what each reading said behind the beliefs (`note_length`); `steps` (N + 1,) says which step
    precedes each row, and the one after them; `later` (`outlook_length`,) holds what readings from that one on
    say, or all 0 where there is none, and what those from the first row on say when done.
    Rows before the first reading are left as they are.
    """
    now, own, ahead = new_beliefs(sizes), new_beliefs(sizes), new_outlook(sizes)
    way, pairs = new_return(sizes), new_pairs(sizes)
    transfer_outlook(sizes, ahead, later, LOAD)
    come_back(sizes, bank, steps, filtered, (0, len(filtered)), first, now, own, ahead, way, pairs, trace)
    transfer_outlook(sizes, ahead, later, SAVE)


@compiled
def switch_late(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, steps: Integers, filtered: Floats, turn: int, every: int, lag: int,
    trace: SwitchingTrace,
) -> None:  # fmt: skip
    """Smooth with a fixed lag: come back from row `turn` - 1, and each `every` rows later, over `lag` rows more.

    `filtered`, `steps` and `trace` as in `switch_backward`. A row is written more than once; the last time it knows
    no more than `lag` rows after it, and no fewer than `lag` - `every` + 1.
    """
    now, own, ahead = new_beliefs(sizes), new_beliefs(sizes), new_outlook(sizes)
    way, pairs = new_return(sizes), new_pairs(sizes)
    for stop in range(turn, len(filtered) + 1, every):
        ahead.known[0] = 0.0
        rows = (max(0, stop - 1 - lag), stop)
        come_back(sizes, bank, steps, filtered, rows, 0, now, own, ahead, way, pairs, trace)
