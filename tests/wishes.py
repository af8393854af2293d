"""Wheel speeds that robots are asked for, of which nothing is known ahead: each period asks for
another window, anywhere in the certified box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxtube import qp
from jaxtube.simulation.governing import LivePlanner

TRIED = 6
"""Windows among which an adversary looks for one without a plan."""


def draw_corners(generator, box, robots, horizon):
    """Corners of the box, anew in every period of every window."""
    sides = generator.integers(0, 2, (robots, horizon, 2))
    return np.where(sides == 1, box[1], box[0])


def draw_inside(generator, box, robots, horizon):
    """Wheel speeds all over the box, anew in every period of every window."""
    return generator.uniform(*box, (robots, horizon, 2))


def hold_corner(generator, box, robots, horizon):
    """One corner of the box for the whole window, another one in the next period."""
    return np.repeat(draw_corners(generator, box, robots, 1), horizon, axis=1)


LAWS = {"corners": draw_corners, "inside": draw_inside, "held": hold_corner}


@dataclass(frozen=True)
class Wishes:
    """A law of `LAWS` for so many robots."""

    law: Callable
    planner: LivePlanner
    seed: int = 0

    def __call__(self, period, errors):
        generator = np.random.default_rng([self.seed, period])
        horizon = self.planner.live.design.problem.horizon
        return self.law(generator, self.planner.live.box, len(errors), horizon)


@dataclass(frozen=True)
class AdversarialWishes:
    """Of some windows of corners one without a plan, where there is one."""

    planner: LivePlanner
    seed: int = 0

    def __call__(self, period, errors):
        generator = np.random.default_rng([self.seed, period])
        design = self.planner.live.design
        robots = len(errors)
        windows = draw_corners(
            generator, self.planner.live.box, TRIED * robots, design.problem.horizon
        ).reshape(TRIED, robots, design.problem.horizon, 2)
        omega = design.terminal.invariant
        wished = windows[0].copy()
        # From within Omega every window has a plan.
        outside = np.flatnonzero(np.any(errors @ omega.normals.T > omega.offsets, axis=1))
        if len(outside):
            tried = windows[:, outside].reshape(-1, *windows.shape[2:])
            status = self.planner.plan(tried, np.tile(errors[outside], (TRIED, 1))).status
            has_none = status.reshape(TRIED, -1) != qp.SOLVED
            wished[outside] = windows[has_none.argmax(axis=0), outside]
        return wished
