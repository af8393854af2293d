"""Tuning of a scenario from its weights and gains to a certified design: descent, choice of the
best iterate, and its design made anew."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, get_args, overload

from jaxtube.arguments import require_count
from jaxtube.plant.reference import TRANSIENT_S, settled_step
from jaxtube.precision import in_64_bits
from jaxtube.progress import show_progress
from jaxtube.scenario.tree import Scenario, require_scenario
from jaxtube.storage import StoredResult, flatten, nest, write_result
from jaxtube.synthesis.design import design, restore_design
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from jaxtube.systems.system import LinearSystem
from jaxtube.tuning.bar import DescentBar
from jaxtube.tuning.judgement import HeldOutJudgement
from jaxtube.tuning.linear import LinearTuned, PeriodCost, tune_linear
from jaxtube.tuning.parameters import Variables
from jaxtube.tuning.run import Descent, Log, Method, Progress, Settings, descend
from jaxtube.tuning.storing import list_descent_arrays, list_descent_facts, read_descent
from jaxtube.tuning.tuner import Tuner, failing_conditions, make_tuner
from jaxtube.tuning.watch import Stop

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Tuned:
    """The result of tuning.

    Attributes:
        tuner: of the scenario where tuning started.
        descent: every iterate and what stopped the descent.
        best: the iterate that is returned, judged on the held-out laps; None where none is
            certified and no other is accepted.
        scenario: that of the best iterate, whole.
        design: that of the scenario, made as `design(scenario)` makes it.
        failing: the conditions that this design lacks; without one, those that the best of the
            uncertified iterates lacks.
    """

    tuner: Tuner
    descent: Descent
    best: HeldOutJudgement | None
    scenario: Scenario | None
    design: Design | None
    failing: tuple[str, ...]

    @property
    def start(self) -> HeldOutJudgement:
        """The start, judged on the held-out laps."""
        return self.descent.judged[0]

    @property
    def is_certified(self) -> bool:
        """Whether every required condition of the returned design holds."""
        return self.design is not None and not self.failing

    @property
    def is_rechecked(self) -> bool:
        """Whether its certificate was checked once more, in rational arithmetic."""
        if self.design is None:
            return False
        second = self.design.certificate.conditions.get("checked_in_rationals")
        return second is not None and second.holds

    @property
    def stop(self) -> Stop:
        """What stopped the descent."""
        return self.descent.outcome.stop

    @property
    def sentence(self) -> str:
        """What stopped the descent and what to change, in one line."""
        return self.descent.outcome.sentence

    @property
    def verdict(self) -> str:
        """What the certificate says, in one line."""
        if not self.is_certified:
            return f"NOT CERTIFIED: {', '.join(self.failing)}"
        twice = "; checked once more in rational arithmetic" if self.is_rechecked else ""
        what_for = assumption(self.tuner.problem)
        return f"CERTIFIED{what_for}: every required condition holds{twice}"

    def plot(self) -> Figure:
        """Draw objectives, lateral errors and effort by iteration; return the figure."""
        from jaxtube.figures.learning import draw_descent

        return draw_descent(self.descent, self.tuner.aim.effort_limit)

    def save(self, folder: str | Path) -> Path:
        """Save the result in a folder, for `jaxtube.read`, in place of one of tuning that was saved
        there; return the folder.

        The scenario there is that where tuning started.
        """
        tuner = self.tuner
        facts = {
            "laps": tuner.laps,
            "held_out": tuner.held_out,
            "seed": tuner.seed,
            "moves": list(tuner.parameters.moves),
            "failing": list(self.failing),
            "best": None if self.best is None else self._find_iteration(self.best),
            **list_descent_facts(self.descent),
        }
        designed = {} if self.design is None else self.design.arrays()
        arrays = flatten({"descent": list_descent_arrays(self.descent), "design": designed})
        return write_result(folder, StoredResult("tuned", tuner.problem.scenario, facts, arrays))

    @classmethod
    def restore(cls, stored: StoredResult) -> Tuned:
        """Return a result that was saved, its design made again with the arrays that it had.

        Raises:
            ScenarioError: where the design comes out differently.
        """
        facts = stored.facts
        arrays = nest(stored.arrays)
        sizes = {name: facts[name] for name in ("laps", "held_out", "seed")}
        tuner = make_tuner(stored.scenario, **sizes)
        tuner.parameters = replace(tuner.parameters, moves=tuple(facts["moves"]))
        descent = read_descent(facts, arrays["descent"])
        failing = tuple(facts["failing"])
        if facts["best"] is None:
            return cls(tuner, descent, None, None, None, failing)
        best = descent.judged[facts["best"]]
        scenario = tuner.parameters.scenario(stored.scenario, best.point)
        designed = restore_design(scenario, flatten(arrays["design"]))
        return cls(tuner, descent, best, scenario, designed, failing)

    def _find_iteration(self, judgement: HeldOutJudgement) -> int:
        return next(i for i, each in enumerate(self.descent.judged) if each is judgement)

    def _say_when(self) -> str:
        """Return from when on errors count, in words."""
        reference = self.tuner.problem.reference
        if settled_step(reference) < reference.steps:
            return f"after {TRANSIENT_S:.0f} s"
        return "at the last step"

    def __repr__(self) -> str:
        laps = len(self.start.costs)
        before = 1e3 * self.start.lateral
        if self.best is None:
            change = f"{before:.3f} mm before, no iterate to return,"
        else:
            change = f"{before:.3f} -> {1e3 * self.best.lateral:.3f} mm"
        return (
            f"<Tuned: {self.verdict}; lateral RMS {change} {self._say_when()} of {laps} held-out "
            f"laps; {self.descent.outcome.evaluations} evaluations, stopped: {self.stop}>"
        )


@overload
def tune(
    scenario: Scenario,
    *,
    variables: Variables = "both",
    method: Method = "lbfgs",
    evaluations: int = 120,
    laps: int = 128,
    held_out: int = 256,
    learning_rate: float = 0.1,
    patience: int = 40,
    seed: int = 0,
) -> Tuned: ...


@overload
def tune(
    scenario: LinearSystem,
    *,
    aim: PeriodCost | None = None,
    variables: Variables = "both",
    method: Method = "lbfgs",
    evaluations: int = 120,
    laps: int = 128,
    held_out: int = 256,
    learning_rate: float = 0.1,
    patience: int = 40,
    seed: int = 0,
) -> LinearTuned: ...


@in_64_bits
def tune(
    scenario: Scenario | LinearSystem,
    *,
    aim: PeriodCost | None = None,
    variables: Variables = "both",
    method: Method = "lbfgs",
    evaluations: int = 120,
    laps: int = 128,
    held_out: int = 256,
    learning_rate: float = 0.1,
    patience: int = 40,
    seed: int = 0,
) -> Tuned | LinearTuned:
    """Tune weights and gains of a scenario by gradients through laps and through the tube, in 64
    bits.

    Errors count once laps have settled, after 10 s; of laps that end before, the last step alone.

    Args:
        scenario: where tuning starts; its [tuning] says what it aims at. Or a linear system, of
            which Q and R are tuned, on laps from the edge of its feasible set.
        aim: of a linear system, the cost of a period, aim(states after it, inputs) -> (laps,), in
            jax.numpy; x'Qx + u'Ru with the weights it starts from unless given.
        variables: what moves: Q, R and gains ("both"), "weights", "gains", or the "diagonal" of Q
            and R.
        method: L-BFGS-B on the same laps in every evaluation ("lbfgs"), or Adam with fresh ones.
        evaluations: gradients at most.
        laps: in each evaluation.
        held_out: laps, others than those, that judge every iterate.
        learning_rate: of Adam, in the logarithms of weights and gains.
        patience: iterates without a better held-out objective after which to stop.
        seed: of every draw.

    Returns:
        The result; nothing is written.

    Raises:
        ScenarioError: where the scenario gives no gains, or its gains have no bounded tube.
        ValueError: for settings out of range.
    """
    _refuse_method(method, learning_rate)
    if isinstance(scenario, LinearSystem):
        return tune_linear(
            scenario,
            aim,
            method=method,
            evaluations=require_count("evaluations", evaluations),
            laps=require_count("laps", laps),
            held_out=require_count("held_out", held_out),
            learning_rate=learning_rate,
            patience=require_count("patience", patience),
            seed=seed,
        )
    require_scenario(scenario)
    if aim is not None:
        raise ValueError("aim: a scenario has its own in [tuning]; leave it out")
    settings = Settings(
        method,
        require_count("evaluations", evaluations),
        require_count("patience", patience),
        learning_rate,
    )
    sizes = {"laps": require_count("laps", laps), "held_out": require_count("held_out", held_out)}
    tuner = make_tuner(scenario, variables=variables, **sizes, seed=seed)
    counter = show_progress(settings.evaluations, "tuning", "gradients")
    with DescentBar(counter) as progress:
        return run_tuner(tuner, settings, progress=progress)


def run_tuner(
    tuner: Tuner,
    settings: Settings,
    *,
    accept_uncertified: bool = False,
    log: Log | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """Descend from a tuner's start, and design the best iterate.

    Args:
        tuner: of the start.
        settings: how it descends.
        accept_uncertified: return the best iterate even if its certificate fails.
        log: of answers, for resuming.
        progress: told of every evaluation and iterate.
    """
    descent = descend(tuner, settings, log, progress)
    best = descent.best(accept_uncertified)
    if best is None:
        return Tuned(tuner, descent, None, None, None, _failing_of_best(descent))
    scenario = tuner.parameters.scenario(tuner.problem.scenario, best.point)
    designed = design(scenario)
    return Tuned(tuner, descent, best, scenario, designed, failing_conditions(designed))


def _refuse_method(method: str, learning_rate: float) -> None:
    """Raise ValueError for an unknown method or a learning rate out of range, in one line."""
    if method not in get_args(Method):
        known = ", ".join(get_args(Method))
        raise ValueError(f"method = {method!r}: is unknown; choose one of {known}")
    if not 0 < learning_rate < math.inf:
        raise ValueError(
            f"learning_rate = {learning_rate}: must be positive and finite; choose it above zero"
        )


def _failing_of_best(descent: Descent) -> tuple[str, ...]:
    """Return what the best of the uncertified iterates lacks, of none the last one."""
    best = descent.outcome.best_uncertified
    return descent.judged[best.iteration if best else -1].failing


def assumption(problem: Problem) -> str:
    """Return what a certificate takes for granted where W is assumed, nothing where it is
    computed."""
    if problem.disturbance_bound is not None:
        return ""
    return (
        " for the linear model with w in W, which is assumed "
        '(disturbance.bound = "computed" bounds the robot\'s w)'
    )
