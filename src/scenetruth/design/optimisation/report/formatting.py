"""Formatting of numbers, intervals and parameters in reports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = [
    "UNDEFINED",
    "format_estimate",
    "format_interval",
    "format_length",
    "format_number",
    "format_percent",
    "format_signed_percent",
    "format_value",
]

UNDEFINED = "–"
_MINUS = "−"


def format_number(value: float | None, digits: int = 3) -> str:
    """Return the text of a number with ``digits`` significant digits.

    >>> tuple(format_number(value) for value in (0.012345, -1234.5, math.inf, None, 0.0, 2.5e-7))
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


def format_length(value: float, digits: int = 3) -> str:
    """Return the text of a specified number, without trailing zeros.

    >>> format_length(32.0), format_length(0.8), format_length(-1250.4), format_length(100.0), format_length(math.inf)
    ('32', '0.8', '−1250', '100', '∞')
    """
    text = format_number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def format_interval(low: float, high: float) -> str:
    """Return the text of an interval; empty if undefined.

    >>> format_interval(0.19, 0.254), format_interval(math.nan, 1.0)
    ('0.190 to 0.254', '')
    """
    return f"{format_number(low)} to {format_number(high)}" if math.isfinite(low) and math.isfinite(high) else ""


def format_estimate(value: float, half: float, samples: int) -> str:
    """Return the text of an estimate with the half width of its interval, or of its insignificance.

    >>> pairs = (0.532, 0.21), (-0.03, 0.09), (0.001, 0.004), (0.3, math.nan)
    >>> tuple(format_estimate(value, uncertainty, 64) for value, uncertainty in pairs)
    ('0.53 ± 0.21', 'not significant with 64 samples', 'under 0.05', '0.30')
    """
    if not math.isfinite(value):
        return UNDEFINED
    if not math.isfinite(half):
        return f"{value:.2f}".replace("-", _MINUS)
    if half <= abs(value):
        return f"{value:.2f} ± {half:.2f}".replace("-", _MINUS)
    return f"under {_LITTLE:g}" if value + half < _LITTLE else f"not significant with {samples} samples"


_LITTLE = 0.05  # negligible fraction of the variance


def format_percent(share: float) -> str:
    r"""Return the text of a fraction in per cent.

    >>> [format_percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in (0.125, -0.004, math.nan, 12.0)]
    ['12 %', '−0.4 %', '–', '1200 %']
    """
    if not math.isfinite(share):
        return format_number(share)
    return f"{format_length(100 * share, 2)}\N{NO-BREAK SPACE}%"


def format_signed_percent(share: float) -> str:
    r"""Return the text of a relative change in per cent with its sign.

    >>> [format_signed_percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in (0.21, -0.091, 0.0, math.nan)]
    ['+21 %', '−9.1 %', '0 %', '–']
    """
    return f"+{format_percent(share)}" if share > 0 else format_percent(share)


def format_value(value: Any) -> str:
    """Return the text of a parameter value.

    >>> format_value(0.123456), format_value("35 mm f/4"), format_value(5), format_value(True), format_value([1, 2.50])
    ('0.1235', '35 mm f/4', '5', 'yes', '1, 2.5')
    >>> format_value({"kind": "airy", "f_number": None})
    '{kind: airy, f_number: none}'
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}".replace("-", _MINUS)
    if isinstance(value, list | tuple):
        return ", ".join(map(format_value, value))
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {format_value(each)}' for key, each in value.items())}}}"
    return str(value)
