"""Laws of what the checker says of estimates: their error stays in S under simulated slips and
noise, S and W are hardly wider than they must be, and what promises more is refused."""

import dataclasses
import json
from fractions import Fraction

import numpy as np
import observed_design
import pytest
from certificate_mutants import change, is_accepted, survey_mutants
from certificate_oracle import holds_in_floats, to_floats
from estimated_robots import EstimatedRobots, lies_in

import jaxtube as jt
from jaxtube.synthesis import proof_search
from jaxtube.synthesis.disturbance import operation
from jaxtube.synthesis.proof_file import write_certificate
from jaxtube.synthesis.proof_search import PROGRAMS, load_checker
from sets.robot.observer import bound_next_error
from sets.robot.plant import Kinematics

checker = load_checker(PROGRAMS[0])
estimates = load_checker("check_estimate.py")
intervals = load_checker("check_intervals.py")
motions = load_checker("check_motion.py")

OBSERVED = [*observed_design.OBSERVED, "slip.sideslip=0.01", "robot.lever_arm_m=-0.02"]
MIXED = ["controller.model=consistent", "controller.tracking_gains=[]", "slip.relative_error=0.05"]
MIXED += ["controller.observer_gain=[0.6,0.5,0.8]"]
SHORT = ["reference.certified_for=path", "reference.duration_s=1.2", "controller.horizon=2"]


REACHED = 0.6
"""Share of S that errors reach: corners of a box do not follow each other."""
PRECISION = 2e-4
"""Share by which proofs of the project and of the checker may differ."""
MOST_LETTERS = 3000


@pytest.fixture(scope="module")
def design():
    return jt.design(jt.load("certified", [*OBSERVED, *SHORT]))


@pytest.fixture(scope="module")
def written(design, tmp_path_factory):
    """The certificate as JSON of a small design that acts on an estimate."""
    path = write_certificate(design, tmp_path_factory.mktemp("estimated"), "estimated")
    return json.loads(path.read_text())


def test_an_estimate_is_checked_and_said_to_be(written, tmp_path, capsys):
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(written))
    assert checker.main(str(path)) == 0
    said = capsys.readouterr().out.splitlines()
    assert any(
        line.startswith("proved   as long as it keeps its caps, the estimate") for line in said
    )
    assert any(line.startswith("assumed  acted on is the estimate") for line in said)
    assert holds_in_floats(written)


@pytest.mark.parametrize("coordinate", range(3))
def test_errors_of_estimates_stay_in_their_set_and_disturbances_in_w(coordinate, written):
    said = to_floats(written)
    S = np.array(said["estimate"]["error"])
    robots = EstimatedRobots(said, 10_000)
    farthest = np.abs(robots.off).max(axis=0)
    for _ in range(20):
        assert lies_in(robots.advance(), said["bands"][0]["disturbance"])
        farthest = np.maximum(farthest, np.abs(robots.off).max(axis=0))
        robots.breed(coordinate)
    assert np.all(farthest <= S)
    assert farthest[coordinate] >= REACHED * S[coordinate]


def test_motions_leave_of_their_bounds_what_disturbances_leave_of_w(written):
    changed = json.loads(json.dumps(written))
    changed["estimate"]["error"] = ["9"] * 3  # so that S bounds nothing
    W = changed["bands"][0]["disturbance"]
    W["box"][2] = "99"
    said = to_floats(changed)
    gain = np.array(said["estimate"]["gain"])
    robots = EstimatedRobots(said | {"noise": [0.0] * 3}, 10)
    robots.off = robots.draw(to_floats(written)["estimate"]["error"])
    off = robots.off
    w = robots.advance()
    kicked = w[:, 2] + gain[2] * off[:, 2]
    most = w + gain * said["noise"]
    most[:, 1] -= float(Fraction(W["lean"])) * kicked
    certificate = checker.read(changed)
    (band,) = certificate["bands"]
    levels = estimates.bound_motions(certificate, band)
    robot = next(checker.list_motions(certificate, band))[-1][0][1]
    for name, width, shares, reached in (
        ("x", W["box"][0], gain[0], most[:, 0]),
        ("y", W["box"][1], 1.0, most[:, 1]),
        ("kick", W["yaw"], gain[2], kicked),
    ):
        for point, most_there in zip(robots.variables, reached, strict=True):
            cell = [intervals.scale(Fraction(value)) for value in (1, *point[1:])]
            piece = (Fraction(point[0]), Fraction(0), None, None)
            motion = motions.note_motion(name, cell, robot, piece).follow(cell)[-1][0]
            left = shares * (float(levels[name]) - motion / intervals.ONE)
            assert left == pytest.approx(float(Fraction(width)) - most_there, abs=1e-12)


def read_levels(certificate):
    """Return the bounds up to which the checker proves motions, by coordinate, so that S holds."""
    changed = json.loads(json.dumps(certificate))
    yaw_and_box = changed["bands"][0]["disturbance"]
    yaw_and_box |= {"yaw": "9", "box": ["9"] * 3}
    read = checker.read(changed)
    levels = estimates.bound_motions(read, read["bands"][0])
    return [levels[name] for name in ("x", "unpredicted y", "kick")]


def test_what_is_left_of_the_set_is_what_the_project_leaves(written, design):
    """With r the most that is not predicted, the project finds (1 - l) r + l nu, and asks that it
    be at most S; of headings r has the estimate's own error besides."""
    said = to_floats(written)
    gain = np.array(said["estimate"]["gain"])
    S = np.array(said["estimate"]["error"])
    found = bound_next_error(operation(design.problem), Kinematics())
    unpredicted = (found - gain * said["noise"]) / (1 - gain) - [0, 0, S[2]]
    levels = np.array(read_levels(written), float)
    np.testing.assert_allclose(levels - unpredicted, (S - found) / (1 - gain), rtol=1e-9)


@pytest.mark.parametrize(("name", "coordinate"), [("x", 0), ("unpredicted y", 1), ("kick", 2)])
def test_motions_are_proved_up_to_what_the_project_finds_and_no_further(
    name, coordinate, written, design
):
    said = to_floats(written)
    gain = said["estimate"]["gain"][coordinate]
    certificate = checker.read(written)
    (band,) = certificate["bands"]
    losses = np.array(checker.list_losses(certificate, band), float).T
    where = dataclasses.replace(operation(design.problem), wheel_errors=losses)
    found = bound_next_error(where, Kinematics())[coordinate]
    most = (found - gain * said["noise"][coordinate]) / (1 - gain)
    most -= said["estimate"]["error"][2] if name == "kick" else 0.0
    listed = checker.list_motions(certificate, band)
    of_name = {sign: cells for output, sign, _, cells in listed if output == name}

    def prove(share):
        level = intervals.scale(Fraction(most * (1 + share)))[0]
        for sign, cells in of_name.items():
            for cell in cells:
                proof_search._grow_tree(name, sign, level, *cell)

    prove(PRECISION)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(ValueError, match="not proved"):
        patch.setattr(proof_search, "MOST_LETTERS", MOST_LETTERS)
        prove(-PRECISION)


@pytest.mark.parametrize(
    ("path", "by"),
    [
        (("estimate", "error", 0), lambda error: error * 99 / 100),
        (("estimate", "error", 0), lambda error: error * 105 / 100),
        (("estimate", "error", 1), lambda error: error * 99 / 100),
        (("estimate", "error", 1), lambda error: error * 105 / 100),
        (("estimate", "error", 2), lambda error: error * 99 / 100),
        (("estimate", "error", 2), lambda error: error * 1000001 / 1000000),
        (("estimate", "gain", 0), lambda gain: gain * 99 / 100),
        (("estimate", "gain", 0), lambda gain: gain * 101 / 100),
        (("estimate", "gain", 1), lambda gain: gain * 99 / 100),
        (("estimate", "gain", 1), lambda gain: gain * 101 / 100),
        (("estimate", "gain", 2), lambda gain: gain * 99 / 100),
        (("estimate", "gain", 2), lambda gain: gain * 1000001 / 1000000),
        (("estimate", "gain", 0), lambda gain: gain + 1),
        (("estimate", "gain", 1), lambda gain: -gain),
        (("estimate", "gain", 2), lambda _: 0),
        (("noise", 0), lambda noise: noise * 105 / 100),
        (("noise", 1), lambda noise: noise * 105 / 100),
        (("noise", 1), lambda noise: -noise),
        (("noise", 2), lambda noise: noise * 1000001 / 1000000),
        (("constraints", 0), lambda limit: limit / 2),
        (("sideslip",), lambda share: share * 6 / 5),
        (("lever_arm",), lambda lever: lever * 2),
        (("bands", 0, "disturbance", "yaw"), lambda yaw: yaw * 99 / 100),
        (("bands", 0, "disturbance", "box", 0), lambda width: width * 99 / 100),
        (("bands", 0, "disturbance", "box", 1), lambda width: width * 99 / 100),
        (("bands", 0, "disturbance", "box", 2), lambda width: width * 999999 / 1000000),
    ],
)
def test_more_than_is_proved_of_an_estimate_is_refused(path, by, written, tmp_path, capsys):
    assert not is_accepted(change(written, *path, by=by), tmp_path, capsys)


ROBOT = {"noise": [Fraction(1, 100)] * 3, "bands": [{"cells": {}}]}
KNOWN = {"gain": [Fraction(1, 2)] * 3, "error": [Fraction(1, 10)] * 3}


@pytest.mark.parametrize(
    "changes",
    [
        {"learning": {}},
        {"bands": [{}]},
        {"estimate": KNOWN | {"more": 1}},
        {"estimate": KNOWN | {"gain": [Fraction(1, 2), Fraction(1, 2), Fraction(0)]}},
        {"estimate": KNOWN | {"gain": [Fraction(1, 2), Fraction(3, 2), Fraction(1)]}},
        {"estimate": KNOWN | {"gain": [Fraction(-1, 2), Fraction(1), Fraction(1)]}},
        {"estimate": KNOWN | {"error": [Fraction(1, 10), Fraction(1, 101), Fraction(1, 10)]}},
        {"noise": [Fraction(1, 100), Fraction(-1, 100), Fraction(0)]},
    ],
)
def test_what_is_no_estimate_or_begins_beyond_its_set_is_refused(changes):
    estimates.check_estimate(ROBOT | {"estimate": KNOWN})
    with pytest.raises(intervals.Refused, match="estimate"):
        estimates.check_estimate(ROBOT | {"estimate": KNOWN} | changes)


@pytest.mark.slow
def test_changed_certificates_of_estimates_are_refused_or_hold_as_well(written, tmp_path, capsys):
    survey_mutants(written, range(300), tmp_path, capsys)


@pytest.mark.slow
def test_estimates_are_checked_where_gains_are_mixed(tmp_path, capsys):
    scenario = jt.load("certified", [*MIXED, "reference.duration_s=1.2", "controller.horizon=2"])
    mixed = json.loads(write_certificate(jt.design(scenario), tmp_path, "mixed").read_text())
    assert is_accepted(mixed, tmp_path, capsys)
    for path in (("disturbance", "yaw"), ("disturbance", "box", 0), ("disturbance", "box", 1)):
        narrow = change(mixed, "bands", 0, *path, by=lambda width: width * 9 / 10)
        assert not is_accepted(narrow, tmp_path, capsys)
    for coordinate in range(3):
        narrow = change(mixed, "estimate", "error", coordinate, by=lambda error: error * 99 / 100)
        assert not is_accepted(narrow, tmp_path, capsys)
