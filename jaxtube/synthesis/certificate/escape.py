"""The margin of a proof that no invariant set exists, and the constraint that it is about."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import ERROR_NAMES
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.tightening import UNITS, input_names
from sets.certificate import escape_excess
from sets.invariant import Escape


def escape_margin(
    escape: Escape | None,
    loops: Float[np.ndarray, "v 3 3"],
    disturbance: Float[np.ndarray, "w 3"] | Sequence[Float[np.ndarray, "w 3"]],
) -> float:
    """Return minus what an escape passes its constraint by, -inf where none does: then nothing is
    proved."""
    if escape is None:
        return -np.inf
    excess, _ = escape_excess(loops, disturbance, escape.normal, escape.offset, escape.loops)
    return -excess if excess > 0 else -np.inf


def say_what_is_passed(problem: Problem, gain: Gain, escape: Escape, excess: float) -> str:
    """Return which constraint an escape passes, and by how much, in words.

    Args:
        problem: whose constraints on error and input are meant.
        gain: of the loops, under which those on the input are constraints on the error.
        escape: its normal is a row of one of them.
        excess: in the units of this row.
    """
    name = _find_name(problem, gain, escape.normal)
    unit = UNITS.get(name, "")
    size = np.rad2deg(excess) if unit == "deg" else excess
    return f"the {name} goes {size:.3g} {unit}".rstrip() + " past its limit"


def _find_name(problem: Problem, gain: Gain, normal: Float[np.ndarray, "3"]) -> str:
    """Return the name of the constraint whose row points as a normal does."""
    by_gain = problem.input_rows.on_errors(np.unique(gain.corner_gains, axis=0))
    normals = np.concatenate([problem.operating_set.normals, *by_gain])
    cosines = normals @ normal / np.linalg.norm(normals, axis=1)
    of_errors = 2 * ERROR_NAMES
    of_inputs = 2 * input_names(problem)
    row = int(np.argmax(cosines))
    if row < len(of_errors):
        return of_errors[row]
    return of_inputs[(row - len(of_errors)) % len(of_inputs)]
