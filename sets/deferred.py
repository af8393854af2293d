"""Numbers that are computed when they are asked for, each of them once.

A formula that returns many parts costs what the parts read cost, and what it writes twice is
computed once: operations on deferred numbers only note what they would do, under the operation and
its operands. Deferred are numbers of any kind, such as those of `sets.interval`.

Source: hash-consing: Ershov 1958, "On programming of arithmetic operations", CACM 1(8).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

Table = dict[tuple, "Deferred"]


class Deferred:
    """A number by the operation and the operands that make it."""

    __slots__ = ("_known", "_operands", "_operation", "_table")
    __array_ufunc__ = None  # an array on the left leaves the operation to this class

    def __init__(self, table: Table, operation: Callable[..., Any], operands: tuple):
        self._table = table
        self._operation = operation
        self._operands = operands
        self._known: Any = None

    @property
    def number(self) -> Any:
        """The number itself."""
        if self._known is None:
            self._known = self._operation(*[force(operand) for operand in self._operands])
        return self._known

    def apply(self, operation: Callable[..., Any], *operands: Any) -> Deferred:
        """Return what an operation makes of the number and of others behind it."""
        return _note(self._table, operation, (self, *operands))

    def __neg__(self) -> Deferred:
        return self.apply(operator.neg)

    def __add__(self, other) -> Deferred:
        return self.apply(operator.add, other)

    def __sub__(self, other) -> Deferred:
        return self.apply(operator.sub, other)

    def __mul__(self, other) -> Deferred:
        return self.apply(operator.mul, other)

    def __truediv__(self, other) -> Deferred:
        return self.apply(operator.truediv, other)

    def __radd__(self, other) -> Deferred:
        return _note(self._table, operator.add, (other, self))

    def __rsub__(self, other) -> Deferred:
        return _note(self._table, operator.sub, (other, self))

    def __rmul__(self, other) -> Deferred:
        return _note(self._table, operator.mul, (other, self))

    def __rtruediv__(self, other) -> Deferred:
        return _note(self._table, operator.truediv, (other, self))


def defer(numbers: Sequence) -> list[Deferred]:
    """Return numbers whose results are deferred."""
    table: Table = {}
    return [_note(table, _return_it, (number,)) for number in numbers]


def force(number: Any) -> Any:
    """Return a number, deferred or not, itself."""
    return number.number if isinstance(number, Deferred) else number


def _note(table: Table, operation: Callable[..., Any], operands: tuple) -> Deferred:
    """Return the number that an operation makes of its operands: the one that is noted already
    where there is one, for floats that are equal are one operand."""
    key = (operation, *operands)
    if key not in table:
        table[key] = Deferred(table, operation, operands)
    return table[key]


def _return_it(number: Any) -> Any:
    return number
