"""Certificate: every condition a tube-MPC guarantee needs, re-checked by code that shares none with
the construction.

The construction works with support numbers of hulls and dual points; here reach is summed along
explicit products of loops, inclusions are linear programs over the polytopes actually used on line,
and decrease is an eigenvalue. With r_j(c) = (offset of the untightened set) - (offset used at stage
j), all read off the sets the controller really uses:

    reach      r_j(c) >= max over products of  sum_{m<j} h_W(Psi_m^T c)
    inclusion  r_{j+1}(c) >= r_j(c) + max over products of  h_W(Psi_j^T c),
               so that the shifted plan stays admissible
    terminal   with e_N in T, Psi the last N - 1 loops, w in W, e = e_N + Psi w:
               e in E_{N-1},  Gamma e in U_{N-1},  (A_i + B_i Gamma_i) e in the next T;
               or, one gain throughout:  T + R_N in the invariant set

Every condition keeps its margin (>= 0 where it holds; negative: by how much it fails) and a plain
sentence. Sources: Chisci, Rossiter, Zappa 2001 (restarted tubes); Gonzalez, Fiacchini, Guzman,
Alamo 2009, section III.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from sets.polytope import Polytope

ROUNDING = 1e-12
"""Float64 slack, in the unit of the quantity compared, added to its margin where a condition holds
with equality by construction."""

MOST_DIRECTIONS = 4000
"""Number of transported directions above which those that are not extreme are left out."""


Scope = Literal["model", "robot", "information"]

WIDTH = 100
INDENT = " " * 9
"""Of the sentences in a table of conditions."""
REQUIRED = {True: "holds", False: "FAILS"}
INFORMATIVE = {True: "yes", False: "no"}
"""A condition that holds, and one that does not, in a word."""
TIGHT = 1e-5
"""Margins below this are those of conditions that hold with equality by construction: what is left
is the back-off of the constraints, the inflation of W or rounding."""
UNITS = {"wheel_limits": " m/s", "wheel_acceleration": " m/s^2", "widest_tube_fits": " of a cap"}
"""Units of the margins that have one of their own."""
MARGINS = (
    "margin: by how much a condition holds, below 0 by how much it fails; where no unit is named "
    "it is that of the row of E, U or W that decides (m, rad, m/s, rad/s), or an eigenvalue; "
    f"tight: holds with equality by construction, up to {TIGHT:g}; -: none was found"
)
"""What the margins of a table mean."""


@dataclass(frozen=True)
class Condition:
    """One condition of a guarantee, decided by its margin.

    Attributes:
        name: by which reports and metrics know it.
        margin: not negative where the condition holds; NaN never holds.
        sentence: what that means, in plain words.
        scope: a condition of the linear "model" with w in W; of the "robot" itself, beyond the
            model; or for "information", which decides nothing.
    """

    name: str
    margin: float
    sentence: str
    scope: Scope = "model"

    @property
    def holds(self) -> bool:
        """Whether the condition holds."""
        return self.margin >= 0

    @property
    def required(self) -> bool:
        """Whether a verdict rests on the condition."""
        return self.scope != "information"

    def describe(self) -> str:
        """Return name, margin and sentence in lines of text, after a word for whether it holds."""
        words = REQUIRED if self.required else INFORMATIVE
        head = f"  {words[self.holds]:<6} {self.name:<32} margin {self._number:>10}{self._unit}"
        sentence = textwrap.wrap(
            self.sentence, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT
        )
        return "\n".join([head, *sentence])

    @property
    def margin_words(self) -> str:
        """The margin as tables write it, with its unit."""
        return f"{self._number}{self._unit}"

    @property
    def _number(self) -> str:
        if not np.isfinite(self.margin):
            return "-"
        return "tight" if 0 <= self.margin < TIGHT else f"{self.margin:.3g}"

    @property
    def _unit(self) -> str:
        is_number = self._number not in ("-", "tight")
        return UNITS.get(self.name, "") if is_number else ""


def judge(
    name: str, margin: float, if_true: str, if_false: str, scope: Scope = "model"
) -> Condition:
    """Return a condition with the one of two sentences that its margin makes true."""
    return Condition(name, float(margin), if_true if margin >= 0 else if_false, scope)


@dataclass(frozen=True, repr=False)
class Certificate:
    """The conditions of a design, in the order in which they were checked, and what they take for
    granted.

    Without conditions nothing was checked, so nothing is certified. `table` writes all conditions
    with their margins and sentences.
    """

    checked: tuple[Condition, ...] = ()
    assumptions: tuple[str, ...] = ()

    @cached_property
    def conditions(self) -> dict[str, Condition]:
        """The conditions by name."""
        return {condition.name: condition for condition in self.checked}

    @property
    def holds_for_model(self) -> bool:
        """Whether the linear model with w in W is certified."""
        return bool(self.checked) and not self.failing_for_model

    @property
    def holds_for_robot(self) -> bool:
        """Whether the robot itself is certified: the model is, and W and the wheels hold too."""
        of_robot = any(condition.scope == "robot" for condition in self.checked)
        return of_robot and not self.failing

    @property
    def failing(self) -> list[str]:
        """Names of the conditions of model and robot that fail."""
        return [condition.name for condition in self._failing("model", "robot")]

    @property
    def failing_for_model(self) -> list[str]:
        """Names of the conditions of the model that fail."""
        return [condition.name for condition in self._failing("model")]

    @property
    def reasons(self) -> list[str]:
        """What the conditions that fail say."""
        return [condition.sentence for condition in self._failing("model", "robot")]

    @property
    def verdict(self) -> str:
        """One line: for what the design is certified, and what fails."""
        if self.holds_for_robot:
            return "CERTIFIED: every required condition holds"
        if self.holds_for_model:
            missing = ", ".join(self.failing) or "its disturbances were not checked"
            return (
                "CERTIFIED for the linear model with w in W alone; "
                f"NOT CERTIFIED for the robot: {missing}"
            )
        return f"NOT CERTIFIED: {', '.join(self.failing) or 'nothing was checked'}"

    def table(self) -> str:
        """Return all conditions with their margins and sentences as text, as the command `design`
        prints them: those required, then those for information."""
        required = [condition.describe() for condition in self.checked if condition.required]
        others = [condition.describe() for condition in self.checked if not condition.required]
        heading = ["", "for information"] if others else []
        return "\n".join([*required, *heading, *others])

    def _failing(self, *scopes: Scope) -> list[Condition]:
        return [
            condition
            for condition in self.checked
            if condition.scope in scopes and not condition.holds
        ]

    def __repr__(self) -> str:
        required = [condition for condition in self.checked if condition.required]
        held = sum(condition.holds for condition in required)
        lines = [self.verdict, f"{held} of {len(required)} required conditions hold"]
        return "\n  ".join(lines + self.reasons)


def nonempty_margin(polytopes: Iterable[Polytope]) -> float:
    """Return the smallest radius of a ball inside any of the sets; negative or -inf where one is
    empty."""
    balls = [polytope.chebyshev() for polytope in polytopes]
    return min(radius for _, radius in balls)


def _transport(
    loops: Float[np.ndarray, "v n n"],
    directions: Float[np.ndarray, "k n"],
    sums: Float[np.ndarray, " k"],
) -> tuple[Float[np.ndarray, "kv n"], Float[np.ndarray, " kv"]]:
    """Return directions and sums one loop earlier; only extreme ones can carry a maximum of a
    convex function."""
    directions = np.concatenate([directions @ loop for loop in loops])
    sums = np.tile(sums, len(loops))
    if len(sums) <= MOST_DIRECTIONS:
        return directions, sums
    cloud = np.column_stack([directions, sums])
    extreme = _find_extreme(cloud / np.maximum(np.abs(cloud).max(axis=0), 1e-300))
    return directions[extreme], sums[extreme]


def _find_extreme(cloud: Float[np.ndarray, "k m"]) -> Int[np.ndarray, " e"]:
    """Return the indices of the extreme points, up to a displacement of 1e-10.

    All of them where clusters of almost equal points stop qhull: pruning saves time, no more.
    """
    for options in ("QJ", None):
        try:
            return ConvexHull(cloud, qhull_options=options).vertices
        except QhullError:
            continue
    return np.arange(len(cloud))


def reach_supports(
    loops: Float[np.ndarray, "v n n"],
    disturbance: Float[np.ndarray, "w n"],
    direction: Float[np.ndarray, " n"],
    steps: int,
) -> tuple[Float[np.ndarray, " steps+1"], Float[np.ndarray, " steps+1"]]:
    """Return, for j = 0..steps, the reach of j steps along `direction` and the largest h_W(Psi_j^T
    direction).

    Maxima over every product of j vertex loops; `disturbance` holds the vertices of W.
    """
    directions = direction[None, :]
    sums = np.zeros(1)
    reach = np.zeros(steps + 1)
    last = np.zeros(steps + 1)
    for j in range(steps + 1):
        widths = np.max(directions @ disturbance.T, axis=1)
        reach[j] = sums.max()
        last[j] = widths.max()
        if j < steps:
            directions, sums = _transport(loops, directions, sums + widths)
    return reach, last


def sequence_reach(
    loops: Float[np.ndarray, "horizon n n"],
    disturbance: Float[np.ndarray, "w n"] | Sequence[Float[np.ndarray, "w n"]],
    directions: Float[np.ndarray, "k n"],
) -> tuple[Float[np.ndarray, "horizon+1 k"], Float[np.ndarray, "horizon k"]]:
    """Return reach by simulation of worst cases along one schedule: h_{R_j}, and h_W([loops[j] ..
    loops[1]]^T c) of the first period's W.

    `disturbance` holds the vertices of W, or of one W a period. The matrices Psi are formed
    forwards, one disturbance instant at a time.
    """
    horizon, dimension = loops.shape[:2]
    reach = np.zeros((horizon + 1, len(directions)))
    last = np.zeros((horizon, len(directions)))
    is_one = isinstance(disturbance, np.ndarray)
    for instant in range(horizon):
        points = disturbance if is_one else disturbance[instant]
        transport = np.eye(dimension)
        for j in range(instant + 1, horizon + 1):
            width = np.max(directions @ transport @ points.T, axis=1)
            reach[j] += width
            if instant == 0:
                last[j - 1] = width
            if j < horizon:
                transport = loops[j] @ transport
    return reach, last


def escape_excess(
    loops: Float[np.ndarray, "v n n"],
    disturbance: Float[np.ndarray, "w n"] | Sequence[Float[np.ndarray, "w n"]],
    normal: Float[np.ndarray, " n"],
    offset: float,
    path: tuple[int, ...],
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Simulate the worst disturbances from the origin along `path`: return (normal x - offset, x)
    at its end.

    `disturbance` holds the vertices of W, or of one W a loop.

    A positive excess proves that no invariant set fits: it would contain the origin and with it
    this x. Of disturbances that are equally bad the first is taken.
    """
    rows = [normal]
    for index in reversed(path):
        rows.append(rows[-1] @ loops[index])
    is_one = isinstance(disturbance, np.ndarray)
    # The first disturbance meets the origin, which every loop leaves where it is.
    first = disturbance if is_one else np.concatenate(disturbance)
    state = _find_worst(first, rows[-1])
    for index, row in zip(path, reversed(rows[:-1]), strict=True):
        points = disturbance if is_one else disturbance[index]
        state = loops[index] @ state + _find_worst(points, row)
    return float(normal @ state - offset), state


def _find_worst(
    disturbance: Float[np.ndarray, "w n"], row: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the vertex furthest along the row; among vertices equal up to rounding, the first."""
    heights = disturbance @ row
    slack = ROUNDING * np.abs(heights).max()
    return disturbance[np.flatnonzero(heights >= heights.max() - slack)[0]]


def invariance_margin(
    loops: Float[np.ndarray, "v n n"], disturbance: Float[np.ndarray, "w n"], polytope: Polytope
) -> float:
    """Return the least of h - h_O(H Phi_i) - h_W(H) over unit facets and vertices; >= 0 exactly
    when invariant."""
    normals, offsets = _unit_rows(polytope)
    room = offsets - np.max(normals @ disturbance.T, axis=1)
    margins = [np.min(room - polytope.support(normals @ loop)) for loop in loops]
    return float(min(margins))


def _unit_rows(
    polytope: Polytope,
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " k"]]:
    """Return the rows with normals of length one."""
    scale = np.linalg.norm(polytope.normals, axis=1)
    return polytope.normals / scale[:, None], polytope.offsets / scale


def decrease_margin(
    loops: Float[np.ndarray, "v n n"],
    gains: Float[np.ndarray, "v m n"],
    cost: Float[np.ndarray, "n n"],
    error_weight: Float[np.ndarray, "n n"],
    input_weight: Float[np.ndarray, "m m"],
) -> float:
    """Return the least eigenvalue of P - Phi_i^T P Phi_i - Q - Gamma_i^T R Gamma_i over the
    vertices."""
    margins = []
    for loop, gain in zip(loops, gains, strict=True):
        decrease = cost - loop.T @ cost @ loop
        surplus = decrease - error_weight - gain.T @ input_weight @ gain
        margins.append(np.linalg.eigvalsh(surplus)[0])
    return float(min(margins))


def terminal_margins(
    terminal: Polytope,
    next_terminal: Polytope,
    terminal_loops: Float[np.ndarray, "v n n"],
    last_error_set: Polytope,
    last_input_rows: Float[np.ndarray, "g k n"],
    last_input_offsets: Float[np.ndarray, " k"],
    last_reach: Float[np.ndarray, "p n"],
) -> dict[str, float]:
    """Return the margins of the three terminal inclusions for the shifted plan (module docstring,
    `terminal`).

    `next_terminal` is the constraint of the next step, the same one unless the tube follows the
    reference; the hull of the points `last_reach`, flat or not, holds Psi w for every product of N
    - 1 loops; `last_error_set` is E_{N-1}, and errors in U_{N-1} under each terminal gain are those
    with rows e <= offsets.
    """

    def room(rows: Float[np.ndarray, "k n"], offsets: Float[np.ndarray, " k"]) -> float:
        reach = np.max(rows @ last_reach.T, axis=1)
        return float(np.min(offsets - terminal.support(rows) - reach))

    normals, offsets = _unit_rows(next_terminal)
    return {
        "admissible_errors": room(*_unit_rows(last_error_set)),
        "admissible_inputs": min(room(rows, last_input_offsets) for rows in last_input_rows),
        "returns": min(room(normals @ loop, offsets) for loop in terminal_loops),
    }
