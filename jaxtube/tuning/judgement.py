"""Judgement of a point: its objective over laps, each lap's numbers, and what its certificate
lacks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.tuning.objective import Aim, LapMeasures, lap_costs, total_cost
from jaxtube.tuning.parameters import Point

LAP_ARRAYS = ("costs", "errors", "effort", "settled_effort", "backups", "shares")


def pool(values: Float[np.ndarray, " laps"]) -> float:
    """Return the RMS over all laps of RMS values of each."""
    return float(np.sqrt(np.mean(values**2)))


class HeldOutJudgement(NamedTuple):
    """What laps and a certificate say of a point; the arrays are empty where nothing could be
    played."""

    point: Point
    held_out: float  # objective over the laps, infinite without a closed loop
    certified: bool
    failing: tuple[str, ...]
    costs: Float[np.ndarray, " laps"]
    errors: Float[np.ndarray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[np.ndarray, " laps"]  # RMS over the whole lap, m/s
    settled_effort: Float[np.ndarray, " laps"]
    backups: Float[np.ndarray, " laps"]  # steps without a plan
    shares: Float[np.ndarray, " caps"]  # of each cap that the tube fills at its widest

    @property
    def has_laps(self) -> bool:
        """Whether there was a closed loop to play."""
        return len(self.costs) > 0

    @property
    def lateral(self) -> float:
        """RMS lateral error over all laps once settled, m."""
        return pool(self.errors[:, 1])

    @property
    def overall_effort(self) -> float:
        """RMS effort over all laps, m/s."""
        return pool(self.effort)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all but the point as arrays, for a log."""
        return {
            "held_out": np.array(self.held_out),
            "certified": np.array(self.certified),
            "failing": np.frombuffer("; ".join(self.failing).encode(), np.uint8),
            **{name: getattr(self, name) for name in LAP_ARRAYS},
        }


def read_judgement(point: Point, arrays: Mapping[str, np.ndarray]) -> HeldOutJudgement:
    """Return the judgement that `HeldOutJudgement.arrays` wrote."""
    words = bytes(arrays["failing"]).decode().split("; ")
    return HeldOutJudgement(
        point=point,
        held_out=float(arrays["held_out"]),
        certified=bool(arrays["certified"]),
        failing=tuple(word for word in words if word),
        **{name: arrays[name] for name in LAP_ARRAYS},
    )


def judge_laps(
    point: Point,
    laps: LapMeasures,
    shares: Float[np.ndarray, " caps"],
    aim: Aim,
    failing: tuple[str, ...],
) -> HeldOutJudgement:
    """Return the judgement of a point from its laps (as numpy arrays) and what its certificate
    lacks."""
    return HeldOutJudgement(
        point=point,
        held_out=float(total_cost(laps, jnp.asarray(shares), aim)),
        certified=not failing,
        failing=failing,
        costs=np.asarray(lap_costs(laps, aim)),
        errors=laps.errors,
        effort=laps.effort,
        settled_effort=laps.settled_effort,
        backups=laps.backups,
        shares=shares,
    )


def judge_without_laps(point: Point, reason: str) -> HeldOutJudgement:
    """Return the judgement of a point that has no closed loop."""
    empty = np.empty(0)
    return HeldOutJudgement(
        point=point,
        held_out=np.inf,
        certified=False,
        failing=(reason,),
        costs=empty,
        errors=np.empty((0, 3)),
        effort=empty,
        settled_effort=empty,
        backups=empty,
        shares=empty,
    )
