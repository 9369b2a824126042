"""Formatting of numbers and names for readers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["flatten", "format_count", "format_number", "format_percent", "humanise"]

UNDEFINED = "–"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_number(value: float | None, digits: int = 3) -> str:
    """Format a number with the given significant digits; a dash where undefined.

    >>> format_number(0.012345), format_number(-1.5e-7), format_number(None)
    ('0.0123', '−1.50 × 10⁻⁷', '–')
    """
    if value is None or not math.isfinite(value):
        return UNDEFINED
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -4 <= power < 6:
        text = f"{float(f'{value:.{digits - 1}e}'):.{max(digits - 1 - power, 0)}f}"
    else:
        text = f"{mantissa} × 10{str(power).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−")


def format_percent(fraction: float | None) -> str:
    """Format a fraction as a percentage, with enough digits to distinguish it from 0 and 100.

    >>> format_percent(0.5), format_percent(0.9999), format_percent(1.0), format_percent(0.0004)
    ('50.0', '99.9900', '100', '0.0400')
    """
    if fraction is None or not math.isfinite(fraction):
        return UNDEFINED
    percent = 100.0 * fraction
    if not 90.0 <= percent < 100.0:
        return "100" if percent == 100.0 else format_number(percent)
    text = f"{percent:.{1 + sum(percent >= bound for bound in (99.0, 99.9, 99.99))}f}"
    return "> 99.9999" if text.startswith("100") else text


def format_count(value: float | None) -> str:
    """Format a count with narrow spaces between thousands."""
    return UNDEFINED if value is None else f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def humanise(key: str) -> str:
    """Return a key as words, with its unit in brackets: ``timings_s`` becomes ``timings [s]``."""
    for unit in ("s", "px", "mm"):
        if key.endswith(f"_{unit}"):
            return f"{key.removesuffix(f'_{unit}').replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


def flatten(value: Any) -> str:
    """Format a plain JSON value on one line."""
    return ", ".join(_entries(value)) or UNDEFINED


def _entries(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield f"{key.replace('_', ' ')} {flatten(entry)}"
    elif isinstance(value, list | tuple):
        yield from (flatten(entry) for entry in value)
    elif isinstance(value, bool):
        yield "yes" if value else "no"
    elif value is not None and value != "":
        yield str(value)
