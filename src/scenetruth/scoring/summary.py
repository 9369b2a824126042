"""A score in one line, and as a table for notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape

from scenetruth.scoring._format import format_count, format_number, format_percent
from scenetruth.scoring.quantities import (
    ENDPOINT,
    OUTLIERS,
    QUANTITIES,
    QUANTITY_GROUPS,
    title_of,
    units_of,
)
from scenetruth.scoring.regions import REGIONS

__all__ = ["html_summary", "line_summary", "shown_quantities"]

Values = Mapping[str, float | int | None]
Regions = Mapping[str, Mapping[str, Values]]

_MAIN = (("depth", "disparity"), (ENDPOINT, "flow_x"), ("growth_rate_windowed",))
"""Of each of these, the first that a score has is in its line."""

_COLUMNS: Mapping[str, tuple[str, Callable[[float | None], str]]] = {
    "bias": ("bias", format_number),
    "rms": ("rms", format_number),
    "median_abs": ("median |e|", format_number),
    "p95_abs": ("95 % |e|", format_number),
    "relative_rms": ("relative rms [%]", format_percent),
    "density": ("density [%]", format_percent),
    "count": ("pixels", format_count),
}


def shown_quantities(regions: Regions, *, grows: bool) -> list[str]:
    """Return the quantities of a score that have errors; growth only where something grows."""
    return [name for name in regions["all"] if name != OUTLIERS and (grows or not QUANTITIES[name].is_growth)]


def line_summary(regions: Regions, *, grows: bool) -> str:
    """Return one line that tells regions, quantities and the main errors of a score."""
    shown = shown_quantities(regions, grows=grows)
    groups = [name for name, members in QUANTITY_GROUPS.items() if set(members) & set(shown)]
    interior = regions["interior"]
    main = [next((name for name in names if name in shown), None) for names in _MAIN]
    errors = [f"{name} {_short(interior[name]['rms'])} {units_of(name)}" for name in main if name is not None]
    parts = {
        "regions": ", ".join(REGIONS) + (f" and {len(regions) - 2} more" if len(regions) > 2 else ""),
        "quantities": ", ".join(groups),
        "rms in the interior": ", ".join(errors),
    }
    return f"Score({'; '.join(f'{name}: {text}' for name, text in parts.items())})"


def html_summary(regions: Regions, *, grows: bool) -> str:
    """Return the errors in the regions that every score has as a table in HTML."""
    names = shown_quantities(regions, grows=grows)
    heads = _row("th", ["region", "quantity", "unit", *(heading for heading, _ in _COLUMNS.values())])
    rows = [
        _row("td", [region, title_of(name), units_of(name), *_cells(regions[region][name])])
        for region in REGIONS
        for name in names
    ]
    further = [region for region in regions if region not in REGIONS]
    more = f"<p>Further regions: {escape(', '.join(further))}</p>" if further else ""
    caption = "<caption>Errors e = estimate − truth</caption>"
    return f"<table>{caption}<thead>{heads}</thead><tbody>{''.join(rows)}</tbody></table>{more}"


def _cells(values: Values) -> list[str]:
    return [spell(values[name]) for name, (_, spell) in _COLUMNS.items()]


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _short(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3g}"
