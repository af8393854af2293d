"""`falsify`: the smallest margins of a closed loop, searched by gradient and compared with drawn
laps in equal time.

Every margin that is printed is that of a replay: the attack is played once more on its own by the
ordinary rollout.
"""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np

from jaxtube.experiments.falsify.report import Row, facet, metrics, report, violated
from jaxtube.experiments.options import FalsifyOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.progress import progress
from jaxtube.falsification.search import Search, Worst, falsify, replayed
from jaxtube.falsification.setting import Setting, drawn_starts, make_setting
from jaxtube.scenario import Scenario, to_toml
from jaxtube.scenario.refusal import refusal
from jaxtube.simulation import usage
from jaxtube.simulation.usage import Replay

TARGETS = {"error": ("error",), "input": ("input", "wheels"), "tube": ("tube",)}
"""The limits of each target."""


def run(scenario: Scenario, options: FalsifyOptions) -> int:
    """Run the command; returns 0, whatever was found."""
    if options.replay:
        return play_again(scenario, options)
    names = limit_names(options)
    setting = make_setting(
        scenario, options.controller, options.plant, options.starts, options.seed
    )
    folder = run_folder.create(scenario, options)
    rows = search(setting, names, options)
    folder.report(report(setting, rows))
    folder.save_metrics(metrics(setting, rows))
    for name, row in rows.items():
        played = usage.replay(
            setting.loop(name), setting.plant, row.worst.attack, name, row.worst.when
        )
        save(scenario, options, folder, name, row.worst, played)
        draw(setting, folder, f"worst_{name}", name, row.worst, played, row)
    print(f"\nworst cases, figures, metrics.json and manifest.json are in {folder.path}/")
    return 0


def limit_names(options: FalsifyOptions) -> list[str]:
    """Return the limits that are searched, in the order of the table."""
    if not 0 < options.seconds < np.inf:
        raise refusal(
            "command line", "--seconds", options.seconds, "is no time", "give a positive number"
        )
    names = [
        name
        for target, group in TARGETS.items()
        if options.target in (target, "all")
        for name in group
    ]
    if options.controller != "tube_mpc" and options.target == "tube":
        cure = "choose --controller tube_mpc"
        raise refusal(
            "command line", "--target", "tube", f"{options.controller} keeps no tube", cure
        )
    absent = {"tube"} if options.controller != "tube_mpc" else set()
    return [
        name
        for name in names
        if name not in absent | ({"wheels"} if options.plant == "linear" else set())
    ]


def search(setting: Setting, names: list[str], options: FalsifyOptions) -> dict[str, Row]:
    """Search each limit for its share of the time, then draw laps for as long as the searches took."""
    pool, found, sampled = drawn_starts(setting, options.seed), {}, {}
    with progress(2 * len(names), "searching", "limits") as bar:
        for name in names:
            given = setting.loop(name), setting.plant, setting.limits(name), setting.starts
            share, windows = options.seconds / len(names), setting.windows
            found[name] = falsify(
                *given, aims=[name], windows=windows, seconds=share, seed=options.seed
            )
            bar.update()
        for group in (
            [name for name in names if name != "tube"],
            [name for name in names if name == "tube"],
        ):
            if group:
                given = setting.loop(group[0]), setting.plant, setting.limits(group[0]), pool
                seconds = sum(found[name].seconds for name in group)
                drawn = usage.sample(
                    *given, windows=setting.windows, seconds=seconds, seed=options.seed
                )
                sampled |= dict.fromkeys(group, drawn)
                bar.update(len(group))
    return {name: Row(_worst(name, found), found[name], sampled[name]) for name in names}


def _worst(name: str, found: dict[str, Search]) -> Worst:
    """Return the worst case of a limit, which may have been met on the way to another one."""
    return max(
        (each.worst[name] for each in found.values() if name in each.worst),
        key=lambda worst: worst.usage,
    )


def draw(
    setting: Setting,
    folder: RunFolder,
    title: str,
    name: str,
    worst: Worst,
    played: Replay,
    row=None,
) -> None:
    """Draw a worst case: its lap, and for the tube the section that it comes nearest to."""
    from jaxtube.experiments.falsify.figures import worst_run
    from jaxtube.experiments.falsify.section_figure import worst_section

    problem = setting.found.problem
    reaches = (row.search.reach, row.sampled.reach) if row and name != "tube" else None
    figure = worst_run(problem, setting.lap_limits, name, worst, played, reaches)
    folder.save_figure(figure, title)
    if name == "tube":
        folder.save_figure(worst_section(setting.found, worst, played), f"{title}_section")


def save(
    scenario: Scenario,
    options: FalsifyOptions,
    folder: RunFolder,
    name: str,
    worst: Worst,
    played: Replay,
) -> None:
    """Save what it takes to play a worst case again, and what came out."""
    kind = "counterexample" if violated(worst) else "worst"
    lap = played.trajectory
    numbers = {key: value for key, value in dataclasses.asdict(worst).items() if key != "attack"}
    folder.save_arrays(
        f"{kind}_{name}",
        scenario=to_toml(scenario),
        limit=name,
        controller=options.controller,
        plant=options.plant,
        starts=options.starts,
        **numbers,
        **{f"attack_{key}": values for key, values in worst.attack.items()},
        errors=lap.errors[:, 0],
        measured=lap.measured[:, 0],
        inputs=lap.inputs[:, 0],
        wheels=lap.wheels[:, 0],
        **({} if played.deviations is None else {"deviations": played.deviations}),
    )
    of_an_earlier_search = "worst" if kind == "counterexample" else "counterexample"
    (folder.path / f"{of_an_earlier_search}_{name}.npz").unlink(missing_ok=True)


def play_again(scenario: Scenario, options: FalsifyOptions) -> int:
    """Play a saved worst case again, compare it with what was saved, and draw it beside its file."""
    path = Path(options.replay)
    saved = _read(path)
    if str(saved["scenario"]) != to_toml(scenario):
        cure = f"give --scenario {path.parent / 'scenario.toml'}"
        raise refusal(
            "command line", "--replay", str(path), "was found with another scenario", cure
        )
    name = str(saved["limit"])
    setting = make_setting(
        scenario, str(saved["controller"]), str(saved["plant"]), str(saved["starts"]), options.seed
    )
    attack = {key.removeprefix("attack_"): saved[key] for key in saved if key.startswith("attack_")}
    before = Worst(
        **{key: saved[key].item() for key in ("usage", "margin", "step", "facet", "when")},
        attack=attack,
    )
    worst = replayed(setting.loop(name), setting.plant, setting.limits(name)[name], name, before)
    played = usage.replay(setting.loop(name), setting.plant, attack, name, worst.when)
    difference = float(np.max(np.abs(played.trajectory.errors[:, 0] - saved["errors"])))
    what, margin, unit = facet(setting.limits(name)[name], name, worst)
    kept = "violation" if violated(worst) else "no violation"
    folder = RunFolder(path.parent)
    folder.report(
        f"{kept}: margin {margin:.9g} {unit} of the limit `{name}` at step {worst.step} ({what})\n"
        f"saved margin differs by {abs(worst.margin - before.margin):.2g}, "
        f"saved errors by {difference:.2g}",
        f"replay_{name}",
    )
    draw(setting, folder, f"replay_{name}", name, worst, played)
    print(f"drawn in {path.parent}/replay_{name}.png")
    return 0


def _read(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            saved = dict(file)
        if "attack_start" in saved:
            return saved
        problem = "is no worst case of a search"
    except OSError as error:
        problem = f"cannot be read ({error.strerror or 'no archive of arrays'})"
    except (ValueError, zipfile.BadZipFile):
        problem = "is no archive of arrays"
    cure = "name a counterexample_LIMIT.npz or worst_LIMIT.npz of the falsify command"
    raise refusal("command line", "--replay", str(path), problem, cure)
