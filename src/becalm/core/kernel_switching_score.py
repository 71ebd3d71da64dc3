"""How a bank that switches foretold a reading, as a number that is Gaussian where the bank is right, in Numba.

What a mixture foretells is not Gaussian: far out at a jump, and narrower than its variance between jumps. The
probability of a smaller reading is uniform all the same, and its normal quantile, the score, standard normal and white.
Source: Rosenblatt, Annals of Mathematical Statistics 23 (1952) 470.
"""

from __future__ import annotations

import math

from becalm.core.compiling import compiled_part
from becalm.core.kernel_switching_row import Bank, BankSizes, Beliefs, Look

_LEAST = 1e-300  # a probability; the score is 37 there
_ROUNDS = 8  # of Newton, which comes from above and doubles its digits


@compiled_part
def upper_tail(u: float) -> float:
    """Return the probability that a standard normal number is larger than u."""
    return 0.5 * math.erfc(u / math.sqrt(2.0))


@compiled_part
def normal_score(below: float, above: float) -> float:
    """Return the normal quantile of a value, of the probabilities of smaller and of larger ones."""
    tail = min(max(min(below, above), _LEAST), 0.5)
    u = math.sqrt(-2.0 * math.log(2.0 * tail))  # too large: the upper tail of u is below exp(-u^2 / 2) / 2
    for _ in range(_ROUNDS):
        own = upper_tail(u)
        u += math.log(own / tail) * own * math.sqrt(2.0 * math.pi) * math.exp(0.5 * u * u)
    return u if above < below else -u


@compiled_part
def score_of_modes(sizes: BankSizes, bank: Bank, z: float, look: Look, mixed: Beliefs) -> float:
    """Return the normal score of a reading by what all modes expected of it, wild readings too."""
    below, above = 0.0, 0.0
    for j in range(len(sizes.modes)):
        nu, t = z - look.Hx[j], bank.tail[j]
        tame, wild = nu / math.sqrt(look.S[j]), nu / math.sqrt(look.S[j] + bank.wild[0])
        above += mixed.mu[j] * ((1.0 - t) * upper_tail(tame) + t * upper_tail(wild))
        below += mixed.mu[j] * ((1.0 - t) * upper_tail(-tame) + t * upper_tail(-wild))
    return normal_score(below, above)
