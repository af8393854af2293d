"""The tables of `paper`: controllers side by side, the scheme with the other restart, runs under
stress."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from jaxtube import qp
from jaxtube.coordinates import COORDINATES, KEYS
from jaxtube.experiments.paper import stress
from jaxtube.experiments.paper.claims import PaperClaim
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.synthesis.parts import Design


def say_verdict(rows: Sequence[PaperClaim], design: Design) -> str:
    """Return one line: how many claims of the paper were reproduced, and whether its design is
    certified."""
    counts = Counter(row.verdict for row in rows)
    certified = "CERTIFIED" if design.certificate.holds_for_robot else "NOT CERTIFIED"
    return (
        f"{counts['reproduced']} of the paper's {len(rows)} claims are reproduced, "
        f"{counts['in part']} in part, {counts['not reproduced']} not; the design is {certified}"
    )


def comparison(measured: dict) -> str:
    """Return the controllers side by side: medians over realisations."""
    controllers = measured["controllers"].items()
    errors = [left("controller"), *_error_columns("largest"), *_error_columns("RMS")]
    uses = [
        left("controller"),
        Column("outside E"),
        Column("active"),
        Column("wheel", "m/s"),
    ]
    inside = measured["plan_deviations"]
    shares = ", ".join(f"{share:.1%}" for share in inside["share_outside_by_stage"])
    lines = [
        format_table(errors, [_list_errors(name, numbers) for name, numbers in controllers]),
        "",
        format_table(uses, [_list_uses(name, numbers) for name, numbers in controllers]),
        "outside E: share of the runs that leave the error constraints; largest, RMS: medians over "
        "the runs;\nactive: share of the steps in which a constraint of the plan is active; "
        "wheel: largest wheel speed\n"
        f"of {inside['plans']} plans followed to their end these shares leave R_1, R_2, ..: "
        f"{shares}",
    ]
    for name, numbers in measured["controllers"].items():
        lines += [f"{name}: {line}" for line in _describe_unsolved(numbers["qp_status"])]
    return "\n".join(lines)


def _describe_unsolved(counts: dict[str, int]) -> list[str]:
    """Return a line for each kind of QP without a solution that occurred."""
    statuses = {"infeasible": qp.INFEASIBLE, "unsolved": qp.UNSOLVED}
    return qp.describe_unsolved({status: counts[name] for name, status in statuses.items()})


def _error_columns(kind: str) -> list[Column]:
    return [Column(f"{kind}\n{coordinate.symbol}", coordinate.unit) for coordinate in COORDINATES]


def _list_errors(name: str, numbers: dict) -> list[str]:
    """Return the errors of one controller."""
    largest = numbers["max_error"]["whole_run"]["median"]
    rms = numbers["rms_error"]["whole_run"]["median"]
    return [
        name,
        *(f"{largest[key]:.5f}" for key in KEYS),
        *(f"{rms[key]:.5f}" for key in KEYS),
    ]


def _list_uses(name: str, numbers: dict) -> list[str]:
    """Return how a controller uses its limits."""
    return [
        name,
        f"{numbers['violation_share']:.1%}",
        f"{numbers['active_share']:.2%}",
        f"{numbers['wheel_speed_max_mps']:.3f}",
    ]


def stress_table(measured: dict) -> str:
    """Return the runs of the design under stress, with and without tube."""
    columns = [
        left("plant"),
        left("controller"),
        Column("runs"),
        Column("outside E"),
        Column("infeasible\nQPs"),
        Column("recovered"),
        Column("every w\nin W"),
        Column("of these\noutside E"),
    ]
    rows = []
    counts = {"infeasible": 0, "unsolved": 0}
    for case, by_controller in measured["stress"].items():
        for name, numbers in by_controller.items():
            rows.append(_stress_row(stress.CASES[case], name, numbers))
            for kind in counts:
                counts[kind] += numbers[f"{kind}_QPs"]
    lines = [
        f"under stress: design `{measured['stress_design']}`, starts all over the feasible set of "
        "its tube-MPC",
        format_table(columns, rows),
        "outside E, every w in W: counts of runs; recovered: of the runs that had no plan at some "
        "step, those\nthat had one at the last step",
        *_describe_unsolved(counts),
    ]
    return "\n".join(lines)


def _stress_row(case: str, controller: str, numbers: dict) -> list[str]:
    """Return the row of one controller in one case."""
    return [
        case,
        controller,
        str(numbers["runs"]),
        str(numbers["runs_outside_E"]),
        str(numbers["infeasible_QPs"]),
        f"{numbers['runs_recovered']} of {numbers['runs_with_infeasible_QP']}",
        str(numbers["runs_with_every_w_in_W"]),
        str(numbers["runs_outside_E_with_every_w_in_W"]),
    ]


def restart_note(measured: dict) -> str:
    """Return one line on the scheme that resets its nominal error where the scenario's does not."""
    other = measured["other_restart"]
    usual = measured["controllers"]["tube_mpc"]
    restart = str(other["restart"]).lower()
    return (
        f"with restart = {restart}: lateral RMS {_lateral_rms(other):.5f} m against "
        f"{_lateral_rms(usual):.5f} m, outside E {other['violation_share']:.1%}, QPs infeasible "
        f"{other['qp_status']['infeasible']}"
    )


def _lateral_rms(numbers: dict) -> float:
    return numbers["rms_error"]["whole_run"]["median"]["lateral_m"]
