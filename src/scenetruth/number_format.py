"""Formatting of numbers, intervals, parameter values and names in pages, tables and messages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = [
    "UNDEFINED",
    "flatten",
    "format_count",
    "format_duration",
    "format_estimate",
    "format_interval",
    "format_length",
    "format_measured",
    "format_number",
    "format_percent",
    "format_percent_value",
    "format_share",
    "format_signed_percent",
    "format_two_digits",
    "format_unit",
    "format_value",
    "format_with_std",
    "humanise",
]

UNDEFINED = "–"
_MINUS = "−"
_HOUR_S, _DAY_S = 3600.0, 86_400.0
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_number(value: float | None, digits: int = 3) -> str:
    """Format a number with the given significant digits; a dash where undefined.

    >>> format_number(0.012345), format_number(-1.5e-7), format_number(None), format_number(math.inf)
    ('0.0123', '−1.50 × 10⁻⁷', '–', '∞')
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
        text = f"{float(f'{value:.{digits - 1}e}'):.{max(digits - 1 - power, 0)}f}"
    else:
        text = f"{mantissa} × 10{str(power).translate(_SUPERSCRIPTS)}"
    return text.replace("-", _MINUS)


def format_two_digits(value: float) -> str:
    """Format a number with two significant digits, three of hundreds, without a power of ten where possible.

    >>> format_two_digits(0.0523), format_two_digits(1.4), format_two_digits(664.2), format_two_digits(36547.0)
    ('0.052', '1.4', '664', '37000')
    >>> format_two_digits(4.4e-5), format_two_digits(1.2e7)
    ('4.4 × 10⁻⁵', '1.2 × 10⁷')
    """
    if not math.isfinite(value):
        return UNDEFINED
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        return f"{value:.0f}" if 1e2 <= abs(value) < 1e3 else f"{float(f'{value:.1e}'):.10g}"
    return format_number(value, 2)


def format_percent_value(fraction: float | None) -> str:
    """Format a fraction as a percentage, with enough digits to distinguish it from 0 and 100.

    >>> format_percent_value(0.5), format_percent_value(0.9999), format_percent_value(1.0), format_percent_value(0.0004)
    ('50.0', '99.9900', '100', '0.0400')
    """
    if fraction is None or not math.isfinite(fraction):
        return UNDEFINED
    percent = 100.0 * fraction
    if not 90.0 <= percent < 100.0:
        return "100" if percent == 100.0 else format_number(percent)
    text = f"{percent:.{1 + sum(percent >= bound for bound in (99.0, 99.9, 99.99))}f}"
    return "> 99.9999" if text.startswith("100") else text


def format_unit(unit: str) -> str:
    """Return a unit as pages show it: nothing for ratios, and powers as exponents.

    >>> format_unit("1"), format_unit("px/step"), format_unit("1/mm^2")
    ('', 'px/step', '1/mm²')
    """
    return "" if unit == "1" else unit.replace("^2", "²")


def format_count(value: float | None) -> str:
    """Format a count with narrow spaces between thousands."""
    return UNDEFINED if value is None else f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def format_duration(seconds: float) -> str:
    """Format a time in seconds, minutes or hours, from two days on also in days.

    >>> [format_duration(seconds) for seconds in (0.0, 119.0, 900.0, 7200.0, 100_000.0, 372_600.0)]
    ['0 s', '119 s', '15 min', '2 h', '28 h', '104 h (4.3 days)']
    """
    if not math.isfinite(seconds):
        return UNDEFINED
    size, unit = next(
        each for each in ((_HOUR_S, "h"), (60.0, "min"), (1.0, "s")) if seconds >= 2 * each[0] or each[0] == 1
    )
    text = f"{format_two_digits(seconds / size)} {unit}"
    return text if seconds < 2 * _DAY_S else f"{text} ({format_two_digits(seconds / _DAY_S)} days)"


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
    elif isinstance(value, float):
        yield f"{value:.7g}"
    elif value is not None and value != "":
        yield str(value)


def format_length(value: float, digits: int = 3) -> str:
    """Return the text of a specified number, without trailing zeros.

    >>> format_length(32.0), format_length(0.8), format_length(-1250.4), format_length(100.0), format_length(math.inf)
    ('32', '0.8', '−1250', '100', '∞')
    """
    text = format_number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "×" not in text else text


def format_measured(value: float | None, uncertainty: float | None, digits: int = 3) -> str:
    """Format a number without digits below the second significant digit of its uncertainty, and at least one digit.

    ``uncertainty``: Standard deviation or half width of an interval; without one, ``digits`` apply.
    ``digits``: Largest number of significant digits.

    >>> [format_measured(12.3456, one) for one in (0.004, 0.4, 4.0, 40.0, None, math.inf)]
    ['12.3', '12.3', '12.3', '12', '12.3', '12.3']
    >>> format_measured(5016.318, 0.274, 7), format_measured(0.0399512, 0.013), format_measured(0.0012, 0.4)
    ('5016.32', '0.040', '0.001')
    """
    if value is None or not math.isfinite(value) or value == 0:
        return format_number(value, digits)
    if uncertainty is None or not 0 < uncertainty < math.inf:
        return format_number(value, digits)
    last = min(_power_of(uncertainty) - 1, math.floor(math.log10(abs(value))))
    shown = round(value, -last) or value
    first = math.floor(math.log10(abs(shown)))
    return format_number(shown, max(1, min(digits, first - last + 1)))


def format_with_std(value: float, std: float, digits: int = 9) -> str:
    """Format a number with its standard deviation, both to the second significant digit of the latter.

    >>> format_with_std(601.24, 0.0869), format_with_std(0.39106, 0.0007), format_with_std(1700.2987, 0.097)
    ('601.240 ± 0.087', '0.39106 ± 0.00070', '1700.299 ± 0.097')
    >>> format_with_std(5.7369e-05, 2.5e-05), format_with_std(-1.36e-05, 3.6e-05), format_with_std(0.0, 0.0)
    ('(5.7 ± 2.5) × 10⁻⁵', '(−1.4 ± 3.6) × 10⁻⁵', '0 ± 0')
    >>> format_with_std(99.9937, 0.0043), format_with_std(9.96, 0.21), format_with_std(999.97, 0.24)
    ('99.9937 ± 0.0043', '9.96 ± 0.21', '999.97 ± 0.24')
    """
    texts = [format_measured(value, std, digits), format_number(std, 2)]
    largest = max(abs(value), abs(std))
    if not any("×" in text for text in texts) or not math.isfinite(largest):
        return " ± ".join(texts)
    power = math.floor(math.log10(largest))
    scale = 10.0**-power
    texts = [format_measured(scale * value, scale * std, digits), format_number(scale * std, 2)]
    return f"({' ± '.join(texts)}) × 10{str(power).translate(_SUPERSCRIPTS)}"


def _power_of(value: float) -> int:
    """Return the power of ten of the first significant digit, after rounding to two."""
    return int(f"{abs(value):.1e}".partition("e")[2])


def format_interval(low: float, high: float) -> str:
    """Return the text of an interval, to the second significant digit of its half width; empty if undefined.

    If a power of ten is written for the end that is larger in magnitude, both have the same; else neither has one.

    >>> format_interval(0.19, 0.254), format_interval(math.nan, 1.0), format_interval(0.98, 5.1234)
    ('0.190 to 0.254', '', '1.0 to 5.1')
    >>> format_interval(2.5e-5, 9.4e-5), format_interval(2e-5, 9.1e-5), format_interval(6.5e-5, 0.0307)
    ('2.5 to 9.4 × 10⁻⁵', '2.0 to 9.1 × 10⁻⁵', '0.000 to 0.031')
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return ""
    half = 0.5 * abs(high - low)
    ends = [format_measured(low, half), format_measured(high, half)]
    largest = max(ends, key=lambda end: abs((low, high)[ends.index(end)]))
    if any("×" in end for end in ends) and "×" not in largest and half > 0:
        digits = max(0, 1 - _power_of(half))
        ends = [f"{end:.{digits}f}".replace("-", _MINUS) for end in (low, high)]
    elif "×" in largest:
        power = math.floor(math.log10(max(abs(low), abs(high))))
        digits = max(0, power + 1 - _power_of(half)) if half > 0 else 1
        ends = [f"{end / 10.0**power:.{digits}f}".replace("-", _MINUS) for end in (low, high)]
        return f"{' to '.join(ends)} × 10{str(power).translate(_SUPERSCRIPTS)}"
    return " to ".join(ends)


def format_estimate(value: float, half: float, samples: int) -> str:
    """Return the text of an estimate with the half width of its interval, or of its insignificance.

    >>> pairs = (0.532, 0.21), (-0.03, 0.09), (0.004, 0.003), (0.3, math.nan)
    >>> tuple(format_estimate(value, uncertainty, 64) for value, uncertainty in pairs)
    ('0.53 ± 0.21', 'not significant with 64 samples', 'under 0.05', '0.30')
    """
    if not math.isfinite(value):
        return UNDEFINED
    if not math.isfinite(half):
        return f"{value:.2f}".replace("-", _MINUS)
    if half <= abs(value) and abs(value) >= _ROUNDED:
        return f"{value:.2f} ± {half:.2f}".replace("-", _MINUS)
    return f"under {_LITTLE:g}" if value + half < _LITTLE else f"not significant with {samples} samples"


_NO_CHANGE = 5e-5
_LITTLE = 0.05  # negligible fraction of the variance
_ROUNDED = 0.005  # smaller values are 0.00


def format_percent(share: float) -> str:
    r"""Return the text of a fraction in per cent.

    >>> [format_percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in (0.125, -0.004, math.nan, 12.0)]
    ['12 %', '−0.4 %', '–', '1200 %']
    """
    if not math.isfinite(share):
        return format_number(share)
    return f"{format_length(100 * share, 2)}\N{NO-BREAK SPACE}%"


def format_share(fraction: float) -> str:
    """Format a fraction of a reference: as a percentage, from twice on as a factor.

    >>> format_share(0.015), format_share(0.586), format_share(18.63), format_share(2.0)
    ('1.50 %', '58.6 %', '19 times', '2 times')
    """
    return f"{format_percent_value(fraction)} %" if fraction < 2 else f"{format_two_digits(fraction)} times"


def format_signed_percent(share: float) -> str:
    r"""Return the text of a relative change in per cent with its sign; changes under 0.005 % are 0 %.

    >>> [format_signed_percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in (0.21, -0.091, 6e-8, math.nan)]
    ['+21 %', '−9.1 %', '0 %', '–']
    """
    share = 0.0 if abs(share) < _NO_CHANGE else share
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
