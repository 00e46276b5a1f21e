"""Functions of one variable in OpenSim's files: what a joint's axis or a coupled coordinate does with a coordinate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element

Floats = NDArray[np.float64]
Function = Callable[[Floats], Floats]
KINDS = (
    "Constant",
    "LinearFunction",
    "PolynomialFunction",
    "PiecewiseLinearFunction",
    "SimmSpline",
    "MultiplierFunction",
)


def function_in(holder: Element, tag: str = "function") -> Function | None:
    """The function that an element holds, under its own tag or within one called `tag`; None where there is none.

    Raises:
        InputError: a kind that is not known, or numbers that are none.
    """
    inner = holder.child(tag)
    found = [c for c in (holder if inner is None else inner).children if _is_function(c)]
    return function_of(found[0]) if found else None


def function_of(element: Element) -> Function:
    """As a function of arrays.

    Raises:
        InputError: a kind that is not known, or numbers that are none.
    """
    if element.tag == "Constant":
        value = float(element.needed("value").numbers(1)[0])
        return lambda x: np.full_like(x, value)
    if element.tag == "LinearFunction":
        slope, offset = element.needed("coefficients").numbers(2)
        return lambda x: slope * x + offset
    if element.tag == "PolynomialFunction":
        coefficients = element.needed("coefficients").numbers()
        return lambda x: np.asarray(np.polyval(coefficients, x), dtype=np.float64)
    if element.tag == "MultiplierFunction":
        scale = element.child("scale")
        factor = 1.0 if scale is None else float(scale.numbers(1)[0])
        inner = function_in(element)
        if inner is None:
            raise InputError("a <MultiplierFunction> of nothing", where=element.where)
        return lambda x: factor * inner(x)
    if element.tag in ("PiecewiseLinearFunction", "SimmSpline"):
        return _through_points(element)
    raise InputError(
        f"no function <{element.tag}> is known", where=element.where, expected=f"one of: {', '.join(KINDS)}"
    )


def _through_points(element: Element) -> Function:
    x, y = (element.needed(k).numbers() for k in ("x", "y"))
    if x.size != y.size or x.size < 2 or not (np.diff(x) > 0).all():
        raise InputError(
            f"{x.size} abscissae and {y.size} values", where=element.where, expected="as many, two or more, ascending"
        )
    if element.tag == "SimmSpline":
        return spline(x, y)
    slopes = np.diff(y) / np.diff(x)

    def line(at: Floats) -> Floats:
        k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, slopes.size - 1)
        return y[k] + slopes[k] * (at - x[k])

    return line


def spline(x: Floats, y: Floats) -> Function:
    """SIMM's cubic spline: at the ends its third derivative is that of the cubic through the four outermost points.

    Beyond the ends it goes on along its tangent. Source: Forsythe, Malcolm and Moler 1977, subroutine SPLINE; with two
    or three points the third derivatives at the ends are nought.
    """
    n, h = x.size, np.diff(x)
    steps = np.diff(y) / h
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for i in range(1, n - 1):  # in a sixth of the second derivatives
        matrix[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
        right[i] = steps[i] - steps[i - 1]
    matrix[0, :2], matrix[-1, -2:] = (-h[0], h[0]), (h[-1], -h[-1])
    if n > 3:
        second = np.diff(steps) / (x[2:] - x[:-2])
        third = np.diff(second) / (x[3:] - x[:-3])
        right[0], right[-1] = third[0] * h[0] ** 2, -third[-1] * h[-1] ** 2
    bend = np.zeros(n) if n == 2 else np.linalg.solve(matrix, right)
    slope = steps - h * (bend[1:] + 2 * bend[:-1])
    last = steps[-1] + h[-1] * (2 * bend[-1] + bend[-2])
    cubic = np.diff(bend) / h

    def value(at: Floats) -> Floats:
        k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, n - 2)
        d = at - x[k]
        inside = y[k] + d * (slope[k] + d * (3 * bend[k] + d * cubic[k]))
        below, above = y[0] + slope[0] * (at - x[0]), y[-1] + last * (at - x[-1])
        return np.where(at < x[0], below, np.where(at > x[-1], above, inside))

    return value


def _is_function(element: Element) -> bool:
    return element.tag in KINDS or element.tag.endswith(("Function", "Spline"))
