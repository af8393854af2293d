"""The paper's claims, each with what was measured and whether it was reproduced.

Source of the claims: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III and IV.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxtube.coordinates import COORDINATES, Coordinate
from jaxtube.experiments.run.table import format_table, left
from jaxtube.synthesis.certificate.existence import OBJECTIVES

SAME = 1e-9
"""Errors that differ by less are equal."""
PEAK_M = 0.25
"""Where the paper's lateral error peaks without slip compensation."""


class PaperClaim(NamedTuple):
    """One claim; `verdict` is "reproduced", "in part" or "not reproduced"."""

    claim: str
    measured: str
    verdict: str


def claims(metrics: dict) -> list[PaperClaim]:
    """Judge every claim from the metrics of a run."""
    controllers = metrics["controllers"]
    tube = controllers["tube_mpc"]
    return [
        _leaves(controllers["uncompensated"]),
        _lateral_peaks(controllers["uncompensated"]),
        _stay_inside(controllers["compensated"], tube),
        *_smallest_errors(controllers),
        _wheels_rise(controllers, metrics["reference_wheel_speed_mean_mps"]),
        _acceptable_sets(metrics["certificate"]),
        _terminal_region(metrics["certificate"]),
        _uncertainty(metrics["disturbance"]),
        _advantage(controllers),
        _tube_role(tube, controllers["plain_mpc"], metrics),
    ]


def table(rows: list[PaperClaim]) -> str:
    """Return the claims as a plain-text table."""
    return format_table([left("claim"), left("measured"), left("verdict")], rows)


def _verdict(share: float) -> str:
    """Return the verdict on a claim of which a share was reproduced."""
    if share == 1:
        return "reproduced"
    return "in part" if share > 0 else "not reproduced"


def _leaves(uncompensated: dict) -> PaperClaim:
    share = uncompensated["violation_share_by_coordinate"]["longitudinal_m"]
    peak = uncompensated["max_error"]["whole_run"]
    text = (
        f"|e_x| leaves its limit in {share:.1%} of {uncompensated['realisations']} realisations; "
        f"largest {peak['median']['longitudinal_m']:.3f} m (median), "
        f"{peak['worst']['longitudinal_m']:.3f} m (worst)"
    )
    return PaperClaim("without slip compensation |e_x| leaves its limit", text, _verdict(share))


def _lateral_peaks(uncompensated: dict) -> PaperClaim:
    peak = uncompensated["max_error"]["whole_run"]
    median = peak["median"]["lateral_m"]
    high = peak["p95"]["lateral_m"]
    worst = peak["worst"]["lateral_m"]
    text = f"largest |e_y| {median:.3f} m (median), {high:.3f} m (95 %), {worst:.3f} m (worst)"
    verdict = "not reproduced"
    if abs(median - PEAK_M) <= 0.1 * PEAK_M:
        verdict = "reproduced"
    elif median < PEAK_M <= worst:
        verdict = "in part"
    return PaperClaim("without slip compensation e_y peaks close to 0.25 m", text, verdict)


def _stay_inside(compensated: dict, tube: dict) -> PaperClaim:
    of_compensation = compensated["violation_share"]
    of_tube = tube["violation_share"]
    text = (
        f"runs outside E: slip compensation {of_compensation:.1%}, tube MPC {of_tube:.1%} of "
        f"{tube['realisations']}"
    )
    is_kept = of_compensation == of_tube == 0
    return PaperClaim("both compensating controllers stay inside E", text, _verdict(float(is_kept)))


def _smallest_errors(controllers: dict) -> list[PaperClaim]:
    rows = []
    for kind, label in (("max_error", "largest"), ("rms_error", "RMS")):
        for span, when in (("whole_run", "whole run"), ("after_10_s", "after 10 s")):
            title = f"MPC has the smallest {label} error, {when}"
            tube = controllers["tube_mpc"][kind][span]["median"]
            compensated = controllers["compensated"][kind][span]["median"]
            rows.append(_smallest_error(title, tube, compensated))
    return rows


def _smallest_error(title: str, tube: dict, compensated: dict) -> PaperClaim:
    """Compare tube MPC with slip compensation, coordinate by coordinate; the same start is no
    difference."""
    keys = [coordinate.key for coordinate in COORDINATES]
    differing = [key for key in keys if not _is_same(tube[key], compensated[key])]
    wins = sum(tube[key] < compensated[key] for key in differing)
    parts = [_compare(coordinate, tube, compensated) for coordinate in COORDINATES]
    text = f"{'; '.join(parts)} (tube MPC vs slip compensation, medians)"
    return PaperClaim(title, text, _verdict(wins / len(differing) if differing else 0.0))


def _compare(coordinate: Coordinate, tube: dict, compensated: dict) -> str:
    value = tube[coordinate.key]
    other = compensated[coordinate.key]
    if _is_same(value, other):
        return f"{coordinate.name} {value:.4g} {coordinate.unit} for both"
    return f"{coordinate.name} {value:.4g} vs {other:.4g} {coordinate.unit}"


def _is_same(value: float, other: float) -> bool:
    return abs(value - other) <= SAME


def _wheels_rise(controllers: dict, reference: float) -> PaperClaim:
    names = ("uncompensated", "compensated", "tube_mpc")
    ratios = {name: controllers[name]["wheel_speed_mean_mps"] / reference for name in names}
    listed = ", ".join(f"{name} {ratio:.3f}" for name, ratio in ratios.items())
    text = (
        f"mean wheel speed / reference: {listed}; any loop that keeps up shows it: the one without "
        "compensation too, paying with its steady |e_x|"
    )
    rise = min(ratios["compensated"], ratios["tube_mpc"]) > ratios["uncompensated"] > 1
    return PaperClaim("wheel speeds rise to make up for slip", text, _verdict(float(rise)))


def _acceptable_sets(conditions: dict) -> PaperClaim:
    of_errors = conditions["error_sets_not_empty"]["margin"]
    of_inputs = conditions["input_sets_not_empty"]["margin"]
    text = f"smallest inner radius: E_j {of_errors:.3f}, U_j {of_inputs:.3f}"
    verdict = _verdict(float(min(of_errors, of_inputs) > 0))
    return PaperClaim("the tightened sets have acceptable sizes", text, verdict)


def _terminal_region(conditions: dict) -> PaperClaim:
    is_invariant = conditions["terminal_set_invariant"]["holds"]
    decreases = conditions["terminal_cost_decrease"]["holds"]
    shifted = conditions["plan_stays_feasible"]
    text = (
        f"invariant terminal set: {_yes(is_invariant)}; cost decreases: {_yes(decreases)}; shifted "
        f"plan stays feasible: {'yes' if shifted['holds'] else 'not shown'} (margin "
        f"{shifted['margin']:.3g}){_say_what_exists(conditions)}"
    )
    share = (is_invariant + decreases + shifted["holds"]) / 3
    title = "a terminal region makes the MPC stable and recursively feasible"
    return PaperClaim(title, text, _verdict(share))


def _say_what_exists(conditions: dict) -> str:
    """Return for which gains a terminal set exists; "" for a design that is given its gains."""
    of_tube_gain = conditions.get("invariant_set_for_tube_gain")
    if of_tube_gain is None:
        return ""
    names = [name for name in OBJECTIVES if conditions[f"terminal_set_for_{name}"]["holds"]]
    return (
        f". A set exists for the LMI objectives {', '.join(names) or 'none'}; for the section "
        f"III-B gain: {_yes(of_tube_gain['holds'])}"
    )


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _uncertainty(disturbance: dict) -> PaperClaim:
    share = disturbance["share_of_steps_outside"]
    text = (
        f"w lies outside W in {share:.1%} of {disturbance['steps']} steps; largest heading "
        f"residual {disturbance['largest']['heading_deg']:.2f} deg, W allows "
        f"{disturbance['allowed']['heading_deg']:.2f} deg"
    )
    title = "W covers linearisation, slip measurement and pose errors"
    return PaperClaim(title, text, _verdict(float(share == 0)))


def _advantage(controllers: dict) -> PaperClaim:
    names = ("compensated", "local_gain", "equal_gain", "plain_mpc", "tube_mpc")
    rms = {}
    for name in names:
        rms[name] = controllers[name]["rms_error"]["whole_run"]["median"]["lateral_m"]
    listed = ", ".join(f"{name} {value:.4f} m" for name, value in rms.items())
    text = f"lateral RMS, median: {listed}"
    if _is_same(rms["equal_gain"], rms["tube_mpc"]):
        text += (
            "; no row was active: a gain scheduled on the preview, computed beforehand, is the "
            "same controller"
        )
    is_better = rms["tube_mpc"] < min(rms["compensated"], rms["local_gain"])
    title = "the advantage comes from prediction and from the uncertainty in the control law"
    return PaperClaim(title, text, "in part" if is_better else "not reproduced")


def _tube_role(tube: dict, plain: dict, metrics: dict) -> PaperClaim:
    stress = metrics["stress"]["linear_w_in_W"]
    with_tube = stress["tube_mpc"]
    without = stress["plain_mpc"]
    conditions = metrics["stress_certificate"].values()
    is_proved = all(entry["holds"] for entry in conditions if entry["scope"] == "model")
    text = (
        f"on the lap rows are active in {tube['active_share']:.2%} of steps (without "
        f"{plain['active_share']:.2%}). Design `{metrics['stress_design']}`, linear plant, w in W: "
        f"{with_tube['runs_outside_E']} of {with_tube['runs']} runs leave E with the tube, "
        f"{without['runs_outside_E']} without; its conditions on the model "
        f"{'all hold' if is_proved else 'do not all hold'}"
    )
    no_run_failed = with_tube["runs_outside_E"] == with_tube["runs_with_infeasible_QP"] == 0
    verdict = "not reproduced"
    if is_proved and no_run_failed:
        stays_feasible = metrics["certificate"]["plan_stays_feasible"]["holds"]
        verdict = "reproduced" if stays_feasible else "in part"
    return PaperClaim("the tube keeps the constraints under every w in W", text, verdict)
