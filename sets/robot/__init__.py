"""Sets of a wheeled robot that slips: the disturbance its linear model leaves out, and tubes
re-checked exactly.

    plant         the disturbance that the sampled robot adds to its model, split by cause
    disturbance   W, which holds every disturbance over an operating set
    exact_tube    loops under decoupled gains and tubes along a schedule, in rational arithmetic
"""

from sets.robot.disturbance import (
    DisturbanceBound,
    Operation,
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
from sets.robot.plant import Kinematics, Parts, Period, plane_rows, split_disturbance

__all__ = [
    "DisturbanceBound",
    "Kinematics",
    "Operation",
    "Parts",
    "Period",
    "ScheduleBox",
    "UsedOffsets",
    "disturbance_bound",
    "disturbance_parts",
    "evaluate_disturbance",
    "exact_vertex_feedbacks",
    "exact_vertex_loops",
    "exact_wheel_loops",
    "plane_rows",
    "schedule_box",
    "sequence_margins",
    "split_disturbance",
    "wheel_error_bound",
    "wheel_error_range",
]
