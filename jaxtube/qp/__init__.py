"""Batched strictly convex quadratic programs: `solve` and what it takes and returns; the methods
are the modules."""

from jaxtube.qp.solver import (
    INFEASIBLE,
    SOLVED,
    STATUS_TEXT,
    TOLERANCE,
    UNSOLVED,
    Factors,
    Solution,
    factorise,
    solve,
)

__all__ = [
    "INFEASIBLE",
    "SOLVED",
    "STATUS_TEXT",
    "TOLERANCE",
    "UNSOLVED",
    "Factors",
    "Solution",
    "factorise",
    "solve",
]
