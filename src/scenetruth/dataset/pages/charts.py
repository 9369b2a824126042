"""Charts of values: histograms, and numbers against each other."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.dataset.pages.labels import bracketed
from scenetruth.dataset.pages.quantities import Quantity
from scenetruth.scoring.figures._common import BLUE, GREY, new_figure, save, style

__all__ = ["MOST_CHARTS", "MOST_PAIRED", "draw_histograms", "draw_pairs", "paired_of"]

MOST_CHARTS = 40
"""Histograms of one picture; of more, the first."""
MOST_PAIRED = 5
"""Numbers that are drawn against each other: ten pairs."""
_COLUMNS = 4
_WIDTH, _HEIGHT = 2.6, 1.95
_TITLE = 34
_MOST_BINS = 30
_FEW = 12
"""So many different numbers have a bar each."""
_LETTERS = 24
"""So many letters find room below the bars."""


def draw_histograms(quantities: Sequence[Quantity], path: Path) -> None:
    """Draw a histogram of each of some quantities into one picture.

    Parameters
    ----------
    quantities
        At least one; the first `MOST_CHARTS` are drawn.
    path
        The PNG file.
    """
    shown = quantities[:MOST_CHARTS]
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    with style():
        figure = new_figure(_WIDTH * columns, _HEIGHT * rows)
        for number, quantity in enumerate(shown):
            axes = figure.add_subplot(rows, columns, number + 1)
            _titled(axes, quantity)
            if quantity.numbers:
                _histogram(axes, quantity)
            else:
                _bars(axes, quantity)
        save(figure, path)


def paired_of(quantities: Sequence[Quantity]) -> list[Quantity]:
    """Return the numbers that are worth drawing against each other, not more than `MOST_PAIRED`.

    Those with few different values are left out, and those that another one decides.
    """
    found: list[Quantity] = []
    for one in quantities:
        different = len(set(one.numbers))
        if (
            different > 2
            and different > min(_FEW, len(one.numbers) // 3)
            and not any(_alike(one, other) for other in found)
        ):
            found.append(one)
    return found[:MOST_PAIRED] if len(found) > 1 else []


def _alike(one: Quantity, other: Quantity) -> bool:
    """Whether two numbers grow together, or against each other."""
    a, b = (np.argsort(np.argsort(part.numbers)) for part in (one, other))
    return bool((a == b).all() or (a == len(b) - 1 - b).all())


def draw_pairs(quantities: Sequence[Quantity], path: Path) -> None:
    """Draw every two of some numbers against each other into one picture.

    Parameters
    ----------
    quantities
        Numbers of the same samples in the same order, at least two.
    path
        The PNG file.
    """
    pairs = list(combinations(quantities, 2))
    columns = min(_COLUMNS, len(pairs))
    rows = -(-len(pairs) // columns)
    with style():
        figure = new_figure(_WIDTH * columns, 1.2 * _HEIGHT * rows)
        for number, (one, other) in enumerate(pairs):
            axes = figure.add_subplot(rows, columns, number + 1)
            axes.plot(one.numbers, other.numbers, ".", color=BLUE, markersize=4.5, alpha=0.6, markeredgewidth=0)
            _scaled(axes, one, other)
            axes.set_xlabel("\n".join(_lines(one)), fontsize=7, parse_math=False)
            axes.set_ylabel("\n".join(_lines(other)), fontsize=7, parse_math=False)
            axes.tick_params(labelsize=7)
            axes.grid(visible=True)
        save(figure, path)


def _histogram(axes: Any, quantity: Quantity) -> None:
    values = np.array(quantity.numbers)
    different = np.unique(values)
    if len(different) <= min(_FEW, max(len(values) // 3, 1)) and _are_round(different):
        labels = [f"{value:g}" for value in different]
        counts = [int(np.count_nonzero(values == value)) for value in different]
        axes.bar(range(len(different)), counts, color=BLUE, width=0.7)
        # One bar alone is no wall.
        margin = 0.6 + max(3 - len(different), 0) / 2
        axes.set_xlim(-margin, len(different) - 1 + margin)
        axes.set_xticks(range(len(different)), labels, rotation=0 if len("".join(labels)) <= _LETTERS else 45)
    else:
        count = int(np.clip(np.ceil(2 * len(values) ** (1 / 3)), 5, _MOST_BINS))
        low, high = float(values.min()), float(values.max())
        if quantity.log and high > low:
            bins = np.geomspace(low, high, count + 1)
            _logarithmic(axes, "x")
        else:
            bins = np.linspace(low, high, count + 1) if high > low else np.array([low - 0.5, low + 0.5])
        axes.hist(values, bins=bins, color=BLUE, edgecolor="white", linewidth=0.4)
        if not quantity.log:
            axes.locator_params(axis="x", nbins=5)
    axes.set_ylabel("samples", fontsize=7)
    axes.locator_params(axis="y", nbins=4, integer=True)
    axes.tick_params(labelsize=7)


def _are_round(values: NDArray[np.float64]) -> bool:
    """Whether values are such as somebody writes, and not what comes of a measurement."""
    return all(value == float(f"{value:.4g}") for value in values)


def _bars(axes: Any, quantity: Quantity) -> None:
    names = [_plain(name, 22) for name, _ in quantity.counts]
    counts = [count for _, count in quantity.counts]
    places = range(len(names))[::-1]
    axes.barh(places, counts, color=BLUE, height=0.7)
    axes.set_yticks(places, names, fontsize=7, parse_math=False)
    axes.set_xlabel("samples", fontsize=7)
    axes.locator_params(axis="x", nbins=4, integer=True)
    axes.tick_params(axis="x", labelsize=7)


def _titled(axes: Any, quantity: Quantity) -> None:
    axes.set_title("\n".join(_lines(quantity)), fontsize=8, parse_math=False)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(False)
    for spine in ("left", "bottom"):
        axes.spines[spine].set_color(GREY)


def _lines(quantity: Quantity) -> list[str]:
    """Return what a quantity is in one line or two; its unit stays together."""
    label = bracketed(quantity.title, quantity.unit.replace(" ", "\N{NO-BREAK SPACE}"))
    return textwrap.wrap(_plain(label, 2 * _TITLE), _TITLE)[:2]


def _scaled(axes: Any, one: Quantity, other: Quantity) -> None:
    if one.log:
        _logarithmic(axes, "x")
    else:
        axes.locator_params(axis="x", nbins=4)
    if other.log:
        _logarithmic(axes, "y")
    else:
        axes.locator_params(axis="y", nbins=4)


def _logarithmic(axes: Any, which: str) -> None:
    """Make an axis logarithmic, with numbers such as 0.02 at its ticks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _plain(text: str, longest: int = 40) -> str:
    """Return a text that can be drawn: one line, nothing that no letter stands for, not too long."""
    shown = "".join(one if one.isprintable() or one == "\N{NO-BREAK SPACE}" else " " for one in text)
    return shown if len(shown) <= longest else f"{shown[: longest - 1]}…"
