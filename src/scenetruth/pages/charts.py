"""Charts of a page, as plain values that plotly's JavaScript draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["COLOURS", "Chart"]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7F3C8D", "#6B6B00")
"""Colours that people with colour blindness tell apart (M. Okabe and K. Ito, 2008), and two more."""


@dataclass(frozen=True)
class Chart:
    """A chart.

    Parameters
    ----------
    name
        Its name within the page.
    alt
        What it shows, in words, for those who do not see it.
    data, layout
        Traces and layout, as plotly has them.
    """

    name: str
    alt: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
