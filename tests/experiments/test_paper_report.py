"""The tables of `paper` say in words which QPs had no solution, and nothing where all had one."""

import pytest

from jaxtube import qp
from jaxtube.coordinates import KEYS
from jaxtube.experiments.paper.report import comparison, stress_table

INFEASIBLE = qp.describe(qp.INFEASIBLE)
UNSOLVED = qp.describe(qp.UNSOLVED)


def make_controller(infeasible, unsolved):
    spread = {"whole_run": {"median": dict.fromkeys(KEYS, 0.1)}}
    return {
        "violation_share": 0.0,
        "max_error": spread,
        "rms_error": spread,
        "active_share": 0.0,
        "wheel_speed_max_mps": 1.0,
        "qp_status": {"solved": 9, "infeasible": infeasible, "unsolved": unsolved},
    }


@pytest.mark.parametrize(
    ("infeasible", "unsolved", "lines"),
    [
        (0, 0, []),
        (3, 0, [f"tube_mpc: 3 QPs {INFEASIBLE}"]),
        (2, 1, [f"tube_mpc: 2 QPs {INFEASIBLE}", f"tube_mpc: 1 QP {UNSOLVED}"]),
    ],
)
def test_the_comparison_says_which_qps_had_no_solution(infeasible, unsolved, lines):
    measured = {
        "controllers": {
            "local_gain": make_controller(0, 0),
            "tube_mpc": make_controller(infeasible, unsolved),
        },
        "plan_deviations": {"share_outside_by_stage": [0.0], "plans": 5},
    }
    text = comparison(measured)
    assert [line for line in text.splitlines() if " QP" in line] == lines


def test_the_table_of_stress_adds_them_up_over_its_cases():
    counts = {
        "runs": 4,
        "runs_outside_E": 0,
        "infeasible_QPs": 2,
        "unsolved_QPs": 0,
        "runs_recovered": 1,
        "runs_with_infeasible_QP": 1,
        "runs_with_every_w_in_W": 4,
        "runs_outside_E_with_every_w_in_W": 0,
    }
    by_controller = {"tube_mpc": counts, "plain_mpc": counts}
    text = stress_table({"stress": {"linear_w_in_W": by_controller}, "stress_design": "robust"})
    assert text.splitlines()[-1] == f"4 QPs {INFEASIBLE}"
