"""Semidefinite programs whose constraints are written in matrices, solved by Clarabel.

    minimise  c^T x  subject to  F_0 + sum_j x_j F_j >= 0  for every constraint F

An affine matrix expression in the unknowns x in R^k is an array of shape (1 + k, p, q): F_0, then
F_1 to F_k. Its algebra is numpy's: F + G; C @ F and F @ C with constant C; transposed, the last two
axes swapped. `lift` makes a constant such an expression, which `block_matrix` does on its own.

Clarabel asks for the upper triangle, column by column, with sqrt(2) times what is off the diagonal:
inner products of such vectors are those of the matrices, so multipliers come in the same form.

Source: Goulart, Chen, arXiv 2405.12762 (Clarabel); Ben-Tal, Nemirovski, Lectures on Modern Convex
Optimization 2001, section 4.2 (determinants in semidefinite programs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_matrix

Affine = Float[np.ndarray, "1+k p q"]

SOLVED = "Solved"
ALMOST_SOLVED = "AlmostSolved"
INFEASIBLE = "PrimalInfeasible"


@dataclass(frozen=True)
class Answer:
    """What Clarabel answers.

    Attributes:
        status: in its words, such as `SOLVED`.
        x: the unknowns.
        multipliers: one matrix Z >= 0 a constraint.
    """

    status: str
    x: Float[np.ndarray, " k"]
    multipliers: list[Float[np.ndarray, "p p"]]


def make_unknowns(*bases: Float[np.ndarray, "k_j p_j q_j"]) -> list[Affine]:
    """Return an expression for each basis, sum_j x_j basis_j, each with unknowns of its own."""
    ends = np.cumsum([1, *map(len, bases)])
    expressions = []
    for start, basis in zip(ends, bases, strict=False):
        expression = np.zeros((ends[-1], *basis.shape[1:]))
        expression[start : start + len(basis)] = basis
        expressions.append(expression)
    return expressions


def symmetric_basis(n: int) -> Float[np.ndarray, "k n n"]:
    """Return a basis of the symmetric matrices, upper triangle column by column."""
    upper = triangular_basis(n)
    return np.maximum(upper, np.swapaxes(upper, 1, 2))


def triangular_basis(n: int) -> Float[np.ndarray, "k n n"]:
    """Return a basis of the upper triangular matrices, column by column."""
    columns, rows = np.tril_indices(n)
    return full_basis(n, n)[n * columns + rows]


def full_basis(p: int, q: int) -> Float[np.ndarray, "p*q p q"]:
    """Return a basis of all matrices, column by column."""
    return np.swapaxes(np.eye(p * q).reshape(p * q, q, p), 1, 2)


def trace(expression: Affine) -> Float[np.ndarray, "1+k"]:
    """Return the trace of an expression, an affine number."""
    return np.trace(expression, axis1=1, axis2=2)


def block_matrix(rows: Sequence[Sequence[np.ndarray]]) -> Affine:
    """Return the expression that is made of blocks, expressions or constants; one of them at least
    is an expression."""
    count = max(len(block) - 1 for row in rows for block in row if block.ndim == 3)
    return np.block([[lift(block, count) for block in row] for row in rows])


def lift(block: np.ndarray, count: int) -> Affine:
    """Return a constant as an expression in `count` unknowns; an expression as it is."""
    if block.ndim == 3:
        return block
    return np.concatenate([block[None], np.zeros((count, *block.shape))])


def evaluate(expression: Affine, x: Float[np.ndarray, " k"]) -> Float[np.ndarray, "p q"]:
    """Return the matrix that an expression is at x."""
    return expression[0] + np.tensordot(x, expression[1:], axes=1)


def minimise(
    objective: Float[np.ndarray, "1+k"],
    constraints: Sequence[Affine],
    exponential: Float[np.ndarray, "1+k l 3"] | None = None,
    **settings: Any,
) -> Answer:
    """Minimise an affine number where symmetric expressions are >= 0.

    Args:
        objective: what to minimise; its constant is of no account.
        constraints: symmetric expressions.
        exponential: rows (a, b, c) that are asked for b exp(a / b) <= c and b > 0.
        settings: those of Clarabel that are not its defaults, by their names.
    """
    solve: Any = clarabel  # its stubs name none of these
    rows = [_stack_triangle(constraint) for constraint in constraints]
    cones = [solve.PSDTriangleConeT(constraint.shape[1]) for constraint in constraints]
    if exponential is not None:
        rows.append(exponential.reshape(len(exponential), -1))
        cones += [solve.ExponentialConeT()] * exponential.shape[1]
    asked = np.concatenate(rows, axis=1)
    chosen = solve.DefaultSettings()
    for name, value in ({"verbose": False} | settings).items():
        setattr(chosen, name, value)
    count = len(objective) - 1
    no_squares = csc_matrix((count, count))
    # Clarabel's cones hold  b - A x.
    program = (no_squares, objective[1:], csc_matrix(-asked[1:].T), asked[0], cones, chosen)
    answer = solve.DefaultSolver(*program).solve()
    ends = np.cumsum([row.shape[1] for row in rows])
    pieces = np.split(np.array(answer.z), ends)[: len(constraints)]
    return Answer(str(answer.status), np.array(answer.x), [_unstack(piece) for piece in pieces])


def _stack_triangle(expression: Affine) -> Float[np.ndarray, "1+k t"]:
    """Return the upper triangle as Clarabel asks for it."""
    columns, rows = np.tril_indices(expression.shape[1])
    return expression[:, rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))


def _unstack(stacked: Float[np.ndarray, " t"]) -> Float[np.ndarray, "p p"]:
    """Return the symmetric matrix of a stacked triangle."""
    n = round((np.sqrt(8 * len(stacked) + 1) - 1) / 2)
    columns, rows = np.tril_indices(n)
    matrix = np.zeros((n, n))
    matrix[rows, columns] = stacked / np.where(rows == columns, 1.0, np.sqrt(2.0))
    return np.triu(matrix) + np.triu(matrix, 1).T
