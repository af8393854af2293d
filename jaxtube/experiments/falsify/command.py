"""`falsify`: the smallest margins of a closed loop, searched by gradient and compared with drawn
laps in equal time.

Every margin that is printed is that of a replay: the attack is played once more on its own by the
ordinary rollout.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxtube.experiments.falsify.report import make_page, metrics, report
from jaxtube.experiments.options import FalsifyOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.designing import make_design
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.falsification.cases import Row, describe_facet, is_violated
from jaxtube.falsification.falsify import search_setting
from jaxtube.falsification.setting import LoopLimits, make_setting
from jaxtube.falsification.worst import Worst, confirm
from jaxtube.numpy_archive import read_archive
from jaxtube.progress import announce, progress
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.simulation.usage import Replay

NUMBERS = ("usage", "margin", "step", "facet", "when")
"""The numbers of a worst case that are saved under their own names."""
TEXTS = ("scenario", "controller", "plant", "starts", "limit")
"""Its texts."""


def run(scenario: Scenario, options: FalsifyOptions) -> int:
    """Run the command; returns 0, whatever was found."""
    if options.replay:
        return play_again(scenario, options)
    refuse_options(options)
    announce("designing: sets, gains and certificate")
    setting = make_setting(
        make_design(scenario, options),
        options.controller,
        options.plant,
        options.starts,
        seed=options.seed,
    )
    names = setting.limits.choose_names(options.target)
    folder = run_folder.create(scenario, options)
    with progress(2 * len(names), "searching", "limits") as bar:
        falsification = search_setting(
            setting,
            options.target,
            seconds=options.seconds,
            seed=options.seed,
            on_progress=bar.update,
        )
    folder.report(report(falsification))
    folder.save_metrics(metrics(falsification))
    announce("drawing the worst cases")
    for name, row in falsification.rows.items():
        save(setting.limits, options.starts, folder, row.worst, row.played)
        draw(setting.limits, folder, f"worst_{name}", row.worst, row.played, row)
    folder.save_page(make_page(falsification))
    print(f"\nreport.html, worst cases, figures and metrics.json are in {folder.path}/")
    return 0


def refuse_options(options: FalsifyOptions) -> None:
    """Raise ScenarioError, one line, for options that do not go together, before anything is
    designed."""
    if not 0 < options.seconds < np.inf:
        raise refusal(
            "command line", "--seconds", options.seconds, "is no time", "give a positive number"
        )
    if options.target == "tube" and options.controller != "tube_mpc":
        problem = f"{options.controller} keeps no tube"
        raise refusal("command line", "--target", "tube", problem, "choose --controller tube_mpc")


def draw(
    limits: LoopLimits,
    folder: RunFolder,
    title: str,
    worst: Worst,
    played: Replay,
    row: Row | None = None,
) -> None:
    """Draw a worst case: its lap, and for the tube the section that it comes nearest to."""
    from jaxtube.figures.worst import worst_run
    from jaxtube.figures.worst_section import worst_section

    is_tube = worst.limit == "tube"
    reaches = (row.search.reach, row.sampled.reach) if row and not is_tube else None
    figure = worst_run(limits.design.problem, limits.of_laps, worst, played, reaches)
    folder.save_figure(figure, title)
    if is_tube:
        folder.save_figure(worst_section(limits.design, worst, played), f"{title}_section")


def save(
    limits: LoopLimits,
    starts: str,
    folder: RunFolder,
    worst: Worst,
    played: Replay,
) -> None:
    """Save what it takes to play a worst case again, and what came out."""
    name = worst.limit
    kind = "counterexample" if is_violated(worst) else "worst"
    other_kind = "worst" if is_violated(worst) else "counterexample"
    lap = played.trajectory
    attack = {f"attack_{key}": values for key, values in worst.attack.items()}
    deviations = {} if played.deviations is None else {"deviations": played.deviations}
    folder.save_arrays(
        f"{kind}_{name}",
        scenario=to_toml(limits.design.problem.scenario),
        limit=name,
        controller=limits.controller,
        plant=limits.plant,
        starts=starts,
        **{key: getattr(worst, key) for key in NUMBERS},
        **attack,
        errors=lap.errors[:, 0],
        measured=lap.measured[:, 0],
        inputs=lap.inputs[:, 0],
        wheels=lap.wheels[:, 0],
        **deviations,
    )
    # One that an earlier search left in the same folder.
    (folder.path / f"{other_kind}_{name}.npz").unlink(missing_ok=True)


def play_again(scenario: Scenario, options: FalsifyOptions) -> int:
    """Play a saved worst case again, compare it with what was saved, and draw it beside its
    file."""
    path = Path(options.replay)
    saved = read_worst_case(path)
    if str(saved["scenario"]) != to_toml(scenario):
        cure = f"give --scenario {path.parent / 'scenario.toml'}"
        raise refusal(
            "command line", "--replay", str(path), "was found with another scenario", cure
        )
    announce("designing, then playing the worst case again")
    design = make_design(scenario, options)
    before = _read_worst(saved)
    name = before.limit
    try:
        choice = [str(saved[key]) for key in ("controller", "plant", "starts")]
        setting = make_setting(design, *choice, seed=options.seed)
        limit = setting.limits.all[name]
        worst = confirm(setting.loop(name).controller, setting.plant, limit, before)
        played = setting.replay(worst)
        difference = float(np.max(np.abs(played.trajectory.errors[:, 0] - saved["errors"])))
    except (ValueError, TypeError, LookupError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise _refuse_replay(path, f"cannot be played ({first})") from error
    facet = describe_facet(limit, worst)
    verdict = "violation" if is_violated(worst) else "no violation"
    folder = RunFolder(path.parent)
    folder.report(
        f"{verdict}: margin {facet.margin:.9g} {facet.unit} of the limit `{name}` "
        f"at step {worst.step} ({facet.words})\n"
        f"saved margin differs by {abs(worst.margin - before.margin):.2g}, "
        f"saved errors by {difference:.2g}",
        f"replay_{name}",
    )
    draw(setting.limits, folder, f"replay_{name}", worst, played)
    print(f"drawn in {path.parent}/replay_{name}.png")
    return 0


def _read_worst(saved: dict[str, np.ndarray]) -> Worst:
    numbers = {key: saved[key].item() for key in NUMBERS}
    attack = {
        key.removeprefix("attack_"): values
        for key, values in saved.items()
        if key.startswith("attack_")
    }
    return Worst(limit=str(saved["limit"]), attack=attack, **numbers)


def read_worst_case(path: Path) -> dict[str, np.ndarray]:
    """Read what `save` has written.

    Raises:
        ScenarioError: one line, for a file that cannot be read, or is no worst case.
    """
    try:
        saved = read_archive(path.read_bytes())
        if is_worst_case(saved):
            return saved
        problem = "is no worst case of a search"
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    except ValueError as error:
        problem = str(error)
    raise _refuse_replay(path, problem)


def _refuse_replay(path: Path, problem: str) -> ScenarioError:
    cure = "name a counterexample_LIMIT.npz or worst_LIMIT.npz of the falsify command"
    return refusal("command line", "--replay", str(path), problem, cure)


def is_worst_case(saved: dict[str, np.ndarray]) -> bool:
    """Say whether arrays are all that `save` writes, each of its kind and shape, and finite."""
    scalars = all(name in saved and saved[name].shape == () for name in (*TEXTS, *NUMBERS))
    if not scalars or not {"errors", "attack_start"} <= saved.keys():
        return False
    if any(saved[name].dtype.kind != "U" for name in TEXTS):
        return False
    used = [name for name in saved if name.startswith("attack_")]
    numbers = [saved[name] for name in (*NUMBERS, "errors", *used)]
    if not all(array.dtype.kind in "biuf" and np.isfinite(array).all() for array in numbers):
        return False
    return saved["errors"].ndim == 2 and saved["errors"].shape[1] == 3
