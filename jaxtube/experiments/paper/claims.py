"""The paper's claims, each with what was measured and whether it was reproduced.

Source of the claims: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III and IV.
"""

from __future__ import annotations

import textwrap
from typing import NamedTuple

from jaxtube.experiments.run.metrics import COORDINATES

CLAIM_WIDTH, MEASURED_WIDTH = 38, 62


class Claim(NamedTuple):
    """One claim; `verdict` is "reproduced", "in part" or "not reproduced"."""

    claim: str
    measured: str
    verdict: str


def claims(metrics: dict) -> list[Claim]:
    """Judge every claim from the metrics of a run."""
    found = metrics["controllers"]
    tube, plain, compensated = found["tube_mpc"], found["plain_mpc"], found["compensated"]
    return [
        _leaves(found["uncompensated"]),
        _lateral_peaks(found["uncompensated"]),
        _stay_inside(compensated, tube),
        *_smallest_error(found),
        _wheels_rise(found, metrics["reference_wheel_speed_mean_mps"]),
        _acceptable_sets(metrics),
        _terminal_region(metrics),
        _uncertainty(metrics["disturbance"]),
        _advantage(found),
        _tube_role(tube, plain, metrics),
    ]


def table(rows: list[Claim]) -> str:
    """Return the claims as a plain-text table."""
    lines = [f"{'claim':<{CLAIM_WIDTH}}  {'measured':<{MEASURED_WIDTH}}  verdict"]
    lines.append("-" * len(lines[0]))
    for row in rows:
        left = textwrap.wrap(row.claim, CLAIM_WIDTH)
        middle = textwrap.wrap(row.measured, MEASURED_WIDTH)
        for i in range(max(len(left), len(middle))):
            claim, measured = (part[i] if i < len(part) else "" for part in (left, middle))
            lines.append(
                f"{claim:<{CLAIM_WIDTH}}  {measured:<{MEASURED_WIDTH}}  {row.verdict if i == 0 else ''}".rstrip()
            )
    return "\n".join(lines)


def _verdict(share: float) -> str:
    return "reproduced" if share == 1 else "in part" if share > 0 else "not reproduced"


def _leaves(uncompensated: dict) -> Claim:
    share, worst = (
        uncompensated["violation_share_by_coordinate"]["longitudinal_m"],
        uncompensated["max_error"],
    )
    text = (
        f"|e_x| leaves its limit in {share:.1%} of {uncompensated['realisations']} realisations; largest "
        f"{worst['whole_run']['median']['longitudinal_m']:.3f} m (median), "
        f"{worst['whole_run']['worst']['longitudinal_m']:.3f} m (worst)"
    )
    return Claim("without slip compensation |e_x| leaves its limit", text, _verdict(share))


def _lateral_peaks(uncompensated: dict) -> Claim:
    peak = uncompensated["max_error"]["whole_run"]
    median, high, worst = (peak[key]["lateral_m"] for key in ("median", "p95", "worst"))
    text = f"largest |e_y| {median:.3f} m (median), {high:.3f} m (95 %), {worst:.3f} m (worst)"
    verdict = (
        "reproduced"
        if abs(median - 0.25) <= 0.025
        else "in part"
        if median < 0.25 <= worst
        else "not reproduced"
    )
    return Claim("without slip compensation e_y peaks close to 0.25 m", text, verdict)


def _stay_inside(compensated: dict, tube: dict) -> Claim:
    shares = compensated["violation_share"], tube["violation_share"]
    text = f"runs outside E: slip compensation {shares[0]:.1%}, tube MPC {shares[1]:.1%} of {tube['realisations']}"
    return Claim(
        "both compensating controllers stay inside E", text, _verdict(float(max(shares) == 0))
    )


def _smallest_error(found: dict) -> list[Claim]:
    """Compare tube MPC with slip compensation, coordinate by coordinate; the same start is no
    difference."""
    rows = []
    for kind, label in (("max_error", "largest"), ("rms_error", "RMS")):
        for span, when in (("whole_run", "whole run"), ("after_10_s", "after 10 s")):
            wins, losses, parts = 0, 0, []
            for coordinate in COORDINATES:
                tube, other = (
                    found[name][kind][span]["median"][coordinate]
                    for name in ("tube_mpc", "compensated")
                )
                tie = abs(tube - other) <= 1e-9
                wins, losses = (
                    wins + (tube < other and not tie),
                    losses + (tube > other and not tie),
                )
                name, unit = coordinate.rsplit("_", 1)
                parts.append(
                    f"{name} {tube:.4g} {unit} for both"
                    if tie
                    else f"{name} {tube:.4g} vs {other:.4g} {unit}"
                )
            verdict = _verdict(wins / (wins + losses) if wins + losses else 0.0)
            text = f"{'; '.join(parts)} (tube MPC vs slip compensation, medians)"
            rows.append(Claim(f"MPC has the smallest {label} error, {when}", text, verdict))
    return rows


def _wheels_rise(found: dict, reference: float) -> Claim:
    names = ("uncompensated", "compensated", "tube_mpc")
    ratios = {name: found[name]["wheel_speed_mean_mps"] / reference for name in names}
    text = (
        "mean wheel speed / reference: "
        + ", ".join(f"{name} {ratio:.3f}" for name, ratio in ratios.items())
        + "; any loop that keeps up shows it: the one without compensation too, paying with its steady |e_x|"
    )
    rise = min(ratios["compensated"], ratios["tube_mpc"]) > ratios["uncompensated"] > 1
    return Claim("wheel speeds rise to make up for slip", text, _verdict(float(rise)))


def _acceptable_sets(metrics: dict) -> Claim:
    conditions = metrics["certificate"]
    radii = [
        conditions[name]["margin"] for name in ("error_sets_not_empty", "input_sets_not_empty")
    ]
    text = f"smallest inner radius: E_j {radii[0]:.3f}, U_j {radii[1]:.3f}"
    return Claim("the tightened sets have acceptable sizes", text, _verdict(float(min(radii) > 0)))


def _terminal_region(metrics: dict) -> Claim:
    conditions = metrics["certificate"]
    names = ("terminal_set_invariant", "terminal_cost_decrease", "plan_stays_feasible")
    held = [conditions[name]["holds"] for name in names]
    exists = [
        name
        for name in ("trace_s", "trace_p", "logdet")
        if conditions[f"terminal_set_for_{name}"]["holds"]
    ]
    text = (
        f"invariant terminal set: {_yes(held[0])}; cost decreases: {_yes(held[1])}; shifted plan stays feasible: "
        f"{'yes' if held[2] else 'not shown'} (margin {conditions['plan_stays_feasible']['margin']:.3g}). A set exists "
        f"for the LMI objectives {', '.join(exists) or 'none'}; for the section III-B gain: "
        f"{_yes(conditions['invariant_set_for_tube_gain']['holds'])}"
    )
    return Claim(
        "a terminal region makes the MPC stable and recursively feasible",
        text,
        _verdict(sum(held) / 3),
    )


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _uncertainty(disturbance: dict) -> Claim:
    share = disturbance["share_of_steps_outside"]
    text = (
        f"w lies outside W in {share:.1%} of {disturbance['steps']} steps; largest heading residual "
        f"{disturbance['largest']['heading_deg']:.2f} deg, W allows {disturbance['allowed']['heading_deg']:.2f} deg"
    )
    return Claim(
        "W covers linearisation, slip measurement and pose errors",
        text,
        _verdict(float(share == 0)),
    )


def _advantage(found: dict) -> Claim:
    rms = {
        name: found[name]["rms_error"]["whole_run"]["median"]["lateral_m"]
        for name in ("compensated", "local_gain", "equal_gain", "plain_mpc", "tube_mpc")
    }
    text = "lateral RMS, median: " + ", ".join(
        f"{name} {value:.4f} m" for name, value in rms.items()
    )
    same = abs(rms["equal_gain"] - rms["tube_mpc"]) <= 1e-9
    if same:
        text += "; no row was active: a gain scheduled on the preview, computed beforehand, is the same controller"
    return Claim(
        "the advantage comes from prediction and from the uncertainty in the control law",
        text,
        "in part"
        if rms["tube_mpc"] < min(rms["compensated"], rms["local_gain"])
        else "not reproduced",
    )


def _tube_role(tube: dict, plain: dict, metrics: dict) -> Claim:
    stress = metrics["stress"]["linear_w_in_W"]
    with_tube, without = stress["tube_mpc"], stress["plain_mpc"]
    of_model = [
        entry for entry in metrics["stress_certificate"].values() if entry["scope"] == "model"
    ]
    proved = all(entry["holds"] for entry in of_model)
    text = (
        f"on the lap rows are active in {tube['active_share']:.2%} of steps (without {plain['active_share']:.2%}). "
        f"Design `robust`, linear plant, w in W: {with_tube['runs_outside_E']} of "
        f"{with_tube['runs']} runs leave E with the tube, {without['runs_outside_E']} without; its conditions on the "
        f"model {'all hold' if proved else 'do not all hold'}"
    )
    kept = proved and with_tube["runs_outside_E"] == 0 and with_tube["runs_with_infeasible_QP"] == 0
    own = metrics["certificate"]["plan_stays_feasible"]["holds"]
    verdict = "not reproduced" if not kept else "reproduced" if own else "in part"
    return Claim("the tube keeps the constraints under every w in W", text, verdict)
