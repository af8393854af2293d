"""Laws of `certificate.json` of a design whose wheels lag: it passes, what is changed is refused or
holds as well, and what no proof is known for is refused."""

import json
import subprocess
import sys
from fractions import Fraction

import pytest
from certificate_mutants import change, is_accepted, survey_mutants
from certificate_oracle import holds_in_floats

import jaxtube as jt
from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.proof_file import FILE, write_certificate
from jaxtube.synthesis.proof_parts import describe_robot
from jaxtube.synthesis.proof_search import CHECKER, PROGRAMS, load_checker

SHORT = ["reference.duration_s=2", "controller.horizon=2"]
"""Few windows, small QPs."""
UNKNOWN = ["robot.wheel_lag_s=[0.0495,0.0505]", "robot.command_delay_s=[0.0,0.0005]"]
SLIDING = ["slip.sideslip=0.001"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The certificate as JSON of a design of unknown lag and delay, and sideslip."""
    scenario = jt.load("certified_lag", [*SHORT, *UNKNOWN, *SLIDING])
    folder = tmp_path_factory.mktemp("proof")
    write_certificate(jt.design(scenario), folder, "late")
    return json.loads((folder / FILE).read_text())


def test_a_stranger_checks_wheels_that_lag_without_this_project(written, tmp_path):
    path = tmp_path / FILE
    path.write_text(json.dumps(written))
    program = f"import sys; sys.path.insert(0, {str(CHECKER)!r}); import check_certificate; "
    program += f"sys.exit(check_certificate.main({str(path)!r}))"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", program], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "and a latency later, true errors within" in done.stdout
    assert "assumed  both wheels lag by one constant time of 0.0495 to 0.0505 s" in done.stdout
    assert "assumed  a command arrives 0 to 0.0005 s late, at both wheels at once" in done.stdout
    assert "a latency before measured within 0.001 m, 0.001 m, 0.02 deg" in done.stdout
    assert "commands before the start, and until a latency after the end, are as" in done.stdout
    assert "at the yaw rate of the reference then, within its speeds, less u2" in done.stdout
    assert "obey at once" not in done.stdout


def test_the_oracle_agrees_with_what_was_written_of_lag(written):
    assert holds_in_floats(written)


def test_what_is_changed_of_lag_is_refused_or_holds_as_well(written, tmp_path, capsys):
    accepted = survey_mutants(written, range(5), tmp_path, capsys)
    assert len(accepted) < 5


@pytest.mark.slow
def test_many_changed_certificates_of_lag_are_refused_or_hold_as_well(written, tmp_path, capsys):
    survey_mutants(written, range(30, 530), tmp_path, capsys)


@pytest.mark.parametrize(
    ("path", "by"),
    [
        (("lateness", "lag", 0), lambda lag: lag * 9 / 10),
        (("lateness", "lag", 1), lambda lag: lag * 11 / 10),
        (("lateness", "delay", 1), lambda delay: delay * 4),
        (("lateness", "nominal", 0), lambda lag: lag * 2),
        (("lateness", "lever"), lambda lever: lever / 2),
        (("lateness", "noise", 0), lambda noise: noise * 1001 / 1000),
        (("lateness", "wheels", "right", 1), lambda speed: speed * 999 / 1000),
        (("lateness", "wheels", "left", 0), lambda speed: speed * 1001 / 1000),
        (("lateness", "speeds", 0), lambda speed: speed * 1001 / 1000),
        (("lateness", "speeds", 1), lambda speed: speed * 999 / 1000),
        (("lateness", "speeds", 1), lambda speed: speed * 2),
        (("sideslip",), lambda sideslip: sideslip * 10),
        (("sideslip",), lambda sideslip: -sideslip),
        (("lever_arm",), lambda _: 1),
        (("slips", "left", 0, 1), lambda slip: slip * 101 / 100),
        (("slips", "right", 0, 3), lambda slip: slip * 11 / 10),
        (("noise", 1), lambda noise: noise * 999 / 1000),
        (("constraints", 0), lambda limit: limit * 7 / 10),
        (("bands", 0, "disturbance", "yaw"), lambda yaw: yaw * 97 / 100),
        (("bands", 0, "disturbance", "box", 0), lambda width: width * 97 / 100),
        (("bands", 0, "disturbance", "box", 1), lambda width: width * 95 / 100),
    ],
)
def test_a_promise_of_wheels_that_lag_beyond_what_is_proved_is_refused(
    path, by, written, tmp_path, capsys
):
    assert not is_accepted(change(written, *path, by=by), tmp_path, capsys)


def test_lag_is_not_left_out_of_a_promise(written, tmp_path, capsys):
    without = {name: entry for name, entry in written.items() if name != "lateness"}
    assert not is_accepted(without, tmp_path, capsys)


def test_cells_hold_what_unknown_lag_takes_and_leave_the_slide_to_the_rest(written):
    program = load_checker(PROGRAMS[0])
    certificate = program.read(written)
    certificate["lever_arm"] = Fraction(1, 1000)
    (band,) = certificate["bands"]
    late = load_checker("check_lag.py").find_late(certificate, band)
    for _, _, _, cells in program.list_motions(certificate, band):
        for cell, robot, _ in cells:
            *_, sideslip, _, _, _, way, turn, lever = cell
            assert robot[2] == 0 and sideslip == (0, 0)
            for (low, high), size in zip((way, turn), late.taken, strict=True):
                assert Fraction(high, 2**56) >= size > 0 and low == -high
            assert lever[0] <= certificate["lateness"]["lever"] * 2**56 <= lever[1]


def test_of_slips_that_are_read_either_way_the_true_one_is_promised_where_wheels_lag(written):
    for cases in written["slips"].values():
        assert len(cases) == 1 and cases[0][0] != cases[0][1] and cases[0][2] == cases[0][3]


def test_the_measured_slip_is_described_where_it_is_the_one_that_varies():
    problem = complete_problem(jt.load("certified_lag", [*SHORT, "slip.random=measured"]))
    for cases in describe_robot(problem)["slips"].values():
        assert len(cases) == 1 and cases[0][0] == cases[0][1] and cases[0][2] != cases[0][3]


@pytest.mark.parametrize(
    ("name", "random", "said"),
    [
        ("certified", "true", "true or measured slip"),
        ("certified", "measured", "true or measured slip"),
        ("certified_lag", "true", "true slip within"),
        ("certified_lag", "measured", "measured slip within"),
    ],
)
def test_a_guarantee_says_which_slip_may_be_off(name, random, said):
    problem = make_problem(jt.load(name, [*SHORT, f"slip.random={random}"]))
    assert assumptions(problem, any_order=True)[0].startswith(said)
