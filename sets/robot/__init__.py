"""Sets of a wheeled robot that slips: the disturbance its linear model leaves out, and tubes
re-checked exactly.

    plant         the sampled robot's residual, split by cause
    disturbance   W, which holds every residual over an operating set
    exact_tube    loops under decoupled gains and tubes along a schedule, in rational arithmetic
"""

from sets.robot.disturbance import (
    DisturbanceBound,
    Operation,
    disturbance_bound,
    disturbance_parts,
    model_residual,
    wheel_error_bound,
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
from sets.robot.plant import Kinematics, Parts, Period, plane_rows, split_residual

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
    "exact_vertex_feedbacks",
    "exact_vertex_loops",
    "exact_wheel_loops",
    "model_residual",
    "plane_rows",
    "schedule_box",
    "sequence_margins",
    "split_residual",
    "wheel_error_bound",
]
