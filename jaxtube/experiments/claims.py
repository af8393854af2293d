"""The paper's claims, each with what was measured and whether it was reproduced.

Source of the claims: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III and IV.
"""

from __future__ import annotations

import textwrap
from typing import NamedTuple

from jaxtube.experiments.metrics import COORDINATES

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
        _wheels_rise(compensated, tube, metrics["reference_wheel_speed_mean_mps"]),
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
    share, worst = uncompensated["violation_share"], uncompensated["max_error"]["whole_run"]
    text = (
        f"leaves E in {share:.1%} of {uncompensated['realisations']} realisations; largest |e_x| "
        f"{worst['median']['longitudinal_m']:.3f} m (median), {worst['worst']['longitudinal_m']:.3f} m (worst)"
    )
    return Claim("without slip compensation |e_x| leaves 0.3 m", text, _verdict(share))


def _lateral_peaks(uncompensated: dict) -> Claim:
    peak = uncompensated["max_error"]["whole_run"]
    median, worst = (peak[key]["lateral_m"] for key in ("median", "worst"))
    text = f"largest |e_y| {median:.3f} m (median), {worst:.3f} m (worst)"
    near = abs(median - 0.25) <= 0.025
    return Claim(
        "without slip compensation e_y peaks close to 0.25 m",
        text,
        "reproduced" if near else "in part" if worst >= 0.225 else "not reproduced",
    )


def _stay_inside(compensated: dict, tube: dict) -> Claim:
    shares = compensated["violation_share"], tube["violation_share"]
    text = f"runs outside E: slip compensation {shares[0]:.1%}, tube MPC {shares[1]:.1%} of {tube['realisations']}"
    return Claim("both compensating controllers stay inside E", text, _verdict(float(max(shares) == 0)))


def _smallest_error(found: dict) -> list[Claim]:
    rows = []
    for kind, label in (("max_error", "largest"), ("rms_error", "RMS")):
        for span in ("whole_run", "after_10_s"):
            wins, parts = 0, []
            for coordinate in COORDINATES:
                values = {name: found[name][kind][span]["median"][coordinate] for name in ("compensated", "tube_mpc")}
                # The same start gives both the same peak: not a difference.
                tie = abs(values["tube_mpc"] - values["compensated"]) <= 1e-9
                wins += tie or values["tube_mpc"] < values["compensated"]
                name, unit = coordinate.rsplit("_", 1)
                parts.append(f"{name} {values['tube_mpc']:.4g} against {values['compensated']:.4g} {unit}")
            text = f"{'; '.join(parts)} (medians)"
            when = "whole run" if span == "whole_run" else "after 10 s"
            rows.append(
                Claim(f"MPC has the smallest {label} error ({when}; against slip comp.)", text, _verdict(wins / 3))
            )
    return rows


def _wheels_rise(compensated: dict, tube: dict, reference: float) -> Claim:
    ratios = [controller["wheel_speed_mean_mps"] / reference for controller in (compensated, tube)]
    text = f"mean wheel speed / reference: slip compensation {ratios[0]:.3f}, tube MPC {ratios[1]:.3f} (1/0.8 = 1.25)"
    return Claim("wheel speeds rise to make up for slip", text, _verdict(float(min(ratios) > 1.2)))


def _acceptable_sets(metrics: dict) -> Claim:
    conditions = metrics["certificate"]
    radii = [conditions[name]["margin"] for name in ("error_sets_not_empty", "input_sets_not_empty")]
    text = f"smallest inner radius: E_j {radii[0]:.3f}, U_j {radii[1]:.3f}"
    return Claim("the tightened sets have acceptable sizes", text, _verdict(float(min(radii) > 0)))


def _terminal_region(metrics: dict) -> Claim:
    conditions = metrics["certificate"]
    exists = {name: conditions[f"terminal_set_for_{name}"]["holds"] for name in ("trace_s", "trace_p", "logdet")}
    recursive = conditions["plan_stays_feasible"]
    text = (
        "an invariant set exists for the LMI gains of: "
        + (", ".join(name for name, holds in exists.items() if holds) or "none")
        + f"; for the section III-B gain: {'yes' if conditions['invariant_set_for_tube_gain']['holds'] else 'no'}; "
        + f"shifted plan stays feasible: {'yes' if recursive['holds'] else 'no'} (margin {recursive['margin']:.3g})"
    )
    share = (any(exists.values()) + recursive["holds"]) / 2
    return Claim("a terminal region makes the MPC stable and recursively feasible", text, _verdict(share))


def _uncertainty(disturbance: dict) -> Claim:
    share = disturbance["share_of_steps_outside"]
    text = (
        f"w lies outside W in {share:.1%} of {disturbance['steps']} steps; largest heading residual "
        f"{disturbance['largest']['heading_deg']:.2f} deg against 0.2 deg"
    )
    return Claim("W covers linearisation, slip measurement and pose errors", text, _verdict(float(share == 0)))


def _advantage(found: dict) -> Claim:
    rms = {
        name: found[name]["rms_error"]["whole_run"]["median"]["lateral_m"]
        for name in ("compensated", "local_gain", "equal_gain", "plain_mpc", "tube_mpc")
    }
    text = "lateral RMS, median: " + ", ".join(f"{name} {value:.4f} m" for name, value in rms.items())
    same = abs(rms["equal_gain"] - rms["tube_mpc"]) <= 1e-9
    return Claim(
        "the advantage comes from prediction and from the uncertainty in the control law",
        text + ("; the static law with the MPC's own gain does the same: the advantage is gain alone" if same else ""),
        "not reproduced" if same else "in part",
    )


def _tube_role(tube: dict, plain: dict, metrics: dict) -> Claim:
    stress = metrics["stress"]["linear_w_in_W"]
    with_tube, without = stress["tube_mpc"], stress["plain_mpc"]
    text = (
        f"on this lap: rows active in {tube['active_share']:.2%} of steps (without tube {plain['active_share']:.2%}); "
        f"from all over the feasible set, w in W (design `robust`): {with_tube['runs_outside_E']} of "
        f"{with_tube['runs']} runs leave E with the tube, {without['runs_outside_E']} without"
    )
    kept = with_tube["runs_outside_E"] == 0 and with_tube["runs_with_infeasible_QP"] == 0
    return Claim("the tube keeps the constraints under every w in W", text, _verdict(float(kept)))
