"""Small problems whose answers are known: a linear program, a semidefinite one, and laps of a
certified closed loop."""

from __future__ import annotations

import math
import time

from jaxtube.experiments.doctor.finding import Check
from jaxtube.experiments.doctor.machine import list_programs

TOLERANCE = 1e-6
LAPS = 64
DESIGN = "robust"
"""A scenario whose design is certified for its linear model."""

CHECKS = (
    Check("HiGHS", lambda: solve_linear_program(), "pip install --force-reinstall highspy"),
    Check(
        "Clarabel", lambda: solve_semidefinite_program(), "pip install --force-reinstall clarabel"
    ),
    Check(
        "closed loop",
        lambda: drive_certified_laps(),
        "run the tests of a checkout (python -m pytest -q) and report what fails",
    ),
)


def solve_linear_program() -> str:
    """Maximise x + y where x + 2 y <= 4, 3 x + y <= 6 and x, y >= 0: 14/5, where the rows meet.

    Raises:
        RuntimeError: for another answer.
    """
    import numpy as np

    from sets.frame import solve_program

    rows = np.array([[1.0, 2.0], [3.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    limits = np.array([4.0, 6.0, 0.0, 0.0])
    solution, _ = solve_program(np.array([-1.0, -1.0]), rows, limits)
    found = float(solution.sum())
    _compare(found, 14 / 5)
    return "a linear program has its known optimum"


def solve_semidefinite_program() -> str:
    """Minimise x + y where [[x, 2], [2, y]] is positive semidefinite: 4, at x = y = 2.

    Raises:
        RuntimeError: for another answer.
    """
    import numpy as np

    from sets.semidefinite import evaluate, make_unknowns, minimise, trace

    diagonal = np.array([[[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]])
    (matrix,) = make_unknowns(diagonal)
    matrix[0] = [[0.0, 2.0], [2.0, 0.0]]
    answer = minimise(trace(matrix), [matrix])
    _compare(float(np.trace(evaluate(matrix, answer.x))), 4.0)
    return "a semidefinite program has its known optimum"


def drive_certified_laps() -> str:
    """Drive laps of a design on the linear model with w drawn in W: what is certified of it is that
    none leaves E.

    Raises:
        RuntimeError: where the certificate fails, or a lap leaves E.
    """
    import numpy as np

    from jaxtube.scenario.reading import load
    from jaxtube.simulation import batches, components
    from jaxtube.synthesis.design import design

    started = time.perf_counter()
    kept_before = len(list_programs())
    made = design(load(DESIGN))
    if not made.certificate.holds_for_model:
        raise RuntimeError(f"the design `{DESIGN}` fails: {', '.join(made.certificate.failing)}")
    starts = np.tile(made.problem.initial_error, (LAPS, 1))
    controller = components.make_tube_mpc(made)
    laps = batches.run_realisations(controller, components.linear_plant(made), starts, 0)
    margin = float(np.min(made.problem.error_set.margin(np.asarray(laps.errors))))
    if not margin >= 0:
        raise RuntimeError(f"a certified lap of `{DESIGN}` leaves E by {-margin:.3g}")
    seconds = time.perf_counter() - started
    source = "some compiled anew" if len(list_programs()) > kept_before else "compiled before"
    periods = (len(laps.errors) - 1) * LAPS
    return (
        f"{periods:,} periods of `{DESIGN}`, certified to stay in E, stay there; designed and "
        f"driven in {seconds:.1f} s, programs {source}"
    )


def _compare(found: float, known: float) -> None:
    if not math.isclose(found, known, abs_tol=TOLERANCE):
        raise RuntimeError(f"the optimum is {known:.9g}, the answer {found:.9g}")
