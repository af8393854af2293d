"""What a sample of commands can promise of new ones: the scenario bound of a box.

A box of d sides is fixed by the extremes of N independent commands. The probability V that a new
command falls outside obeys

    P(V > eps) <= sum_{i < d} C(N, i) eps^i (1 - eps)^(N - i)

for every law of the commands, with equality where the law has no atoms and one command fixes each
side. The promise is 1 - eps at which the right-hand side is 1 - confidence.

Source: Campi and Garatti, The exact feasibility of randomized solutions of uncertain convex
programs, SIAM J. Optim. 2008, theorem 1 (the smallest box around a sample is a convex program of d
variables); the inversion is the upper bound of Clopper and Pearson 1934 for d - 1 events in N
trials.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxtube.statistics.intervals import CONFIDENCE, compute_risk, largest_share

MOST_COMMANDS = 2**40
"""That are looked for."""


class Promise(NamedTuple):
    """What holds for new commands, drawn as those of the sample were."""

    share: float  # of new commands inside the box, at least
    confidence: float
    commands: int  # independent ones that the box was made from
    sides: int  # of the box

    def count_needed(self, share: float) -> int:
        """Return how many commands promise a share with as many sides."""
        return count_needed(share, self.sides, self.confidence)


def make_promise(commands: int, sides: int, confidence: float = CONFIDENCE) -> Promise:
    """Return what a box of so many sides, from so many commands, holds for.

    Args:
        commands: N, independent of each other and of all that the box was not made for.
        sides: d, at least one.
        confidence: in (0, 1).
    """
    risk = compute_risk(confidence)
    share = 1.0 - largest_share(sides - 1, commands, risk) if commands >= sides else 0.0
    return Promise(share, confidence, commands, sides)


def count_needed(share: float, sides: int, confidence: float = CONFIDENCE) -> int:
    """Return the fewest commands from which a box of so many sides promises a share.

    Raises:
        ValueError: for a share that no sample promises.
    """
    if not 0.0 < share < 1.0:
        raise ValueError(f"share: {share}; give a number between 0 and 1, such as 0.95")
    enough = sides
    while make_promise(enough, sides, confidence).share < share:
        enough *= 2
        if enough > MOST_COMMANDS:
            raise ValueError(f"share: {share}; no sample promises it, give a smaller one")
    too_few = sides - 1
    while enough - too_few > 1:
        middle = (enough + too_few) // 2
        if make_promise(middle, sides, confidence).share < share:
            too_few = middle
        else:
            enough = middle
    return enough
