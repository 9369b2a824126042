"""Expressions of formula distributions, evaluated without executing code."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["FUNCTIONS", "Expression"]

FUNCTIONS: dict[str, Callable[..., float]] = {
    "abs": abs,
    "ceil": math.ceil,
    "cos": math.cos,
    "degrees": math.degrees,
    "exp": math.exp,
    "floor": math.floor,
    "hypot": math.hypot,
    "log": math.log,
    "log10": math.log10,
    "max": max,
    "min": min,
    "radians": math.radians,
    "round": round,
    "sin": math.sin,
    "sqrt": math.sqrt,
    "tan": math.tan,
}
"""Functions available in formulas; angles are in radians."""
_CONSTANTS = {"pi": math.pi, "e": math.e}
_BINARY: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.AST], Callable[[Any], Any]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}
_COMPARISONS: dict[type[ast.AST], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_LONGEST, _DEEPEST = 1000, 50


class Expression:
    """A formula of named values.

    ``text``: The formula.

    >>> Expression("2 * a if a > 1 else sqrt(a)").value({"a": 0.25})
    0.5
    >>> Expression("__import__('os')")
    Traceback (most recent call last):
    ValueError: '__import__' is no function of formulas; these are: abs, ceil, cos, degrees, exp, floor, hypot, ...
    """

    def __init__(self, text: str) -> None:
        self.text = text.strip()
        if len(self.text) > _LONGEST:
            msg = f"has more than {_LONGEST} characters"
            raise ValueError(msg)
        try:
            self._tree = ast.parse(self.text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            msg = f"cannot be read as a formula: {getattr(error, 'msg', error)}"
            raise ValueError(msg) from error
        self._names: set[str] = set()
        self._refuse(self._tree, 0)

    @property
    def names(self) -> frozenset[str]:
        """Names of the values in the formula."""
        return frozenset(self._names)

    def value(self, values: Mapping[str, Any]) -> float:
        """Return the result, a finite number."""
        wrong = [name for name in sorted(self._names) if not _is_number(values.get(name))]
        if wrong:
            msg = f"'{wrong[0]}' is not a number (got {values.get(wrong[0])!r})"
            raise ValueError(msg)
        try:
            found = self._of(self._tree, values)
        except (ArithmeticError, ValueError, TypeError) as error:
            msg = f"'{self.text}' has no value: {error}"
            raise ValueError(msg) from error
        if not _is_number(found) or not math.isfinite(found):
            msg = f"'{self.text}' is not a finite number: {found!r}"
            raise ValueError(msg)
        return float(found) if isinstance(found, float) else int(found)

    def _refuse(self, node: ast.AST, depth: int) -> None:
        if depth > _DEEPEST:
            msg = f"is nested more than {_DEEPEST} deep"
            raise ValueError(msg)
        match node:
            case ast.Constant(value=value) if _is_number(value):
                return
            case ast.Name(id=name):
                if name not in _CONSTANTS:
                    self._names.add(name)
                return
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                if name not in FUNCTIONS:
                    known = ", ".join(FUNCTIONS)
                    msg = f"'{name}' is no function of formulas; these are: {known}"
                    raise ValueError(msg)
                parts: list[ast.AST] = list(node.args)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                parts = [left, right]
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
                parts = [operand]
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                parts = [left, right]
            case ast.IfExp(test=test, body=body, orelse=orelse):
                parts = [test, body, orelse]
            case _:
                msg = f"'{ast.unparse(node)}' is not arithmetic"
                raise ValueError(msg)
        for part in parts:
            self._refuse(part, depth + 1)

    def _of(self, node: ast.AST, values: Mapping[str, Any]) -> Any:
        match node:
            case ast.Constant(value=value):
                # Powers of integers could grow without limit.
                return float(value) if isinstance(value, int) and abs(value) > _LARGEST else value
            case ast.Name(id=name):
                return _CONSTANTS[name] if name in _CONSTANTS else values[name]
            case ast.Call(func=ast.Name(id=name)):
                return FUNCTIONS[name](*(self._of(part, values) for part in node.args))
            case ast.BinOp(left=left, op=op, right=right):
                one, other = self._of(left, values), self._of(right, values)
                return (
                    _BINARY[type(op)](float(one), float(other))
                    if type(op) is ast.Pow
                    else _BINARY[type(op)](one, other)
                )
            case ast.UnaryOp(op=op, operand=operand):
                return _UNARY[type(op)](self._of(operand, values))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return _COMPARISONS[type(op)](self._of(left, values), self._of(right, values))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return self._of(body if self._of(test, values) else orelse, values)
        raise AssertionError(node)


_LARGEST = 2**53


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
