"""Figures of drawn values: histograms, pairs of quantities, and contact sheets."""

from __future__ import annotations

import json
import math
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.dataset.pages.page_text import describe_value, format_label, format_title, split_unit
from scenetruth.dataset.sampler import Sampler
from scenetruth.scoring.figures.figure_style import BLUE, GREY, new_figure, save, style, svg_of

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

__all__ = [
    "MOST_CHARTS", "ON_A_SHEET", "THUMBNAIL_PX", "PlotQuantity", "collect_quantities", "draw_contact_sheet",
    "draw_histograms", "draw_pairs", "select_paired", "split_quantities", "to_display_grey",
]  # fmt: skip


_MOST_CATEGORIES = 12
_LONGEST = 40
_AXES = ("X", "Y", "Z")


@dataclass(frozen=True)
class PlotQuantity:
    """A varied quantity with its values, or the frequency of each value that is not numeric (``counts``).

    ``log``: Whether it is evenly distributed on a logarithmic scale.
    """

    title: str
    unit: str = ""
    numbers: tuple[float, ...] = ()
    counts: tuple[tuple[str, int], ...] = ()
    log: bool = False

    @property
    def label(self) -> str:
        """Title and unit."""
        return format_title(self.title, self.unit)

    @property
    def is_constant(self) -> bool:
        """Whether all values are equal."""
        return len(self.counts) == 1 or (bool(self.numbers) and min(self.numbers) == max(self.numbers))


def collect_quantities(sampler: Sampler, drawn: Mapping[str, Sequence[Any]]) -> list[PlotQuantity]:
    """Return the varied quantities of a recipe with their drawn values."""
    plain = sampler.bases[0].to_dict()
    found: list[PlotQuantity] = []
    for item in sampler.varied:
        values = [value for value in drawn.get(item.key, ()) if value is not None]
        if values:
            title, unit = format_label(item.key, plain)
            kind = getattr(item.distribution, "kind", "")
            found += split_quantities(title, unit, values, log=kind == "log_uniform")
    return found


def split_quantities(title: str, unit: str, values: Sequence[Any], *, log: bool = False) -> list[PlotQuantity]:
    """Return values as one quantity, or one quantity per number for lists and mappings of numbers.

    >>> split_quantities("shape", "", ["oval", "round", "oval"])[0].counts
    (('oval', 2), ('round', 1))
    >>> turns = [[{"axis": [0.0, 0.0, 1.0], "angle_deg": float(n)}] for n in range(20)]
    >>> [found.label for found in split_quantities("rotations", "", turns)]
    ['rotations axis X', 'rotations axis Y', 'rotations axis Z', 'rotations angle [°]']
    """
    if all(_is_number(value) for value in values):
        numbers = tuple(float(value) for value in values)
        return [PlotQuantity(title, unit, numbers, log=log and min(numbers) > 0)]
    texts = [json.dumps(value, sort_keys=True) for value in values]
    # Directions and positions are no categories, however few there are.
    if len(set(texts)) > _MOST_CATEGORIES or all(
        isinstance(value, list | tuple) and len(value) == len(_AXES) for value in values
    ):
        split = [dict(_leaves(value, "", unit)) for value in values]
        names = list(split[0])
        if names and all(list(one) == names for one in split):
            return [
                PlotQuantity(f"{title} {name}".strip(), own, tuple(one[name, own] for one in split))
                for name, own in names
            ]
    return [PlotQuantity(title, unit, counts=tuple(_counted(values, texts)))]


def _leaves(value: Any, name: str, unit: str) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield the numbers in a value with their names and units; other contents yield nothing."""
    if _is_number(value):
        yield (name, unit), float(value)
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            entries, own = split_unit(str(key))
            yield from _leaves(entry, f"{name} {entries}".strip(), own or unit)
    elif isinstance(value, list | tuple):
        axes = len(value) == len(_AXES) and all(_is_number(entry) for entry in value)
        for index, entry in enumerate(value):
            entries = _AXES[index] if axes else f"({index})" if len(value) > 1 else ""
            yield from _leaves(entry, f"{name} {entries}".strip(), unit)


def _counted(values: Sequence[Any], texts: Sequence[str]) -> Iterator[tuple[str, int]]:
    by_text = dict(zip(texts, values, strict=True))
    short = {text: _short(value) for text, value in by_text.items()}
    if len(set(short.values())) < len(short):
        short = {text: _cut(describe_value(value)) for text, value in by_text.items()}
    counts = sorted(Counter(texts).items(), key=lambda one: (-one[1], one[0]))
    kept = counts if len(counts) <= _MOST_CATEGORIES else counts[: _MOST_CATEGORIES - 1]
    yield from ((short[text], count) for text, count in kept)
    if len(kept) < len(counts):
        rest = counts[len(kept) :]
        yield f"{len(rest):,} others", sum(count for _, count in rest)


def _short(value: Any) -> str:
    if isinstance(value, Mapping) and isinstance(value.get("kind"), str):
        return _cut(value["kind"].replace("_", " "))
    return _cut(describe_value(value))


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


MOST_CHARTS = 40
"""Maximum number of histograms in a figure."""
MOST_PAIRED = 5
"""Maximum number of quantities in pair plots: ten pairs."""
_CHART_COLUMNS = 4
_WIDTH, _HEIGHT = 2.6, 1.95
_TITLE = 34
_MOST_BINS = 30
_FEW = 12
"""Maximum number of distinct numbers with one bar each."""
_LETTERS = 24
"""Maximum number of letters below the bars."""


def draw_histograms(quantities: Sequence[PlotQuantity], path: Path) -> str:
    """Draw histograms of quantities into one figure, and return it as SVG."""
    shown = quantities[:MOST_CHARTS]
    columns = min(_CHART_COLUMNS, len(shown))
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
        return svg_of(figure)


def select_paired(quantities: Sequence[PlotQuantity]) -> list[PlotQuantity]:
    """Return at most `MOST_PAIRED` quantities for pair plots, with many distinct values, not determined by others."""
    found: list[PlotQuantity] = []
    for one in quantities:
        different = len(set(one.numbers))
        if (
            different > 2
            and different > min(_FEW, len(one.numbers) // 3)
            and not any(_alike(one, other) for other in found)
        ):
            found.append(one)
    return found[:MOST_PAIRED] if len(found) > 1 else []


def _alike(one: PlotQuantity, other: PlotQuantity) -> bool:
    """Return whether two quantities are monotonic functions of each other."""
    a, b = (np.argsort(np.argsort(part.numbers)) for part in (one, other))
    return bool((a == b).all() or (a == len(b) - 1 - b).all())


def draw_pairs(quantities: Sequence[PlotQuantity], path: Path) -> str:
    """Draw pair plots of all quantities into one figure, and return it as SVG."""
    pairs = list(combinations(quantities, 2))
    columns = min(_CHART_COLUMNS, len(pairs))
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
        return svg_of(figure)


def _histogram(axes: Any, quantity: PlotQuantity) -> None:
    values = np.array(quantity.numbers)
    different = np.unique(values)
    if len(different) <= min(_FEW, max(len(values) // 3, 1)) and _are_round(different):
        labels = [f"{value:g}" for value in different]
        counts = [int(np.count_nonzero(values == value)) for value in different]
        axes.bar(range(len(different)), counts, color=BLUE, width=0.7)
        # A single bar is drawn narrower than the axes.
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
    """Return whether values are round numbers rather than measurements."""
    return all(value == float(f"{value:.4g}") for value in values)


def _bars(axes: Any, quantity: PlotQuantity) -> None:
    names = [_plain(name, 22) for name, _ in quantity.counts]
    counts = [count for _, count in quantity.counts]
    places = range(len(names))[::-1]
    axes.barh(places, counts, color=BLUE, height=0.7)
    axes.set_yticks(places, names, fontsize=7, parse_math=False)
    axes.set_xlabel("samples", fontsize=7)
    axes.locator_params(axis="x", nbins=4, integer=True)
    axes.tick_params(axis="x", labelsize=7)


def _titled(axes: Any, quantity: PlotQuantity) -> None:
    axes.set_title("\n".join(_lines(quantity)), fontsize=8, parse_math=False)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(False)
    for spine in ("left", "bottom"):
        axes.spines[spine].set_color(GREY)


def _lines(quantity: PlotQuantity) -> list[str]:
    """Return title and unit in one or two lines, without a break in the unit."""
    label = format_title(quantity.title, quantity.unit.replace(" ", "\N{NO-BREAK SPACE}"))
    return textwrap.wrap(_plain(label, 2 * _TITLE), _TITLE)[:2]


def _scaled(axes: Any, one: PlotQuantity, other: PlotQuantity) -> None:
    if one.log:
        _logarithmic(axes, "x")
    else:
        axes.locator_params(axis="x", nbins=4)
    if other.log:
        _logarithmic(axes, "y")
    else:
        axes.locator_params(axis="y", nbins=4)


def _logarithmic(axes: Any, which: str) -> None:
    """Make an axis logarithmic, with decimal tick labels such as 0.02."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _plain(text: str, longest: int = 40) -> str:
    """Return a printable single-line text of limited length."""
    shown = "".join(one if one.isprintable() or one == "\N{NO-BREAK SPACE}" else " " for one in text)
    return shown if len(shown) <= longest else f"{shown[: longest - 1]}…"


ON_A_SHEET = 48
"""Maximum number of thumbnails per sheet."""
THUMBNAIL_PX = 160
"""Maximum side length of a thumbnail in pixels."""
_SHEET_COLUMNS = 8
_GAP, _CAPTION, _FOOT = 4, 15, 24
_GAMMA = 1 / 2.0
_BRIGHT, _ABOVE = 99.8, 1.15
"""Percentile of all pixels of a sheet that sets the white level."""


def to_display_grey(images: Sequence[NDArray[Any]]) -> list[NDArray[np.uint8]]:
    """Return linear images as display grey values with a common scale."""
    if not images:
        return []
    values = np.concatenate([np.asarray(image, dtype=np.float64).ravel() for image in images])
    white = _ABOVE * float(np.percentile(values, _BRIGHT)) or 1.0
    return [np.round(255 * np.clip(np.asarray(image) / white, 0, 1) ** _GAMMA).astype(np.uint8) for image in images]


def draw_contact_sheet(images: Sequence[tuple[str, NDArray[np.uint8]]], foot: str, path: Path) -> None:
    """Draw thumbnails (height, width) with captions in rows of eight; the PNG file is reproducible."""
    from PIL import Image, ImageDraw
    from PIL.PngImagePlugin import PngInfo

    height = max(image.shape[0] for _, image in images)
    width = max(image.shape[1] for _, image in images)
    columns = min(_SHEET_COLUMNS, len(images))
    rows = -(-len(images) // columns)
    small, font = _font(10), _font(11)
    size = (
        max(columns * (width + _GAP) + _GAP, round(font.getlength(foot)) + 3 * _GAP),
        rows * (height + _CAPTION + _GAP) + _GAP + _FOOT,
    )
    sheet = Image.new("L", size, 255)
    pen = ImageDraw.Draw(sheet)
    for number, (caption, image) in enumerate(images):
        row, column = divmod(number, columns)
        x, y = _GAP + column * (width + _GAP), _GAP + row * (height + _CAPTION + _GAP)
        sheet.paste(Image.fromarray(image), (x, y))
        pen.text((x, y + height), caption, fill=90, font=small)
    pen.text((_GAP, size[1] - _FOOT + 4), foot, fill=60, font=font)
    information = PngInfo()
    information.add_text("Software", "scenetruth")
    sheet.save(path, format="PNG", pnginfo=information)


@cache
def _font(size: int) -> FreeTypeFont:
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", size)
