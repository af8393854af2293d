"""What a search found of one limit as arrays, nested by name, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxtube.falsification.cases import Row
from jaxtube.falsification.sample import SampledExtremes
from jaxtube.falsification.search import WorstCaseSearch
from jaxtube.falsification.worst import Worst
from jaxtube.simulation.rollout import read_trajectory
from jaxtube.simulation.usage import Replay
from jaxtube.storage import Arrays

NUMBERS = {"usage": float, "margin": float, "step": int, "facet": int, "when": int}
"""The numbers of a worst case, and their types."""


def list_row_arrays(row: Row) -> Arrays:
    """Return all of a row, nested by name."""
    search = row.search
    return {
        "worst": _list_worst_arrays(row.worst),
        "search": {
            "worst": {name: _list_worst_arrays(worst) for name, worst in search.worst.items()},
            "reach": search.reach,
            "laps": search.laps,
            "seconds": search.seconds,
            "course": {
                "seconds": [second for second, _, _ in search.course],
                "limit": [name for _, name, _ in search.course],
                "usage": [usage for _, _, usage in search.course],
            },
        },
        "sampled": {
            "reach": row.sampled.reach,
            "laps": row.sampled.laps,
            "seconds": row.sampled.seconds,
        },
        "played": _list_replay_arrays(row.played),
    }


def read_row(name: str, arrays: Mapping[str, Any]) -> Row:
    """Return the row of a limit from what `list_row_arrays` made of it."""
    return Row(
        worst=_read_worst(name, arrays["worst"]),
        search=_read_search(arrays["search"]),
        sampled=SampledExtremes(**_read_extremes(arrays["sampled"])),
        played=_read_replay(arrays["played"]),
    )


def _list_worst_arrays(worst: Worst) -> Arrays:
    return {name: getattr(worst, name) for name in NUMBERS} | {"attack": worst.attack}


def _read_worst(limit: str, arrays: Mapping[str, Any]) -> Worst:
    numbers = {name: kind(arrays[name]) for name, kind in NUMBERS.items()}
    return Worst(limit=limit, attack=arrays["attack"], **numbers)


def _read_search(arrays: Mapping[str, Any]) -> WorstCaseSearch:
    course = arrays["course"]
    columns = [course[name].tolist() for name in ("seconds", "limit", "usage")]
    worst = {name: _read_worst(name, case) for name, case in arrays["worst"].items()}
    return WorstCaseSearch(
        worst=worst, course=list(zip(*columns, strict=True)), **_read_extremes(arrays)
    )


def _read_extremes(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a search and drawn laps have in common."""
    return {
        "reach": arrays["reach"],
        "laps": int(arrays["laps"]),
        "seconds": float(arrays["seconds"]),
    }


def _list_replay_arrays(played: Replay) -> Arrays:
    arrays = {"trajectory": played.trajectory.arrays()}
    if played.deviations is None:
        return arrays
    return arrays | {"deviations": played.deviations}


def _read_replay(arrays: Mapping[str, Any]) -> Replay:
    return Replay(read_trajectory(arrays["trajectory"]), arrays.get("deviations"))
