"""Laws of a design: its sets and gains, what each choice of terminal set leads to, and its
refusals."""

import numpy as np
import pytest
from oracles import SEQUENCE, TIGHT, PlainMpc, model, terminal_gain, tube_gain
from scipy.linalg import solve_discrete_are
from tolerances import CLOSED_LOOP, LINEAR_PROGRAM, ROUNDING

from jaxtube.plant.error_dynamics import tracking_error
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.design import EmptySetError, design, refuse_infeasible_start
from jaxtube.synthesis.feasible import boundary
from jaxtube.synthesis.problem import make_problem
from sets.polytope import Polytope

# ------------------------------------------------------------------------------------ sets and data


def test_the_papers_sets(paper_design):
    problem = paper_design.problem
    np.testing.assert_allclose(
        problem.error_set.support(np.eye(3)), [0.3, 0.3, np.deg2rad(20)], atol=ROUNDING
    )
    np.testing.assert_allclose(
        problem.disturbance_set.support(np.eye(3)), [0.005, 0.005, np.deg2rad(0.2)], atol=ROUNDING
    )
    np.testing.assert_allclose(problem.input_set.offsets, [2.54, 2.54, 0.84, 0.84], atol=ROUNDING)
    deficits = np.array([[1, 0.25], [1, -0.25]])
    np.testing.assert_allclose(problem.input_set.support(deficits), 2.54, atol=CLOSED_LOOP)
    np.testing.assert_allclose(problem.input_set.support(-deficits), 0.84, atol=CLOSED_LOOP)
    np.testing.assert_allclose(problem.initial_error, [-0.1, -0.1, 0.0], atol=ROUNDING)
    np.testing.assert_array_equal(problem.error_weight, np.diag([1, 1, 0.01]))


def test_the_initial_error_is_that_of_eq_3():
    problem = make_problem(
        load("paper", ["initial.x_m=0.2", "initial.y_m=-0.05", "initial.heading_deg=40"])
    )
    pose = np.array([0.2, -0.05, np.deg2rad(40)])
    np.testing.assert_allclose(
        problem.initial_error, tracking_error(pose, problem.reference.poses[0]), atol=ROUNDING
    )


@pytest.mark.parametrize("input_map", ["paper", "cosine_free"])
def test_inputs_in_U_never_saturate_a_wheel(input_map):
    settings = [
        "slip.nominal_left=0.3",
        "robot.wheel_speed_max_mps=2.8",
        "robot.wheel_speed_min_mps=-1",
    ]
    problem = make_problem(load("paper", [f"controller.input_map={input_map}", *settings]))
    generator = np.random.default_rng(4)
    count = 20_000
    vertices = problem.input_set.vertices()
    inputs = np.where(
        generator.random(count)[:, None] < 0.5,
        vertices[generator.integers(len(vertices), size=count)],
        generator.dirichlet(np.ones(len(vertices)), count) @ vertices,
    )
    ends = generator.random((count, 2)) < 0.5
    reference = np.where(
        ends, generator.choice([0.2, 1.5], (count, 2)), generator.uniform(0.2, 1.5, (count, 2))
    )
    slip = np.array([0.2, 0.3]) * np.where(
        ends, generator.choice([0.9, 1.1], (count, 2)), generator.uniform(0.9, 1.1, (count, 2))
    )
    heading = np.deg2rad(generator.choice([-20, 0, 20], count))
    deficits = inputs @ np.array([[1, 1], [0.25, -0.25]])
    if input_map == "cosine_free":
        deficits = deficits + (reference.mean(axis=1) * (1 - np.cos(heading)))[:, None]
    wheels = (reference - deficits) / (1 - slip)
    assert wheels.min() >= -1 - ROUNDING and wheels.max() <= 2.8 + ROUNDING
    # Not by a wide margin either: both limits are reached by some input, reference and slip in the
    # box.
    assert wheels.max() > 2.799 and wheels.min() < (-0.999 if input_map == "paper" else -0.9)


def test_gains_of_the_tube_are_the_riccati_gain_at_the_centre_and_what_cancels_the_schedule(
    paper_design,
):
    problem = paper_design.problem
    A, B = model(problem, [0.85, 0.85])
    P = solve_discrete_are(A, B, problem.error_weight, problem.input_weight)
    riccati = -np.linalg.solve(problem.input_weight + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(paper_design.lqr_gain, riccati, atol=CLOSED_LOOP)
    for wheels, gain in zip(
        [[0.2, 1.5], [0.2, 0.2], [1.5, 0.2], [1.5, 1.5]],
        paper_design.tube_gain.vertices,
        strict=True,
    ):
        np.testing.assert_allclose(gain, tube_gain(paper_design, wheels), atol=CLOSED_LOOP)
        A, B = model(problem, wheels)
        # The first row of the loop is the same at every schedule: that is what the compensating
        # gains are for.
        np.testing.assert_allclose(
            (A + B @ gain)[0], [1 + 0.1 * riccati[0, 0], 0, 0], atol=CLOSED_LOOP
        )


# ------------------------------------------------------------------------------------ terminal sets


def test_terminal_choices_lead_where_they_should(paper_design, robust_design, uncertified):
    sequence = uncertified("paper", *SEQUENCE)
    stand_in = uncertified("robust", *TIGHT)
    assert [f.terminal.fallback for f in (paper_design, robust_design, sequence, stand_in)] == [
        False,
        False,
        False,
        True,
    ]
    np.testing.assert_array_equal(sequence.tube_gain.vertices, sequence.cost.gains)
    assert not np.allclose(robust_design.tube_gain.vertices, robust_design.cost.gains)
    assert stand_in.terminal.invariant is None
    R_N = stand_in.tubes["summed"][-1].support(stand_in.problem.error_set.normals)
    np.testing.assert_array_equal(
        stand_in.terminal.constraint_normals, stand_in.problem.error_set.normals
    )
    left = stand_in.problem.error_set.offsets - R_N
    np.testing.assert_allclose(
        stand_in.terminal.constraint_offsets, np.tile(left, (len(stand_in.windows.loops), 1))
    )


def test_a_terminal_set_for_gains_that_differ_receives_every_shifted_plan(robust_design):
    """T-B, corner by corner: a last error, a disturbance carried through every product of N - 1
    loops, every vertex."""
    found = robust_design
    problem = robust_design.problem
    carried = robust_design.problem.disturbance_set.vertices()
    pairs = [model(problem, wheels) for wheels in problem.model.vertices]
    tube_loops = [
        A + B @ tube_gain(found, wheels)
        for (A, B), wheels in zip(pairs, problem.model.vertices, strict=True)
    ]
    for _ in range(problem.horizon - 1):
        carried = np.concatenate([carried @ loop.T for loop in tube_loops])
    last = Polytope(found.bounds.terminal_normals, found.bounds.terminal[0])
    errors = (last.vertices()[:, None] + carried).reshape(-1, 3)
    E = Polytope(problem.error_set.normals, found.bounds.errors[0, -1])
    U = found.bounds.inputs[0, -1]
    assert E.contains(errors, CLOSED_LOOP).all()
    for (A, B), gain in zip(pairs, found.cost.gains, strict=True):
        assert np.all(errors @ gain.T @ problem.input_set.normals.T <= U + CLOSED_LOOP)
        assert last.contains(errors @ (A + B @ gain).T, CLOSED_LOOP).all()


def test_a_terminal_set_along_the_reference_receives_every_shifted_plan(uncertified):
    """T-A: the disturbance is carried through the loops ahead, and the next step has its own
    terminal set."""
    found = uncertified("paper", *SEQUENCE)
    problem = found.problem
    N = found.problem.horizon
    for step in range(0, problem.reference.steps - 1, 3):
        now = found.bounds.terminal[found.windows.index[step]]
        following = found.bounds.terminal[found.windows.index[step + 1]]
        carried = problem.disturbance_set.vertices()
        for ahead in range(1, N + 1):
            if ahead == N:
                last = Polytope(found.bounds.terminal_normals, now).vertices()
                carried = (last[:, None] + carried).reshape(-1, 3)
            A, B = model(problem, problem.schedule[step + ahead])
            carried = carried @ (A + B @ terminal_gain(found, problem.schedule[step + ahead])).T
        assert (
            Polytope(found.bounds.terminal_normals, following).contains(carried, CLOSED_LOOP).all()
        )


@pytest.mark.parametrize("name", ["robust", "sequence"])
def test_from_the_edge_of_the_feasible_set_every_disturbance_leads_to_another_plan(
    robust_design, uncertified, name
):
    """Recursive feasibility, attacked where it is tightest: every vertex of W after the exact
    solver's plan."""
    found = robust_design if name == "robust" else uncertified("paper", *SEQUENCE)
    plain = PlainMpc(found)
    vertices = found.problem.disturbance_set.vertices()
    # Steps before, at and after the change of circle: the windows there differ from one step to the
    # next.
    for step in (0, 111, 113, 115):
        window = int(found.windows.index[step])
        wheels = found.problem.schedule[step]
        A, B = model(found.problem, wheels)
        for error in boundary(found.tube_qps, window, found.problem.error_set, 12, seed=step) * (
            1 - LINEAR_PROGRAM
        ):
            inputs, _ = plain.qp(step).plan(error)
            for w in vertices:
                assert plain.qp(step + 1).shortfall(A @ error + B @ inputs[0] + w) <= LINEAR_PROGRAM


# ----------------------------------------------------------------------------------------- refusals


def one_line(error):
    assert "\n" not in str(error.value)
    return str(error.value)


def test_an_empty_error_set_is_named_with_its_stage_and_what_it_lacks():
    """Along e_y, R_2 of `summed` is h_W(c) + max_i h_W(Phi_i' c) on either side."""
    scenario = load("robust", ["disturbance.lateral_m=0.2"])
    problem = make_problem(scenario)
    A, B = model(problem, [1.15, 1.15])
    P = solve_discrete_are(A, B, problem.error_weight, problem.input_weight)
    K = -np.linalg.solve(problem.input_weight + B.T @ P @ B, B.T @ P @ A)
    half_widths = np.array([0.005, 0.2, np.deg2rad(0.2)])
    reach = 0.0
    for wheels in problem.model.vertices:
        A, B = model(problem, wheels)
        gain = K.copy()
        gain[0, 1] -= 0.8 * (wheels[0] - wheels[1]) / 0.5
        reach = max(reach, np.abs((A + B @ gain)[1]) @ half_widths)
    lacking = 2 * (0.2 + reach) - 0.6
    with pytest.raises(EmptySetError) as error:
        design(scenario)
    assert one_line(error).startswith(
        "E_2 is empty: in the lateral error"
    ) and f"short by {lacking:.4g}" in str(error.value)


def test_an_empty_input_set_is_named_with_its_stage_and_what_it_lacks(uncertified):
    """The tube does not depend on the wheels' limits, so that of another design tells the first
    empty stage."""
    wide = uncertified("robust")
    row = np.array([1, 0.25])
    vertices = wide.problem.model.vertices
    reach = [
        max(section.support(row @ tube_gain(wide, wheels))[0] for wheels in vertices)
        for section in wide.tubes["summed"]
    ]
    width = (0.8 - 0.82 * 0.9) - (1.5 - 0.78 * 1.97)
    lacking = 2 * np.array(reach) - width
    stage = int(np.argmax(lacking > 0))
    assert 0 < stage < 5
    with pytest.raises(EmptySetError) as error:
        design(load("robust", ["robot.wheel_speed_max_mps=1.97", "robot.wheel_speed_min_mps=0.9"]))
    assert one_line(error).startswith(f"U_{stage} is empty: in the right wheel deficit")
    assert f"short by {lacking[stage]:.4g}" in str(error.value)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["robot.wheel_speed_max_mps=1.8"],
            r"robot\.wheel_speed_max_mps = 1\.8: .*needs robot\.wheel_speed_max_mps >= 1\.924",
        ),
        (
            ["reference.shape=lemniscate", "reference.speed_mps=1.45"],
            r"reference\.speed_mps = 1\.45: .*outside",
        ),
        (["reference.duration_s=30.05"], r"duration = 30\.05"),
        (["controller.discretisation=zoh"], r"controller\.tube = paper: .*choose"),
    ],
)
def test_data_that_no_controller_can_be_built_from_is_refused_in_one_line(overrides, message):
    with pytest.raises(ScenarioError, match=message) as error:
        design(load("paper", overrides))
    one_line(error)


WHEELS = "robot.wheel_speed_max_mps"
SLOWEST = "robot.wheel_speed_min_mps"
LEAST = "reference.wheel_speed_min_mps"
OTHER_MAP = ["controller.input_map=cosine_free", "controller.model=consistent"]


@pytest.mark.parametrize(
    ("key", "overrides"),
    [
        (WHEELS, [f"{WHEELS}=1"]),
        (WHEELS, [f"{WHEELS}=1.1", "slip.nominal_left=0.4"]),
        (SLOWEST, [f"{SLOWEST}=0.9"]),
        (LEAST, [f"{SLOWEST}=0.6"]),
        (LEAST, [f"{SLOWEST}=0.6", "slip.nominal_left=0.4", *OTHER_MAP]),
    ],
)
def test_a_key_that_wheels_are_refused_by_works_at_the_value_told_and_no_hundredth_beyond(
    key, overrides
):
    with pytest.raises(ScenarioError) as refused:
        make_problem(load("paper", overrides))
    sign = "<=" if key == SLOWEST else ">="
    value = float(one_line(refused).split(f"{key} {sign} ")[1].split(",")[0])
    make_problem(load("paper", [*overrides, f"{key}={value}"]))
    beyond = value * (1.01 if key == SLOWEST else 0.99)
    with pytest.raises(ScenarioError, match="wheels cannot"):
        make_problem(load("paper", [*overrides, f"{key}={beyond}"]))


def test_a_slower_reference_is_told_for_slow_wheels():
    slow = [f"{WHEELS}=1"]
    with pytest.raises(ScenarioError) as refused:
        make_problem(load("paper", slow))
    told = one_line(refused).split("reference.wheel_speed_max_mps <= ")[1].split()[0]
    assert float(told) == 0.7799
    slower = ["reference.speed_mps=0.7", f"reference.wheel_speed_max_mps={told}"]
    make_problem(load("paper", [*slow, *slower]))


@pytest.mark.parametrize("direction", [[-0.2, -0.1, 0.05], [0.05, 0.25, 0.2]])
def test_a_start_without_a_plan_is_refused_with_the_share_that_has_one(robust_design, direction):
    problem = robust_design.problem
    qp = PlainMpc(robust_design).qp(0)
    error = 2 * np.array(direction)
    with pytest.raises(ScenarioError, match=r"at most \d+% as far") as refusal:
        refuse_infeasible_start(robust_design, error)
    share = int(one_line(refusal).split("at most ")[1].split("%")[0]) / 100
    inside = (share - 0.006) * error
    outside = (share + 0.011) * error
    assert qp.shortfall(inside) <= 0 and problem.error_set.contains(inside)
    assert qp.shortfall(outside) > 0 or not problem.error_set.contains(outside)
    refuse_infeasible_start(robust_design, inside)
    with pytest.raises(ScenarioError):
        refuse_infeasible_start(robust_design, outside)


def test_the_start_of_the_scenario_is_the_one_judged_by_default(robust_design):
    refuse_infeasible_start(robust_design)


@pytest.mark.parametrize(
    "heading, error",
    [(360.0, 0.0), (-350.0, -10.0), (190.0, 170.0), (180.0, 180.0), (-180.0, 180.0)],
)
def test_the_initial_heading_error_counts_modulo_a_turn(heading, error):
    problem = make_problem(load("paper", [f"initial.heading_deg={heading}"]))
    assert np.rad2deg(problem.initial_error[2]) == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize("rounding", [-1e-10, 0.0, 1e-10])
def test_a_path_on_the_edge_of_the_box_lies_in_the_certified_region(rounding):
    slowest = 1.36 * (1 - 0.5 / 5.4) + rounding
    fastest = 1.36 * (1 + 0.5 / 5.4) - rounding
    box = [
        f"reference.wheel_speed_min_mps={slowest!r}",
        f"reference.wheel_speed_max_mps={fastest!r}",
    ]
    problem = make_problem(load("certified", ["reference.radius_m=2.7", *box]))
    lower, upper = problem.regions[0]
    assert np.all((lower <= problem.reference.wheels) & (problem.reference.wheels <= upper))
    np.testing.assert_allclose([lower[0], upper[0]], [slowest, fastest], rtol=0, atol=1e-9)
