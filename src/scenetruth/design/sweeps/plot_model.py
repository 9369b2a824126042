"""Plots of a sweep, independent of the plotting library: curves over one factor, maps over two, points over more."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from scenetruth.design.parameter_words import describe_parameter, label_parameter, title_parameters
from scenetruth.design.sweeps.factors import format_level
from scenetruth.design.sweeps.point_simulation import BOUND
from scenetruth.design.sweeps.sweep_result import STATISTICS, Sweep, SweepRecord
from scenetruth.scoring import QUANTITIES
from scenetruth.scoring.quantities import get_title, get_units
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = [
    "PanelAxis",
    "SweepCurve",
    "SweepMap",
    "SweepPanel",
    "build_panels",
    "choose_main_region",
    "describe_place",
    "format_place",
    "format_short",
    "format_statistic_title",
    "list_plotted_quantities",
]

POSITIVE = ("rmse", "precision_std", "median_abs_error")
"""Statistics with a logarithmic axis."""
_WIDE = 8.0  # ratio of the largest to the smallest level from which an axis is logarithmic
_MOST_CURVES = 8  # most curves of a panel

Place = float | str


@dataclass(frozen=True)
class PanelAxis:
    """An axis of a panel: ``names`` are the labels of non-numeric levels, in order; ``path`` is that of a factor."""

    title: str
    names: tuple[str, ...] = ()
    logarithmic: bool = False
    path: str = ""


@dataclass(frozen=True)
class SweepCurve:
    """A line or a set of points with error bars."""

    name: str
    points: tuple[tuple[Place, float, float, float], ...]  # position, value, low and high (NaN without an interval)
    colour: int  # index of the colour
    is_bound: bool = False  # shows the Cramér-Rao bound
    joined: bool = True
    labels: tuple[str, ...] = ()
    """Labels of the points with all factors, if more than the factor of the axis varies."""


@dataclass(frozen=True)
class SweepMap:
    """A statistic over two factors; ``cells`` are (x, y, value, low, high, bound), NaN where missing.

    ``levels``: All levels of both factors, also those without a value.
    """

    cells: tuple[tuple[Place, Place, float, float, float, float], ...]
    is_grid: bool
    levels: tuple[tuple[Place, ...], tuple[Place, ...]] = ((), ())

    def names(self, *, along_x: bool) -> list[str]:
        """Return the labels of the columns or rows of a grid: numbers ascending, other labels in their order."""
        own = self.levels[0] if along_x else self.levels[1]
        places = list(dict.fromkeys([*own, *(cell[0] if along_x else cell[1] for cell in self.cells)]))
        numbers = [place for place in places if not isinstance(place, str)]
        return list(map(format_place, sorted(numbers) if len(numbers) == len(places) else places))


@dataclass(frozen=True)
class SweepPanel:
    """One chart, with curves or a map; ``number`` and ``logarithmic`` describe the colour scale of a map."""

    title: str
    x: PanelAxis
    y: PanelAxis
    curves: tuple[SweepCurve, ...] = ()
    map: SweepMap | None = None
    number: str = ""
    logarithmic: bool = False
    words: str = field(default="", compare=False)
    """Text alternative of the chart."""

    def decades(self, place: int) -> float:
        """Return the number of decades that the values and intervals along x (0) or y (1) span."""
        ends = [
            float(value)
            for curve in self.curves
            for point in curve.points
            for value in (point[:1] if place == 0 else point[1:])
            if not isinstance(value, str) and math.isfinite(value) and value > 0
        ]
        if self.map is not None:
            ends += [float(cell[place]) for cell in self.map.cells if not isinstance(cell[place], str)]
        return math.log10(max(ends) / min(ends)) if ends else 0.0


def choose_main_region(found: Sweep) -> str:
    """Return the region that is shown first: the interior if it has valid pixels, else the first region."""
    regions = list(dict.fromkeys(row.region for row in found.rows if row.statistic == "rmse" and not row.is_bound))
    return "interior" if "interior" in regions or not regions else regions[0]


def list_plotted_quantities(found: Sweep) -> list[str]:
    """Return the quantities that are plotted; growth only if an object grows."""
    there = {row.quantity for row in found.rows if not row.is_bound and row.statistic == "rmse"}
    return [name for name, entry in QUANTITIES.items() if name in there and (found.grows or not entry.is_growth)]


def format_statistic_title(quantity: str, statistic: str) -> str:
    """Return the title of a statistic of a quantity, with its unit."""
    return f"{get_title(quantity)}: {_short_title(quantity, statistic)}"


def format_short(number: float, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits, large numbers without an exponent.

    >>> format_short(231.6, 2), format_short(0.012345)
    ('230', '0.0123')
    """
    return f"{float(f'{number:.{digits}g}'):g}"


def build_panels(found: Sweep, quantity: str, statistic: str = "rmse", region: str = "interior") -> list[SweepPanel]:
    """Return the panels of a statistic of a quantity; empty without values."""
    assert statistic in STATISTICS
    rows = [row for row in found.selected(quantity, statistic, region=region) if math.isfinite(row.value)]
    if not any(not row.is_bound for row in rows):
        return []
    positive = statistic in POSITIVE and all(row.value > 0 for row in rows)
    number = PanelAxis(_short_title(quantity, statistic), logarithmic=positive)
    factors = _plotted_factors(found)
    axes = {path: _axis(found, path) for path in factors}
    if len(factors) == 2:
        panels = [panel for group in _groups(found, rows) for panel in _over_two(found, axes, number, *group)]
    else:
        joined = found.is_grid and len(factors) == 1
        panels = [_panel("", axes[path], number, _curves_of_all(found, rows, path, joined=joined)) for path in factors]
    return [replace(panel, words=f"{get_title(quantity)}: {panel.words}") for panel in panels]


_METHOD = "estimate.method"


def _plotted_factors(found: Sweep) -> list[str]:
    """Return the factors that are axes: the method is none with others, because each method is a group of its own."""
    others = [path for path in found.factors if path != _METHOD]
    return others if others and _is_of_groups(found) else list(found.factors)


def _is_of_groups(found: Sweep) -> bool:
    """Return whether the method is a factor, of which every group has one level."""
    if _METHOD not in found.factors:
        return False
    pairs = {(row.method, format_level(row.values[_METHOD])) for row in found.rows if not row.is_bound}
    return len(pairs) == len({method for method, _ in pairs})


def _short_title(quantity: str, statistic: str) -> str:
    unit = "" if statistic == "density" else f", {get_units(quantity)}"
    return f"{STATISTIC_TITLES[statistic]}{unit}"


def describe_place(row: SweepRecord) -> str:
    """Return the levels of a point in words."""
    titles = title_parameters(list(row.values))
    return ", ".join(
        describe_parameter(path, value, format_level(value), titles[path]) for path, value in row.values.items()
    )


def _label(found: Sweep, path: str) -> str:
    title = title_parameters(found.factors)[path]
    return path if title == path else label_parameter(path)


def _axis(found: Sweep, path: str) -> PanelAxis:
    values = {format_level(row.values[path]): row.values[path] for row in found.rows}
    if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values.values()):
        return PanelAxis(_label(found, path), tuple(values), path=path)
    low, high = min(values.values()), max(values.values())
    is_log = low > 0 and (path in found.logarithmic or high >= _WIDE * low)
    return PanelAxis(_label(found, path), logarithmic=is_log, path=path)


def _place(axis: PanelAxis, value: Any) -> Place:
    return format_level(value) if axis.names else float(value)


def _groups(found: Sweep, rows: Sequence[SweepRecord]) -> list[tuple[str, list[SweepRecord], list[SweepRecord]]]:
    """Return (label, records, records of the bound) for each method in each scene."""
    groups = []
    for scene in found.scenes:
        for method in found.methods:
            own = [row for row in rows if row.scene == scene and row.method == method]
            bound = [row for row in rows if row.scene == scene and row.method in (BOUND, f"{BOUND} of {method}")]
            if _is_of_groups(found):
                levels = {format_level(row.values[_METHOD]) for row in own}
                bound = [row for row in bound if format_level(row.values[_METHOD]) in levels]
            if own:
                parts = [scene] if len(found.scenes) > 1 else []
                parts += [method] if len(found.methods) > 1 or not parts else []
                groups.append((", ".join(parts), own, bound))
    return groups


def _title(found: Sweep, name: str) -> str:
    """Return the title that identifies a group's panels; empty for a single group."""
    return name if len(found.scenes) * len(found.methods) > 1 else ""


def _curves_of_all(found: Sweep, rows: Sequence[SweepRecord], path: str, *, joined: bool) -> list[SweepCurve]:
    axis, curves = _axis(found, path), []
    groups = _groups(found, rows)
    for colour, (name, own, bound) in enumerate(groups):
        curves.append(_curve(name, axis, own, colour, joined=joined))
        if bound:
            text = "Cramér-Rao bound" if len(groups) == 1 else f"Cramér-Rao bound, {name}"
            curves.append(_curve(text, axis, bound, colour, joined=joined))
    return curves


def _curve(name: str, axis: PanelAxis, rows: Iterable[SweepRecord], colour: int, *, joined: bool = True) -> SweepCurve:
    """Return a curve over the factor of an axis, sorted along the axis."""
    path = axis.path
    placed = [(_place(axis, row.values[path]), row) for row in rows]
    placed.sort(key=lambda one: axis.names.index(str(one[0])) if axis.names else float(one[0]))
    return SweepCurve(
        name,
        tuple((place, row.value, row.ci_low, row.ci_high) for place, row in placed),
        colour,
        any(row.is_bound for _, row in placed),
        joined and not axis.names,
        tuple(describe_place(row) for _, row in placed if len(row.values) > 1),
    )


def _over_two(
    found: Sweep,
    axes: Mapping[str, PanelAxis],
    number: PanelAxis,
    name: str,
    own: Sequence[SweepRecord],
    bound: Sequence[SweepRecord],
) -> list[SweepPanel]:
    """Return a map over two factors; for a grid also curves over the first, one for each level of the second."""
    first, second = axes
    least = {_key(row): row.value for row in bound}
    cells = tuple(
        (
            _place(axes[first], row.values[first]),
            _place(axes[second], row.values[second]),
            row.value,
            row.ci_low,
            row.ci_high,
            least.get(_key(row), math.nan),
        )
        for row in own
    )
    every = [tuple(dict.fromkeys(_place(axes[path], row.values[path]) for row in found.rows)) for path in axes]
    best = min(own, key=lambda row: abs(row.value))
    titles = title_parameters(found.factors)
    text = f"smallest {format_short(best.value)} at {describe_place(best)}"
    words = f"{number.title} of {name} over {titles[first]} and {titles[second]}: {text}."
    panels = [
        SweepPanel(
            _title(found, name),
            axes[first],
            axes[second],
            map=SweepMap(cells, found.is_grid, (every[0], every[1])),
            number=number.title,
            logarithmic=number.logarithmic,
            words=words,
        )
    ]
    levels = {format_level(row.values[second]): row.values[second] for row in own}
    values = list(levels)
    if not found.is_grid:
        for path in axes:
            curves = [_curve(name, axes[path], own, 0, joined=False)]
            curves += [_curve("Cramér-Rao bound", axes[path], bound, 0, joined=False)] if bound else []
            panels.append(_panel(_title(found, name), axes[path], number, curves))
        return panels
    if len(values) > _MOST_CURVES:
        return panels
    curves = []
    for colour, value in enumerate(values):
        label = describe_parameter(second, levels[value], value, titles[second])
        for rows, text in ((own, label), (bound, f"Cramér-Rao bound, {label}")):
            here = [row for row in rows if format_level(row.values[second]) == value]
            curves += [_curve(text, axes[first], here, colour)] if here else []
    return [*panels, _panel(_title(found, name), axes[first], number, curves)]


def _key(row: SweepRecord) -> tuple[str, ...]:
    return tuple(map(format_level, row.values.values()))


def _panel(title: str, x: PanelAxis, y: PanelAxis, curves: Sequence[SweepCurve]) -> SweepPanel:
    return SweepPanel(title, x, y, tuple(curves), words=f"{y.title}, over {x.title}. {_describe_curves(curves)}")


def _describe_curves(curves: Iterable[SweepCurve]) -> str:
    entries = []
    for curve in curves:
        (x0, y0, *_), (x1, y1, *_) = curve.points[0], curve.points[-1]
        entries.append(
            f"{curve.name}: {format_short(y0)} at {format_place(x0)}, {format_short(y1)} at {format_place(x1)}"
        )
    return "; ".join(entries) + "."


def format_place(place: Place) -> str:
    """Return the label of a position."""
    return place if isinstance(place, str) else f"{place:g}"
