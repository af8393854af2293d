"""The events of a lap that a Monte Carlo run counts, period by period.

One table for all who count, report, draw or save them. The test of each stands in
`jaxtube.statistics.tally.find_events`.
"""

from __future__ import annotations

from typing import NamedTuple


class Event(NamedTuple):
    """One event.

    Attributes:
        name: in statistics, metrics and files.
        words: in tables and figures.
        meaning: one sentence.
        part: what it is a part of: indented below it in tables; "" for an event of its own.
        needs: what a run must have for the event to be possible: a "QP" or "wheels", a "bound" that
            is finite, a limit of "acceleration", "learning" of slips; "" for nothing.
    """

    name: str
    words: str
    meaning: str
    part: str = ""
    needs: str = ""


EVENTS = (
    Event(
        "w_outside_W", "w outside W", "the disturbance of a period lies outside the disturbance set"
    ),
    Event("w_outside_longitudinal", "longitudinal", "outside the box around W", "w_outside_W"),
    Event("w_outside_lateral", "lateral", "outside the box around W", "w_outside_W"),
    Event("w_outside_heading", "heading", "outside the box around W", "w_outside_W"),
    Event("e_outside_E", "e outside E", "the true error lies outside the error constraints"),
    Event("e_outside_longitudinal", "longitudinal", "outside the box around E", "e_outside_E"),
    Event("e_outside_lateral", "lateral", "outside the box around E", "e_outside_E"),
    Event("e_outside_heading", "heading", "outside the box around E", "e_outside_E"),
    Event(
        "u_outside_U",
        "u outside U",
        "the virtual input leaves the input constraints, or their coupling to the error",
    ),
    Event(
        "wheels_saturated",
        "wheels at their limits",
        "a wheel is asked for more than it can do",
        needs="wheels",
    ),
    Event("qp_infeasible", "QP infeasible", "the QP is proved to have no solution", needs="QP"),
    Event("qp_unsolved", "QP unsolved", "the solver neither solves nor refutes it", needs="QP"),
    Event("row_active", "some row active", "a constraint of the plan is active", needs="QP"),
    Event(
        "backup",
        "backup in use",
        "without a new plan the last one goes on, then a gain",
        needs="QP",
    ),
    Event(
        "outside_ultimate_bound",
        "outside the ultimate bound",
        "the settled error lies outside what it should end within",
        needs="bound",
    ),
    Event(
        "acceleration_exceeded",
        "acceleration beyond its limit",
        "a wheel's command changes from the period before by more than its acceleration allows",
        needs="acceleration",
    ),
    Event(
        "slip_outside_interval",
        "slip outside its interval",
        "a true slip lies outside of the interval that was learnt, or that interval is wider than "
        "the design says",
        needs="learning",
    ),
    Event("not_finite", "not finite", "an error or an input is not a finite number"),
)
"""In the order of the rows of `statistics["events"]`."""

EVENT_NAMES = tuple(event.name for event in EVENTS)

VIOLATIONS = (
    "w_outside_W",
    "e_outside_E",
    "u_outside_U",
    "wheels_saturated",
    "acceleration_exceeded",
    "slip_outside_interval",
    "qp_infeasible",
    "qp_unsolved",
    "not_finite",
)
"""Names of the events that must not happen, of those that a run can have."""


def find_event(name: str) -> Event:
    """Return the event of a name."""
    return EVENTS[find_row(name)]


def find_row(name: str) -> int:
    """Return the row of an event in `statistics["events"]`."""
    return EVENT_NAMES.index(name)
