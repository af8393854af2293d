"""Batched strictly convex quadratic programs: `solve` and what it takes and returns; each method
has its own module."""

from jaxtube.qp.factors import Factors, factorise
from jaxtube.qp.fixed_point import TOLERANCE, bound_tolerance
from jaxtube.qp.solver import Solution, solve
from jaxtube.qp.status import INFEASIBLE, SOLVED, UNSOLVED, describe, describe_unsolved

__all__ = [
    "INFEASIBLE",
    "SOLVED",
    "TOLERANCE",
    "UNSOLVED",
    "Factors",
    "Solution",
    "bound_tolerance",
    "describe",
    "describe_unsolved",
    "factorise",
    "solve",
]
