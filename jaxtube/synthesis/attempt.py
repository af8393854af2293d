"""Attempts to hold a scenario with one quantity scaled: a search for caps and gains, a design, its
certificate, and the plan of its start.

Source: new.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.descent import PENALTY
from jaxtube.synthesis.design import design, find_share_of_start
from jaxtube.synthesis.levers import Lever
from jaxtube.synthesis.optimise import optimise, optimise_nearby
from jaxtube.synthesis.optimum import LIMIT_ROOM, Optimum
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import caps_and_gains

HOLDS_IN_FILES = "is_certified"
"""Key of `Attempt.holds` in files of runs, where most attempts are designs."""


@dataclass(frozen=True)
class Attempt:
    """A design that was tried.

    Attributes:
        factor: of the quantity.
        value: of the quantity (`Lever.measure`), None where no scenario may have it.
        ratio: largest share of a cap that the tube fills, estimated; None where no caps keep the
            limits, or no tube is bounded.
        level: objective of the search (`synthesis.descent`), the logarithm of the ratio where
            limits are kept, larger where they are passed; None where no tube is bounded.
        binding: the row of `descent.ROWS` that binds most; empty without a search's end.
        caps_and_gains: of the best design found, None without one.
        holds: of a design, whether its certificate holds and the start has a plan; of a search,
            whether its estimate lets it hold.
        reason: what denies it; empty where it holds.
    """

    factor: float
    value: float | None = None
    ratio: float | None = None
    level: float | None = None
    binding: str = ""
    caps_and_gains: tuple[float, ...] | None = None
    holds: bool = False
    reason: str = ""

    def to_record(self) -> dict[str, Any]:
        """Return the attempt as files of runs have it: there `holds` is called `is_certified`."""
        record = asdict(self)
        return {HOLDS_IN_FILES if name == "holds" else name: record[name] for name in record}


def read_attempt(record: Mapping[str, Any]) -> Attempt:
    """Return an attempt from its record, whose tuples are lists."""
    values = {"holds" if name == HOLDS_IN_FILES else name: record[name] for name in record}
    caps = values["caps_and_gains"]
    return Attempt(**{**values, "caps_and_gains": None if caps is None else tuple(caps)})


def attempt_design(
    scenario: Scenario, lever: Lever, factor: float, near: Sequence[float] | None
) -> Attempt:
    """Scale the quantity of a scenario without caps and gains, search them, design and certify."""
    try:
        scaled = lever.scale(scenario, factor)
        made = optimise(make_problem(scaled), near=near)
    except ValueError as error:
        return Attempt(factor, reason=str(error))
    tried = _describe_search(factor, lever, made)
    if not made.holds:
        return tried
    reason = find_fault(made.scenario)
    return replace(tried, holds=not reason, reason=reason)


def attempt_search(
    scenario: Scenario, lever: Lever, factor: float, near: Sequence[float] | None
) -> Attempt:
    """Scale the quantity of a scenario without caps and gains, and search them from some nearby
    alone, where any are given; nothing is certified."""
    try:
        scaled = lever.scale(scenario, factor)
        problem = make_problem(scaled)
        made = optimise(problem) if near is None else optimise_nearby(problem, near)
    except ValueError as error:
        return Attempt(factor, reason=str(error))
    if made is None:
        return Attempt(factor, lever.measure(scaled), reason="no bounded tube nearby")
    return replace(_describe_search(factor, lever, made), holds=made.holds)


def _describe_search(factor: float, lever: Lever, made: Optimum) -> Attempt:
    """Return the attempt that a search was, as far as the estimate goes."""
    return Attempt(
        factor=factor,
        value=lever.measure(made.scenario),
        ratio=made.ratio if made.keeps_limits else None,
        level=math.log(made.ratio) + PENALTY * math.log(max(made.excess / LIMIT_ROOM, 1.0)),
        binding=made.binding,
        caps_and_gains=caps_and_gains(made.scenario),
        reason="" if made.holds else made.describe_binding(),
    )


def find_fault(scenario: Scenario) -> str:
    """Return what a design lacks to be certified and driven, empty where nothing."""
    try:
        designed = design(scenario)
        failing = designed.certificate.failing
        if failing:
            return f"the certificate fails: {', '.join(failing)}"
    except ValueError as error:
        return str(error)
    share = find_share_of_start(designed)
    if share < 1:
        return (
            f"of the start no more than {share:.1%} of its distance has a plan; start nearer, or "
            "lengthen controller.horizon"
        )
    return ""
