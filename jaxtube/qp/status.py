"""What a solver can say of an answer, as numbers for the device and as sentences for people."""

from collections.abc import Mapping

SOLVED = 0
INFEASIBLE = 1
UNSOLVED = 2

SENTENCES = {
    SOLVED: "solved: the residual is within the tolerance",
    INFEASIBLE: "infeasible: it is proved that no x meets the bounds; widen l or u",
    UNSOLVED: "unsolved: if the residual is infinite look for NaN in the data, else use float64 or "
    "a better scaled P",
}


def describe(status: int) -> str:
    """Return the sentence of one status: what it means and what to do next."""
    return SENTENCES[int(status)]


def describe_unsolved(counts: Mapping[int, int]) -> list[str]:
    """Return a line for each status but SOLVED that any QP has, with its sentence.

    Args:
        counts: QPs by status.
    """
    present = {status: count for status, count in counts.items() if status != SOLVED and count}
    return [
        f"{count:,} {'QP' if count == 1 else 'QPs'} {describe(status)}"
        for status, count in present.items()
    ]
