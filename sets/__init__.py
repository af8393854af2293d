"""Sets of robust control: polytopes, tubes, invariant sets, terminal costs and their certificates.

    polytope            Polytope and what reduces to support numbers
    tubes               reach of a disturbance along schedules
    invariant           maximal and minimal robust positively invariant sets
    few_facets          robust positively invariant sets of few facets
    control_invariant   maximal robust control invariant sets
    lmi, lyapunov       terminal costs, with gains or for given ones; gap, how good they are
    semidefinite        semidefinite programs, written in matrices
    riccati             linear-quadratic regulator
    certificate         margins of every condition in floats; exact, in rational arithmetic
    interval, supremum  rigorous bounds of functions over boxes
    robot               what a wheeled robot that slips adds: `sets.robot`

Needs numpy, scipy, clarabel and highspy alone.
"""

from sets.certificate import (
    Certificate,
    Condition,
    decrease_margin,
    escape_excess,
    invariance_margin,
    judge,
    nonempty_margin,
    reach_supports,
    sequence_reach,
    terminal_margins,
)
from sets.control_invariant import ControlInvariant, Limits, maximal_rci, predecessor
from sets.exact import (
    ExactReport,
    Halfspaces,
    decrease_pivot,
    exact_containment_margin,
    exact_invariance_margin,
    exact_row,
    exact_rows,
    mapped_rows,
    smallest_pivot,
)
from sets.few_facets import few_facet_rpi
from sets.gap import optimality_gap
from sets.interval import Dual, Interval
from sets.invariant import Escape, MaximalRpi, maximal_rpi, minimal_rpi_bound
from sets.lmi import TerminalCost, decrease_margins, terminal_cost
from sets.lyapunov import cost_of_gains, stage_cost
from sets.polytope import (
    ConvexSet,
    HasSupport,
    Polytope,
    SupportFunction,
    convex_hull,
    hull_vertices,
    support_function,
)
from sets.riccati import lqr_gain
from sets.supremum import suprema
from sets.tubes import (
    Section,
    hull_tube,
    input_support,
    paper_tube,
    propagate,
    sequence_support,
    sequence_tube,
    summed_tube,
)

__all__ = [
    "Certificate",
    "Condition",
    "ControlInvariant",
    "ConvexSet",
    "Dual",
    "Escape",
    "ExactReport",
    "Halfspaces",
    "HasSupport",
    "Interval",
    "Limits",
    "MaximalRpi",
    "Polytope",
    "Section",
    "SupportFunction",
    "TerminalCost",
    "convex_hull",
    "cost_of_gains",
    "decrease_margin",
    "decrease_margins",
    "decrease_pivot",
    "escape_excess",
    "exact_containment_margin",
    "exact_invariance_margin",
    "exact_row",
    "exact_rows",
    "few_facet_rpi",
    "hull_tube",
    "hull_vertices",
    "input_support",
    "invariance_margin",
    "judge",
    "lqr_gain",
    "mapped_rows",
    "maximal_rci",
    "maximal_rpi",
    "minimal_rpi_bound",
    "nonempty_margin",
    "optimality_gap",
    "paper_tube",
    "predecessor",
    "propagate",
    "reach_supports",
    "sequence_reach",
    "sequence_support",
    "sequence_tube",
    "smallest_pivot",
    "stage_cost",
    "summed_tube",
    "support_function",
    "suprema",
    "terminal_cost",
    "terminal_margins",
]
