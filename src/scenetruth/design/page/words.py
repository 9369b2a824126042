"""Numbers, parameters and intervals as people read them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = ["UNDEFINED", "estimate", "interval", "length", "number", "percent", "said", "signed_percent"]

UNDEFINED = "–"
_MINUS = "−"


def number(value: float | None, digits: int = 3) -> str:
    """Spell a number with so many significant digits.

    Examples
    --------
    >>> number(0.012345), number(-1234.5), number(math.inf), number(None), number(0.0), number(2.5e-7)
    ('0.0123', '−1230', '∞', '–', '0', '2.50e−7')
    """
    if value is None or math.isnan(value):
        return UNDEFINED
    if math.isinf(value):
        return "∞" if value > 0 else f"{_MINUS}∞"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -4 <= power < 6:
        text = f"{float(f'{mantissa}e{power}'):.{max(digits - 1 - power, 0)}f}"
    else:
        text = f"{mantissa}e{power}"
    return text.replace("-", _MINUS)


def length(value: float, digits: int = 3) -> str:
    """Spell a number that is set and not measured: without zeros at its end.

    Examples
    --------
    >>> length(32.0), length(0.8), length(-1250.4), length(100.0), length(math.inf)
    ('32', '0.8', '−1250', '100', '∞')
    """
    text = number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def interval(low: float, high: float) -> str:
    """Spell an interval; empty where there is none.

    Examples
    --------
    >>> interval(0.19, 0.254), interval(math.nan, 1.0)
    ('0.190 to 0.254', '')
    """
    return f"{number(low)} to {number(high)}" if math.isfinite(low) and math.isfinite(high) else ""


def estimate(value: float, half: float, samples: int) -> str:
    """Spell an estimate with the half width of its interval; say so where it is not known, or only that it is small.

    Parameters
    ----------
    value, half
        The estimate, and the half width of its interval.
    samples
        From how many samples it is.

    Examples
    --------
    >>> estimate(0.532, 0.21, 64), estimate(-0.03, 0.09, 64), estimate(0.001, 0.004, 64), estimate(0.3, math.nan, 64)
    ('0.53 ± 0.21', 'cannot be told from 64 samples', 'under 0.05', '0.30')
    """
    if not math.isfinite(value):
        return UNDEFINED
    if not math.isfinite(half):
        return f"{value:.2f}".replace("-", _MINUS)
    if half <= abs(value):
        return f"{value:.2f} ± {half:.2f}".replace("-", _MINUS)
    return f"under {_LITTLE:g}" if value + half < _LITTLE else f"cannot be told from {samples} samples"


_LITTLE = 0.05
"""A share of the variance that is as good as none."""


def percent(share: float) -> str:
    r"""Spell a share as a number of per cent.

    Examples
    --------
    >>> [percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in (0.125, -0.004, math.nan, 12.0)]
    ['12 %', '−0.4 %', '–', '1200 %']
    """
    if not math.isfinite(share):
        return number(share)
    return f"{length(100 * share, 2)}\N{NO-BREAK SPACE}%"


def signed_percent(share: float) -> str:
    r"""Spell a change as a number of per cent, with its sign.

    Examples
    --------
    >>> [signed_percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in (0.21, -0.091, 0.0, math.nan)]
    ['+21 %', '−9.1 %', '0 %', '–']
    """
    return f"+{percent(share)}" if share > 0 else percent(share)


def said(value: Any) -> str:
    """Spell the value of a parameter.

    Examples
    --------
    >>> said(0.123456), said("35 mm f/4"), said(5), said(True), said([1, 2.50])
    ('0.1235', '35 mm f/4', '5', 'yes', '1, 2.5')
    >>> said({"kind": "airy", "f_number": None})
    '{kind: airy, f_number: none}'
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}".replace("-", _MINUS)
    if isinstance(value, list | tuple):
        return ", ".join(map(said, value))
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {said(each)}' for key, each in value.items())}}}"
    return str(value)
