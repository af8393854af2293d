"""The tolerances that more than one file of tests uses; a tolerance of one file stands in it."""

ROUNDING = 1e-13
"""A handful of float64 operations on numbers of order one."""
EXACT_ARCS = 1e-9
"""Closed-form arcs against an integrator run at 1e-12."""
PAPER_GAIN = 1e-6
"""Gains are quoted to six digits."""
LEAST_P_VALUE = 1e-4
"""Of a Kolmogorov-Smirnov test with a fixed seed."""
RICCATI_GAIN = 1e-4
"""Relative; the cost is flat around its best gain, so gains are known less well."""
SET_RELATIVE = 1e-11
"""Support numbers, vertices and volumes of polytopes, relative to the size of the set."""
CLOSED_LOOP = 1e-12
"""Float64 sums in another order, over one step or over a batch of other size."""
WORLD_FRAME = 1e-8
"""300 steps against an integrator run at 1e-12."""
KKT = 1e-8
"""Residual of the optimality conditions at which a quadratic program counts as solved."""
LINEAR_PROGRAM = 1e-6
"""Answers of a linear program, whose own tolerance is 1e-7."""
INSIDE_TUBE = -1e-12
"""Least facet margin of a deviation or disturbance."""
TUBE_ROUNDING = 1e-12
"""Support numbers of the sections of a tube, sums in another order."""
CERTIFICATE_MARGIN = 1e-9
"""Support numbers of polytopes against their vertices."""
DRAWN = 1e-9
"""A drawn number against its source: a change of units."""
COUNTED = 1e-12
"""A point further beyond a facet counts as outside."""
EXACT_AGAINST_FLOAT = 1e-9
"""Exact bounds against linear programs and vertices in float64."""
RESIDUAL_ROUNDING = 1e-12
"""In m and rad; residuals against differences of numbers of order one."""
SCALED_COST = 1e-9
"""Relative; the same cost found with other weights."""
OBJECTIVE_SLOPE = 1e-6
"""Relative; central differences of fourth order, the host's parts solved again."""
QP_ORACLE = 1e-9
"""Feasibility asked of the exact solver."""
QP_ANSWER = 1e-6
QP_ROUNDING = 1e-11
QP_SHARE_FLOAT32 = 0.9
QP_ANSWER_FLOAT32 = 1e-4
FALSIFY_REPLAY = 1e-9
"""In m and rad; laps that are played again."""
