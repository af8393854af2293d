"""`falsify`: the worst case of a closed loop, searched by gradient and compared with drawn laps in
equal time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, overload

from jaxtube.falsification.cases import Row, say_verdict
from jaxtube.falsification.found import WorstCases
from jaxtube.falsification.linear import LinearFalsification, make_linear_setting
from jaxtube.falsification.sample import SampledExtremes, sample
from jaxtube.falsification.search import WorstCaseSearch, search_worst_cases
from jaxtube.falsification.setting import (
    Setting,
    draw_starts,
    make_loop_limits,
    make_setting,
)
from jaxtube.falsification.storing import list_row_arrays, read_row
from jaxtube.falsification.worst import Worst
from jaxtube.precision import in_64_bits
from jaxtube.progress import show_progress
from jaxtube.simulation.choices import (
    ControllerChoice,
    PlantChoice,
    SlipChoice,
    find_plant,
    refuse_slip,
)
from jaxtube.storage import StoredResult, flatten, nest, write_result
from jaxtube.synthesis.parts import Design, LinearDesign, require_design

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Falsification(WorstCases[Design]):
    """The worst cases of a robot's closed loop.

    Attributes:
        limits: that were searched, and whose they are.
        seed: of every draw.
        rows: by limit: the worst case, its search, and drawn laps to compare with.
    """

    @property
    def verdict(self) -> str:
        """What was found, in one line."""
        return say_verdict(self.limits, self.rows)

    def plot(self, limit: str = "") -> Figure:
        """Draw the worst case of a limit, of all limits unless one is named; return the figure.

        For "tube" it shows the deviation from the plan in its section, else the lap and its attack.

        Raises:
            ValueError: for a limit that was not searched.
        """
        from jaxtube.figures.worst import worst_run
        from jaxtube.figures.worst_section import worst_section

        name = limit or self.worst.limit
        if name not in self.rows:
            raise ValueError(f"limit = {name!r}: was not searched; choose one of {list(self.rows)}")
        row = self.rows[name]
        if name == "tube":
            return worst_section(self.design, row.worst, row.played)
        reaches = (row.search.reach, row.sampled.reach)
        return worst_run(self.design.problem, self.limits.of_laps, row.worst, row.played, reaches)

    def save(self, folder: str | Path) -> Path:
        """Save the worst cases in a folder, for `jaxtube.read`, in place of some that were saved
        there; return the folder."""
        facts = {
            "controller": self.limits.controller,
            "plant": self.limits.plant,
            "limits": list(self.limits.all),
            "rows": list(self.rows),
            "seed": self.seed,
        }
        arrays = flatten({name: list_row_arrays(row) for name, row in self.rows.items()})
        scenario = self.design.problem.scenario
        return write_result(folder, StoredResult("falsification", scenario, facts, arrays))

    @classmethod
    def restore(cls, design: Design, stored: StoredResult) -> Falsification:
        """Return worst cases that were saved, of their design made again."""
        facts = stored.facts
        limits = make_loop_limits(design, facts["controller"], facts["plant"], facts["limits"])
        arrays = nest(stored.arrays)
        rows = {name: read_row(name, arrays[name]) for name in facts["rows"]}
        return cls(limits, facts["seed"], rows)


@overload
def falsify(
    design: Design,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    target: str = "all",
    starts: str = "scenario",
    slip: SlipChoice = None,
    seconds: float = 60.0,
    seed: int = 0,
) -> Falsification: ...


@overload
def falsify(
    design: LinearDesign,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    target: str = "all",
    starts: str = "scenario",
    slip: SlipChoice = None,
    seconds: float = 60.0,
    seed: int = 0,
) -> LinearFalsification: ...


@in_64_bits
def falsify(
    design: Design | LinearDesign,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    target: str = "all",
    starts: str = "scenario",
    slip: SlipChoice = None,
    seconds: float = 60.0,
    seed: int = 0,
) -> Falsification | LinearFalsification:
    """Search the smallest margins of a closed loop by gradient, over everything bounded that its
    plant would draw.

    Args:
        design: whose limits are searched.
        controller: as for `simulate`.
        plant: as for `simulate`; a plant of your own says what bounds its draws
            (`jaxtube.plant.protocol.SearchablePlant`).
        target: "error" (E), "input" (U and the wheels' limits), "tube" (the sections around a plan
            that is followed), or "all".
        starts: "scenario", or "feasible": anywhere in the feasible set of the tube-MPC.
        slip: the scenario's process unless given; "iid" or "constant", others are not boxes.
        seconds: of all searches, without compilation; drawn laps take as long again.
        seed: of every draw.

    Returns:
        The worst cases, each as its replay has it. Where none is violated, nothing is proved.

    Raises:
        ValueError: one line, for an unknown name, or a slip process or a plant that is not
            searched.
    """
    require_design(design, or_linear=True)
    _refuse_seconds(seconds)
    plant = find_plant(design, plant)
    if isinstance(design, LinearDesign):
        refuse_slip(slip)
        setting = make_linear_setting(design, controller, plant, starts, seed)
    else:
        setting = make_setting(design, controller, plant, starts, slip, seed)
    names = setting.limits.choose_names(target)
    with show_progress(2 * len(names), "searching", "limits") as bar:
        rows = search_rows(setting, target, seconds=seconds, seed=seed, on_progress=bar.update)
    if isinstance(design, LinearDesign):
        return LinearFalsification(setting.limits, seed, rows)
    return Falsification(setting.limits, seed, rows)


def search_setting(
    setting: Setting,
    target: str = "all",
    *,
    seconds: float = 60.0,
    seed: int = 0,
    on_progress: Callable[[], object] | None = None,
) -> Falsification:
    """Search each limit of a target for its share of the time, then draw laps for as long as the
    searches took; arguments as for `search_rows`."""
    _refuse_seconds(seconds)
    rows = search_rows(setting, target, seconds=seconds, seed=seed, on_progress=on_progress)
    return Falsification(setting.limits, seed, rows)


def search_rows(
    setting: Setting,
    target: str,
    *,
    seconds: float,
    seed: int,
    on_progress: Callable[[], object] | None = None,
) -> dict[str, Row]:
    """Return what the search of each limit of a target found, by name.

    Args:
        setting: what is searched.
        target: as for `falsify`.
        seconds: as for `falsify`.
        seed: of every draw.
        on_progress: called whenever a limit has been searched, and again when its laps are drawn.
    """
    names = setting.limits.choose_names(target)
    searches: dict[str, WorstCaseSearch] = {}
    for name in names:
        searches[name] = search_worst_cases(
            setting.loop(name),
            setting.starts,
            aims=[name],
            seconds=seconds / len(names),
            seed=seed,
        )
        if on_progress:
            on_progress()
    sampled = _sample_limits(setting, searches, seed, on_progress)
    rows = {}
    for name in names:
        worst = _find_worst(name, searches)
        rows[name] = Row(worst, searches[name], sampled[name], setting.replay(worst))
    return rows


def _refuse_seconds(seconds: float) -> None:
    """Raise ValueError for what is no time."""
    if not 0 < seconds < math.inf:
        raise ValueError(f"seconds = {seconds}: is no time; give a positive number")


def _sample_limits(
    setting: Setting,
    searches: dict[str, WorstCaseSearch],
    seed: int,
    on_progress: Callable[[], object] | None,
) -> dict[str, SampledExtremes]:
    """Draw laps for as long as the searches took; one draw serves all limits of a lap."""
    pool = draw_starts(setting, seed)
    of_laps = [name for name in searches if name != "tube"]
    of_plans = [name for name in searches if name == "tube"]
    sampled: dict[str, SampledExtremes] = {}
    for group in (of_laps, of_plans):
        if not group:
            continue
        drawn = sample(
            setting.loop(group[0]),
            pool,
            seconds=sum(searches[name].seconds for name in group),
            seed=seed,
        )
        for name in group:
            sampled[name] = drawn
            if on_progress:
                on_progress()
    return sampled


def _find_worst(name: str, searches: dict[str, WorstCaseSearch]) -> Worst:
    """Return the worst case of a limit, which may have been met on the way to another one."""
    cases = [search.worst[name] for search in searches.values() if name in search.worst]
    return max(cases, key=lambda worst: worst.usage)
