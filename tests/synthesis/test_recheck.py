"""Laws of the exact re-check of designs: it agrees with the float certificate, and each condition
fails on its own."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from tolerances import EXACT_AGAINST_FLOAT

from jaxtube.scenario import load
from jaxtube.synthesis.certificate import exact_regimes
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.certificate.exact_regimes import disturbance_points
from jaxtube.synthesis.certificate.stages import check_stages
from jaxtube.synthesis.certificate.terminal import check_terminal
from jaxtube.synthesis.design import design
from jaxtube.synthesis.disturbance import prove_bound
from jaxtube.synthesis.parts import Design
from sets.certificate import ROUNDING
from sets.polytope import Polytope

REFERENCE = """
[reference]
wheel_speed_min_mps = 1.224
wheel_speed_max_mps = 1.496
[operating]
longitudinal_m = 0.12
lateral_m = 0.28
heading_deg = 18.0
speed_deficit_min_mps = -0.27
speed_deficit_max_mps = 0.40
yaw_rate_deficit_radps = 0.9
[disturbance]
bound = "computed"
[noise]
longitudinal_m = 0.001
lateral_m = 0.001
heading_deg = 0.02
[controller]
tube = "sequence"
terminal = "T-A"
model = "exact_jacobian"
input_map = "x_exact"
tracking_gains = [3.0, 6.5, 6.5]
error_weight = [1.0, 3.0, 1.0]
input_weight = [0.3, 0.3]
"""
COUPLED = ("operating.turning_longitudinal_m=0.30", "operating.turning_yaw_rate_radps=1.5")
ON_PATH = ("reference.certified_for=path",)
CHOICES = [
    pytest.param((), id="box"),
    pytest.param(COUPLED, id="coupled"),
    pytest.param(ON_PATH, id="path"),
]


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """Design the reference scenario under overrides."""
    file = tmp_path_factory.mktemp("recheck") / "reference.toml"
    file.write_text(REFERENCE)
    return cache(lambda overrides=(): design(load(str(file), overrides)))


# Agreement


@pytest.mark.parametrize("overrides", CHOICES)
def test_the_report_of_a_certified_design_holds(designed, overrides):
    found = designed(overrides)
    report = recheck(found)
    assert found.certificate.holds_for_robot
    assert report.holds, report.failing
    assert {*TAMPERED} == {*report.margins}


@pytest.mark.parametrize("overrides", CHOICES)
def test_margins_agree_with_those_of_the_float_certificate(designed, overrides, monkeypatch):
    """What the solver may miss is no part of the exact margins, nor here of those of floats."""
    found = designed(overrides)
    scale = np.linalg.norm(found.terminal.invariant.normals, axis=1)
    unit = Polytope(
        found.terminal.invariant.normals / scale[:, None], found.terminal.invariant.offsets / scale
    )
    margins = recheck(replace(found, terminal=replace(found.terminal, invariant=unit))).margins
    monkeypatch.setattr(Design, "solver_slack", 0.0)
    checked = [*check_stages(found), *check_terminal(found)]
    expected = {condition.name: condition.margin for condition in checked}
    for name, parts, granted in (
        ("tightening_covers_reach", ("errors reach", "inputs reach"), ROUNDING),
        ("shifted_plan_inclusion", ("errors shifted", "inputs shifted"), ROUNDING),
        ("plan_stays_feasible", ("errors returns",), 0.0),
        ("terminal_set_invariant", ("terminal invariant",), 0.0),
    ):
        exact = float(min(margins[part] for part in parts))
        assert exact == pytest.approx(expected[name] - granted, abs=EXACT_AGAINST_FLOAT)


@pytest.mark.parametrize("overrides", CHOICES)
def test_the_room_of_the_terminal_set_is_that_of_its_vertices(designed, overrides):
    found = designed(overrides)
    problem = found.problem
    margins = recheck(found).margins
    points = found.terminal.invariant.vertices()
    laws = problem.input_rows.on_errors(found.terminal.gains.corner_gains)
    inputs = problem.input_rows.offsets[:, None] - laws @ points.T
    errors = problem.operating_set.offsets - points @ problem.operating_set.normals.T
    assert float(margins["terminal errors"]) == pytest.approx(errors.min(), abs=EXACT_AGAINST_FLOAT)
    assert float(margins["terminal inputs"]) == pytest.approx(inputs.min(), abs=EXACT_AGAINST_FLOAT)


@pytest.mark.parametrize(
    "overrides", [(), ("disturbance.bound=assumed",)], ids=["computed", "assumed"]
)
def test_the_points_of_the_disturbance_set_are_its_vertices(designed, overrides):
    problem = designed(overrides).problem
    points = np.array(disturbance_points(problem), dtype=float)
    directions = np.random.default_rng(0).normal(size=(200, 3))
    expected = (problem.disturbance_bound or problem.disturbance_set).support(directions)
    np.testing.assert_allclose(
        np.max(directions @ points.T, axis=1), expected, atol=EXACT_AGAINST_FLOAT
    )
    assert len(points) == len(problem.disturbance_set.vertices())


# Tampering: what makes each condition fail, and none else


def of_problem(found: Design, **changes) -> Design:
    return replace(found, problem=replace(found.problem, **changes))


def of_controller(found: Design, **changes) -> Design:
    scenario = found.problem.scenario
    controller = msgspec.structs.replace(scenario.controller, **changes)
    return of_problem(found, scenario=msgspec.structs.replace(scenario, controller=controller))


def of_windows(found: Design, **changes) -> Design:
    return replace(found, windows=replace(found.windows, **changes))


def used(found: Design, name: str, entry, change: float) -> Design:
    """Move an offset used on line."""
    offsets = getattr(found.bounds, name).copy()
    offsets[entry] += change
    return replace(found, bounds=replace(found.bounds, **{name: offsets}))


def one_step(found: Design) -> Design:
    """A run of one step: no plan is shifted."""
    return of_windows(found, index=found.windows.index[:1])


def faceted(found: Design, facets, change: float) -> Design:
    """Move facets of the invariant set, whose offsets are one."""
    invariant = found.terminal.invariant
    offsets = invariant.offsets + change * facets
    return replace(
        found, terminal=replace(found.terminal, invariant=Polytope(invariant.normals, offsets))
    )


def of_errors(found: Design):
    """Tell the facets that bound one error alone; the others bound inputs."""
    return np.count_nonzero(found.terminal.invariant.normals, axis=1) == 1


def pulled(found: Design) -> Design:
    """Pull in a facet that bounds the heading error, and with it the constraint on the last
    predicted error."""
    facet = np.argmax(found.terminal.invariant.normals[:, 2] * of_errors(found))
    assert np.array_equal(found.bounds.terminal_normals, found.terminal.invariant.normals)
    return used(
        faceted(found, np.arange(len(of_errors(found))) == facet, -0.02),
        "terminal",
        np.s_[:, facet],
        -0.02,
    )


TAMPERED = {
    "disturbance": lambda d: of_problem(
        d, disturbance_set=d.problem.disturbance_set.scale(1 - 1e-9)
    ),
    "schedules": lambda d: of_problem(
        d, regions=d.problem.regions + 1e-9 * np.array([[1.0], [-1.0]])
    ),
    "gains": lambda d: of_windows(d, gains=d.windows.gains * (1 + 1e-11)),
    "terminal invariant": pulled,
    "terminal errors": lambda d: faceted(d, of_errors(d), 1e-4),
    "terminal inputs": lambda d: faceted(d, ~of_errors(d), 1e-4),
    "cost": lambda d: replace(d, cost=replace(d.cost, cost=0.99 * d.cost.cost)),
    "nonempty": lambda d: used(one_step(d), "inputs", (0, 0, 0), -1.0),
    "errors reach": lambda d: used(one_step(d), "errors", (3, 2, 1), 1e-6),
    "inputs reach": lambda d: used(one_step(d), "inputs", (3, 2, 1), 1e-6),
    "terminal reach": lambda d: used(one_step(d), "terminal", (3, 1), 1e-4),
    "errors shifted": lambda d: used(d, "errors", (3, 2, 1), -1e-6),
    "inputs shifted": lambda d: used(d, "inputs", (3, 2, 1), -1e-6),
    "errors returns": lambda d: used(d, "errors", (3, -1), -1e-3),
    "inputs returns": lambda d: used(d, "inputs", (3, -1), -1e-3),
    "terminal returns": lambda d: used(d, "terminal", (3, 1), -0.1),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_a_tampered_design_fails_in_that_condition_alone(designed, name):
    assert recheck(TAMPERED[name](designed())).failing == [name]


def test_loops_of_other_gains_than_those_used_are_refused(designed):
    found = designed()
    assert recheck(of_windows(found, loops=found.windows.loops + 1e-11)).failing == ["gains"]
    assert "gains" in recheck(of_controller(found, tracking_gains=(3.0, 6.5, 6.5 + 1e-9))).failing


def test_a_coupling_that_the_tubes_did_not_count_is_refused(designed, monkeypatch):
    found = designed(COUPLED)
    bound = prove_bound(found.problem)
    monkeypatch.setattr(exact_regimes, "prove_bound", lambda problem: bound)
    rows = found.problem.input_rows
    steeper = replace(rows, errors=rows.errors * (1 + 1e-3))
    assert "inputs reach" in recheck(of_problem(found, input_rows=steeper)).failing


def test_a_wider_disturbance_is_refused(designed, monkeypatch):
    found = designed()
    bound = prove_bound(found.problem)
    wider = replace(bound, yaw=bound.yaw * (1 + 1e-4))
    monkeypatch.setattr(exact_regimes, "prove_bound", lambda problem: wider)
    failing = recheck(found).failing
    assert {"disturbance", "errors reach", "inputs reach"} <= {*failing}


# Refusals


@pytest.mark.parametrize(
    ("field", "value"),
    [("model", "consistent"), ("terminal", "T-B"), ("tube", "summed"), ("tracking_gains", ())],
)
def test_designs_of_another_kind_are_refused(designed, field, value):
    with pytest.raises(ValueError, match=f"controller.{field}"):
        recheck(of_controller(designed(), **{field: value}))


def test_a_design_without_terminal_set_is_refused(designed):
    found = designed()
    with pytest.raises(ValueError, match="terminal"):
        recheck(replace(found, terminal=replace(found.terminal, invariant=None)))
