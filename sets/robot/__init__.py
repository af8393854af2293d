"""Sets of a wheeled robot that slips: the disturbance its linear model leaves out, and tubes
re-checked exactly.

    plant         the disturbance that the sampled robot adds to its model, split by cause
    operation     where the robot works
    actuation, committed, driving, latency
                  wheels that lag and commands that come late: what they add to it
    disturbance   W, which holds every disturbance over an operating set
    observer      S, which holds every error of an estimate that filters the measured error
    exact_tube    loops under decoupled gains and tubes along a schedule, in rational arithmetic
"""

from sets.robot.actuation import Actuation
from sets.robot.disturbance import (
    DisturbanceBound,
    disturbance_bound,
    disturbance_parts,
    evaluate_disturbance,
    wheel_error_bound,
    wheel_error_range,
)
from sets.robot.exact_tube import (
    ScheduleBox,
    UsedOffsets,
    exact_vertex_feedbacks,
    exact_vertex_loops,
    exact_wheel_loops,
    schedule_box,
    sequence_margins,
)
from sets.robot.observer import bound_next_error, find_estimate_error
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics, Parts, Period, plane_rows, split_disturbance

__all__ = [
    "Actuation",
    "DisturbanceBound",
    "Kinematics",
    "Operation",
    "Parts",
    "Period",
    "ScheduleBox",
    "UsedOffsets",
    "bound_next_error",
    "disturbance_bound",
    "disturbance_parts",
    "evaluate_disturbance",
    "exact_vertex_feedbacks",
    "exact_vertex_loops",
    "exact_wheel_loops",
    "find_estimate_error",
    "plane_rows",
    "schedule_box",
    "sequence_margins",
    "split_disturbance",
    "wheel_error_bound",
    "wheel_error_range",
]
