"""Laws of what the checker says of estimates of robots whose wheels lag: their error stays in S
under simulated lag, slips and noise, and what promises more is refused."""

import json
from fractions import Fraction

import numpy as np
import pytest
from certificate_mutants import change, is_accepted, survey_mutants
from certificate_oracle import holds_in_floats, to_floats
from estimated_robots import LateRobots, lies_in
from tolerances import ROUNDING

import jaxtube as jt
from jaxtube.simulation import batches, components
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.proof_file import write_certificate
from jaxtube.synthesis.proof_search import PROGRAMS, load_checker

checker = load_checker(PROGRAMS[0])
late_program = load_checker("check_lag.py")

SHORT = ["reference.certified_for=path", "reference.duration_s=1.2", "controller.horizon=2"]
LATE = ["robot.command_delay_s=[0.01,0.02]", "robot.lever_arm_m=0"]
ROBOTS = 150
REACHED = 0.7
"""Share of S that errors reach within a period."""
REACHED_ON_LAPS = 0.2
"""Share of S that errors reach where nobody looks for the worst."""
LAPS = 512
WIDE = 9
"""Bound of a motion, m or rad, that is kept anyway."""


@pytest.fixture(scope="module")
def design():
    return jt.design(jt.load("husky", [*SHORT, *LATE]))


@pytest.fixture(scope="module")
def written(design, tmp_path_factory):
    """The certificate as JSON of a small design of a robot that lags and acts on an estimate."""
    path = write_certificate(design, tmp_path_factory.mktemp("late"), "late")
    return json.loads(path.read_text())


def test_estimates_and_lag_are_checked_together(written, tmp_path, capsys):
    assert is_accepted(written, tmp_path, capsys)
    said = [*checker.list_assumptions(checker.read(written))]
    assert sum("acted on" in sentence for sentence in said) == 2


def test_from_its_set_no_error_of_an_estimate_leaves_it_and_no_disturbance_leaves_w(written):
    said = to_floats(written)
    S = np.array(said["estimate"]["error"])
    robots = LateRobots(said, ROBOTS)
    farthest = np.zeros(3)
    for _ in range(3):
        robots.off = robots.draw(S)
        assert lies_in(robots.advance(), said["bands"][0]["disturbance"])
        farthest = np.maximum(farthest, np.abs(robots.off).max(axis=0))
    assert np.all(farthest <= S)
    assert np.all(farthest >= REACHED * S)


@pytest.mark.slow
@pytest.mark.parametrize("process", ["vertex", "adversarial"])
def test_laps_keep_what_is_proved_of_their_estimates(process, design, written):
    said = to_floats(written)
    (band,) = said["bands"]
    keys = realisation_keys(7, 0, LAPS)
    starts = np.asarray(choose_starts(design, "feasible").draw(keys))
    robot = components.slipping_robot(design, process)
    laps = batches.run_realisations(components.make_tube_mpc(design), robot, starts, 7)
    off = np.abs(laps.measured - laps.errors)
    assert np.all(off <= said["estimate"]["error"])
    assert np.max(off / said["estimate"]["error"]) >= REACHED_ON_LAPS
    assert np.all(np.abs(laps.measured) <= np.array(band["errors"]) + ROUNDING)
    assert lies_in(batches.model_disturbances(design, laps).reshape(-1, 3), band["disturbance"])


def test_estimates_take_over_their_share_of_what_lag_adds(written):
    certificate = checker.read(written)
    (band,) = certificate["bands"]
    late = late_program.find_late(certificate, band)
    levels = {
        (name, sign): WIDE for name in ("x", "y", "unpredicted y", "kick") for sign in (1, -1)
    }
    narrowed = late_program.narrow_levels(certificate, levels, late)
    ahead, side = late.rest
    for sign in (1, -1):
        assert WIDE - narrowed["x", sign] == ahead
        assert WIDE - narrowed["unpredicted y", sign] == side
        assert WIDE - narrowed["y", sign] == side * certificate["estimate"]["gain"][1]
        assert ("kick", sign) not in narrowed


def test_a_kick_of_lag_counts_in_the_heading_of_the_estimate(written):
    """The set S allows a kick of (S - l nu) / (1 - l) - S there."""
    certificate = checker.read(written)
    (band,) = certificate["bands"]
    late = late_program.find_late(certificate, band)
    gain = certificate["estimate"]["gain"][2]
    least = certificate["noise"][2] + (1 - gain) / gain * late.kick
    band["disturbance"]["yaw"] = Fraction(WIDE)
    band["disturbance"]["box"][2] = Fraction(WIDE)
    for share, is_held in ((1, True), (1 - Fraction(1, 10**9), False)):
        certificate["estimate"]["error"][2] = least * share
        if is_held:
            assert list(checker.list_motions(certificate, band))
        else:
            with pytest.raises(checker.Refused, match="turn the robot"):
                list(checker.list_motions(certificate, band))


@pytest.mark.parametrize(
    ("path", "by"),
    [
        # What the project proves of lag is wider by a few hundredths.
        (("estimate", "error", 0), lambda error: error * 9 / 10),
        (("estimate", "error", 1), lambda error: error * 9 / 10),
        (("estimate", "error", 1), lambda error: error * 11 / 10),
        (("estimate", "error", 2), lambda error: error * 9 / 10),
        (("estimate", "gain", 0), lambda gain: gain * 9 / 10),
        (("estimate", "gain", 1), lambda gain: gain * 11 / 10),
        (("estimate", "gain", 2), lambda gain: gain * 9 / 10),
        (("lateness", "lag", 0), lambda lag: lag / 2),
        (("lateness", "lag", 1), lambda lag: lag * 11 / 10),
        (("lateness", "delay", 0), lambda delay: delay / 2),
        (("lateness", "delay", 1), lambda delay: delay * 11 / 10),
        (("lateness", "lever"), lambda lever: -lever),
        (("lateness", "wheels", "right", 1), lambda speed: speed * 99 / 100),
        (("lateness", "noise", 2), lambda noise: noise * 11 / 10),
        (("noise", 1), lambda noise: noise * 11 / 10),
        (("sideslip",), lambda share: share * 11 / 10),
        (("slips", "left", 0, 1), lambda slip: slip * 11 / 10),
        (("bands", 0, "disturbance", "box", 1), lambda width: width * 9 / 10),
        (("bands", 0, "disturbance", "yaw"), lambda yaw: yaw * 9 / 10),
        (("constraints", 1), lambda limit: limit * 9 / 10),
    ],
)
def test_more_than_is_proved_is_refused(path, by, written, tmp_path, capsys):
    assert not is_accepted(change(written, *path, by=by), tmp_path, capsys)


def test_the_oracle_agrees_with_what_was_written(written):
    assert holds_in_floats(written)


@pytest.mark.slow
def test_what_is_changed_is_refused_or_holds_as_well(written, tmp_path, capsys):
    survey_mutants(written, range(300), tmp_path, capsys)
