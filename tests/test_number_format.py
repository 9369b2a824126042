"""Numbers as people read them."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.number_format import (
    flatten,
    format_count,
    format_measured,
    format_number,
    format_percent_value,
    humanise,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (math.nan, "–"),
        (0.0, "0"),
        (1.0, "1.00"),
        (-0.5, "−0.500"),
        (0.99996, "1.00"),
        (123.456, "123"),
        (123456.0, "123000"),
        (9.9996e5, "1.00 × 10⁶"),
        (1.234e-4, "0.000123"),
        (-1.234e-12, "−1.23 × 10⁻¹²"),
    ],
)
def test_numbers_have_three_digits(value: float | None, text: str) -> None:
    assert format_number(value) == text


@given(some.floats(-1e12, 1e12, allow_subnormal=False))
def test_spelled_number_is_the_number(value: float) -> None:
    superscripts = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    text = format_number(value).replace("−", "-").replace(" × 10", "e").translate(superscripts)
    assert float(text) == pytest.approx(value, rel=0.0051)


@pytest.mark.parametrize(
    ("fraction", "text"),
    [
        (None, "–"),
        (0.0, "0"),
        (1.0, "100"),
        (0.5, "50.0"),
        (0.954, "95.4"),
        (0.99191, "99.19"),
        (0.9995, "99.950"),
        (0.99999, "99.9990"),
        (1 - 1e-12, "> 99.9999"),
        (1.5, "150"),
        (0.0004, "0.0400"),
    ],
)
def test_percentages_keep_what_matters(fraction: float | None, text: str) -> None:
    assert format_percent_value(fraction) == text


def test_counts_have_groups() -> None:
    assert format_count(1234567).replace("\N{NARROW NO-BREAK SPACE}", " ") == "1 234 567"
    assert format_count(None) == "–"


def test_keys_and_values_are_words() -> None:
    assert humanise("timings_s") == "timings [s]"
    assert humanise("scene_hash") == "scene hash"
    assert flatten({"numpy": "2.4", "on": True, "none": None}) == "numpy 2.4, on yes, none –"
    assert flatten([1, [2.5, "a"]]) == "1, 2.5, a"
    assert flatten([]) == flatten(None) == "–"


@given(some.floats(1e-9, 1e9), some.floats(1e-9, 1e9), some.sampled_from([-1.0, 1.0]))
def test_no_digit_is_beyond_the_second_of_the_uncertainty(size: float, uncertainty: float, sign: float) -> None:
    value = sign * size
    text = format_measured(value, uncertainty, 12).replace("−", "-")
    if "×" in text:
        mantissa, power = text.split(" × 10")
        text = f"{mantissa}e{power.translate(str.maketrans('⁻⁰¹²³⁴⁵⁶⁷⁸⁹', '-0123456789'))}"
    shown = Decimal(text)
    last = math.floor(math.log10(float(f"{uncertainty:.1e}")) + 1e-9) - 1
    power_of_value = math.floor(math.log10(size))
    # One digit at least, twelve at most: rounding is at most half of the last digit that is shown.
    place = min(max(last, power_of_value - 11), power_of_value)
    assert abs(float(shown) - value) <= 0.5000001 * 10.0**place
    assert shown % Decimal(1).scaleb(place) == 0
