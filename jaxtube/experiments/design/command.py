"""`design`: compute tubes, gains and terminal set of a scenario, certify them, and print what the
certificate says."""

from __future__ import annotations

import shlex
import time
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Bool

from jaxtube.experiments.design.nearest import say_nearest, say_nearest_bounded, say_nearest_to
from jaxtube.experiments.options import DesignOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.design_page import make_page
from jaxtube.experiments.run.design_report import report
from jaxtube.experiments.run.designing import make_design
from jaxtube.experiments.run.disturbance_line import disturbance_line
from jaxtube.experiments.run.exit_codes import exit_code
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.limits import describe_pose
from jaxtube.experiments.run.proof_line import write_proof
from jaxtube.progress import announce, progress
from jaxtube.reporting import laps as kept_laps
from jaxtube.reporting.player import make_player
from jaxtube.scenario.refusal import ScenarioError, literal
from jaxtube.scenario.tree import Operating, Scenario
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.certificate.motions import confirm_motions
from jaxtube.synthesis.design import refuse_infeasible_start, refuse_start_outside_limits
from jaxtube.synthesis.optimise import SEARCHES, UnboundedTubeError, optimise
from jaxtube.synthesis.optimum import Optimum
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.tightening import EmptySetError

SAVED = "design"
"""Folder of the saved design in that of the run."""

PLAYED = (
    "These are laps of the tube's local gain alone, without prediction; `paper` and `montecarlo` "
    "play the tube-MPC."
)
"""What the laps of a design are."""


def run(scenario: Scenario, options: DesignOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails.

    Where a design fails, the nearest scenarios that hold are searched and told. A start outside the
    limits is refused before anything is computed, one without a plan after the run folder is
    complete: nothing that took long is lost. Only its laps are left out.
    """
    found = None
    if options.optimise:
        refuse_start_outside_limits(make_problem(_remove_caps(scenario)))
        found = find_caps_and_gains(scenario, options)
        scenario = found.scenario
    refuse_start_outside_limits(make_problem(scenario))
    announce("designing: sets, gains and certificate")
    try:
        designed = make_design(scenario, None if options.optimise else options)
        made = confirm_motions(designed)
    except EmptySetError as error:
        raise EmptySetError("; ".join([str(error), *say_nearest(scenario, options)])) from None
    numbers = metrics.design_metrics(made)
    nearest = [] if made.certificate.holds_for_robot else say_nearest(scenario, options)
    text = report(made, numbers.get("ultimate_bound"), nearest)
    folder = run_folder.create(scenario, options)
    folder.report(text)
    if found is not None:
        folder.report(f"\ncaps and gains found, as lines of a scenario\n\n{scenario_lines(found)}")
    folder.report(f"\n{describe_saved(designed.save(folder.path / SAVED))}")
    if made.certificate.holds_for_robot or made.certificate.holds_for_model:
        folder.report(f"\n{write_proof(made, folder.path, options.label)}")
    start_fault = _find_start_fault(made)
    started = time.perf_counter()
    player = None
    if start_fault is None:
        announce("driving laps, compiled first: does w stay in W?")
        laps = simulate_laps(made, options.seed)
        disturbance = measure_disturbance(made, laps)
        numbers["disturbance"] = disturbance
        folder.report("\n" + disturbance_line(made, disturbance, "the local gain"))
        kept = kept_laps.collect(made, {"local_gain": laps})
        folder.save_arrays("laps", **kept.arrays())
        player = make_player(kept, " ".join([PLAYED, describe_pose(made.problem)]).strip())
    folder.save_metrics(numbers)
    announce("drawing the sets")
    draw_sets(made, options.label, folder)
    folder.save_page(make_page(made, options.label, numbers, nearest, player))
    seconds = time.perf_counter() - started
    print(f"\nlaps, their compilation and figures took another {seconds:.1f} s")
    print(f"written to {folder.path}/; scenario.toml there can be run again")
    if start_fault is not None:
        raise start_fault
    return exit_code(made.certificate, options.require_certificate)


def describe_saved(folder: Path) -> str:
    """Say where the design was saved, and how it is used."""
    words = shlex.join(["--scenario", str(folder)])
    return (
        f"saved in {folder}/: {words} gives it to another command, and jt.read to a program, to "
        "the bit"
    )


def _remove_caps(scenario: Scenario) -> Scenario:
    """Return the scenario without the caps that the optimiser replaces."""
    return msgspec.structs.replace(scenario, operating=Operating())


def _find_start_fault(made: Design) -> ScenarioError | None:
    """Return what refuses the start of a design, None where it has a plan."""
    try:
        refuse_infeasible_start(made)
    except ScenarioError as error:
        return error
    return None


def draw_sets(made: Design, name: str, folder: RunFolder) -> None:
    """Draw limits, tube and terminal set into the folder."""
    from jaxtube.figures.sets import design_sets

    folder.save_figure(design_sets(made, name), "sets")


def find_caps_and_gains(scenario: Scenario, options: DesignOptions) -> Optimum:
    """Return the caps and gains that the optimiser finds, with the scenario that has them.

    Raises:
        ScenarioError: where none are found, or the tube outgrows the best of them.
    """
    try:
        with progress(SEARCHES, "optimising", "searches", starting="starting") as bar:

            def show(ratio: float) -> None:
                bar.set_postfix_str(f"largest share {ratio:.3f}", refresh=False)
                bar.update()

            best = optimise(make_problem(scenario), show)
            bar.total = bar.n
    except UnboundedTubeError as error:
        told = "; ".join([str(error), *say_nearest_bounded(scenario)])
        raise ScenarioError(f"scenario: {told}") from None
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None
    if not best.holds:
        told = "; ".join(say_nearest_to(best, options))
        raise ScenarioError(f"scenario: --optimise: no caps and gains found hold the tube: {told}")
    return best


def scenario_lines(best: Optimum) -> str:
    """Return caps and gains as lines of a scenario file."""
    caps = msgspec.structs.asdict(best.scenario.operating)
    lines = ["[operating]"]
    lines += [f"{name} = {cap}" for name, cap in caps.items() if isinstance(cap, float)]
    gains = list(best.scenario.controller.tracking_gains)
    if best.scenario.operating.bands:
        return "\n".join([*lines, *_band_lines(best.scenario)])
    lines += ["", "[controller]", f"tracking_gains = {gains}"]
    if best.scenario.controller.has_observer:
        lines.append(f"observer_gain = {list(best.scenario.controller.observer_gain)}")
    return "\n".join(lines)


def _band_lines(scenario: Scenario) -> list[str]:
    """Return bands as lines of a scenario file, a band each."""
    bands = msgspec.to_builtins(scenario.operating.bands)
    return ["bands = [", *(f"    {literal(band)}," for band in bands), "]"]


def simulate_laps(made: Design, seed: int) -> Trajectory:
    """Return laps of the local gain on the slipping robot, which compile quickly."""
    starts = np.tile(made.problem.initial_error, (batches.BATCH, 1))
    controller = components.controller_makers(made)["local_gain"]()
    return batches.run_realisations(controller, components.slipping_robot(made), starts, seed)


def measure_disturbance(made: Design, trajectory: Trajectory) -> dict:
    """Return what laps of the local gain say of w(k) in W: they can refute it, never prove it.

    Of a computed W only steps count in which measured error and input lie in what it was computed
    for.
    """
    disturbances = batches.model_disturbances(made, trajectory)
    if not made.problem.has_computed_bound:
        return metrics.disturbance_metrics(made, disturbances)
    step, run = np.nonzero(within_caps(made, trajectory))
    regimes = made.problem.period_regimes[step]
    return metrics.disturbance_metrics(made, disturbances[step, run][:, None], regimes)


def within_caps(made: Design, trajectory: Trajectory) -> Bool[np.ndarray, "steps runs"]:
    """Return where measured error and input lie in what W was computed for."""
    errors = np.asarray(trajectory.measured)[:-1]
    rows = made.problem.rows_of(made.problem.period_regimes[: len(errors)])
    used = np.asarray(trajectory.inputs) @ np.swapaxes(rows.inputs, 1, 2)
    used = used + errors @ np.swapaxes(rows.errors, 1, 2)
    in_caps = np.all(used <= rows.offsets[:, None], axis=2)
    return in_caps & (made.problem.operating_set.margin(errors) >= 0)
