"""One page that holds everything about a score: numbers, figures, definitions and where it comes from."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from scenetruth.schema import intrinsics_of, scene_of
from scenetruth.scoring._format import flatten, format_count, format_number, format_percent, humanise
from scenetruth.scoring.figures import FigureInfo, draw_all
from scenetruth.scoring.quantities import ENDPOINT, GROWTH_QUANTITIES, OUTLIERS, QUANTITIES, units_of
from scenetruth.scoring.regions import REGIONS
from scenetruth.scoring.score import Score
from scenetruth.settings import ScoreSettings

__all__ = ["write_report"]

_TEMPLATE = "report.html.j2"
_SCREEN_SCALE = 0.6
"""Pixels of the page for a pixel of a figure."""
_HEADLINES = (
    ("Depth", "depth", "rms"),
    ("Disparity", "disparity", "rms"),
    ("Velocity in Z", "velocity_z", "rms"),
    ("Velocity endpoint", ENDPOINT, "rms"),
    ("Density of depth", "depth", "density"),
    ("Scene flow outliers", OUTLIERS, "scene_flow_rate"),
)
_BY_REGION = ("depth", "disparity", "velocity_z", ENDPOINT, "growth_rate", "growth_rate_windowed")
"""Quantities whose rms errors are shown for every region."""
_SHORT = {ENDPOINT: "U, endpoint", "growth_rate": "growth rate", "growth_rate_windowed": "growth, windowed"}
_SHOWN_ELSEWHERE = ("warnings", "render_fallback_reason", "score_settings")


def write_report(
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset,
    score: Score,
    folder: str | Path,
    progress: Callable[[str, int, int], None] | None = None,
) -> Path:
    """Draw the figures of a score, and write them with all its numbers into one page.

    Parameters
    ----------
    recording, estimate, truth
        What was estimated from, what was scored, and against what.
    score
        The score. Of its metadata, ``warnings`` (a list of texts) and ``render_fallback_reason`` are shown at the top
        and everything else in a table.
    folder
        Where ``report.html`` and ``figures/*.png`` go; made if missing.
    progress
        Called as ``progress("report", done, total)``, in figures.

    Returns
    -------
    pathlib.Path
        The page. It holds its figures and needs no other file.

    Raises
    ------
    ScoreError
        If recording, estimate and truth do not belong together; lists what is wrong.
    """
    target = Path(folder)
    figures = draw_all(recording, estimate, truth, score, target / "figures", progress)
    page = target / "report.html"
    page.write_text(_render(recording, estimate, score, figures, target / "figures"), encoding="utf-8")
    return page


def _render(recording: xr.Dataset, estimate: xr.Dataset, score: Score, figures: list[FigureInfo], folder: Path) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("scenetruth.scoring", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": format_number, "percent": format_percent, "count": format_count}
    scene = scene_of(recording)
    margin = score.metadata.get("margin_px", 20.0)
    return environment.get_template(_TEMPLATE).render(
        name=(scene or {}).get("description"),
        notices=list(_notices(score.metadata)),
        headlines=[_headline(score, *entry) for entry in _HEADLINES],
        regions=[(region, list(_rows(score, region))) for region in REGIONS],
        outliers=[(region, score.regions[region][OUTLIERS]) for region in REGIONS],
        by_region=_by_region(score),
        margin=f"{margin:g}",
        settings=_settings(score),
        grows=score.grows,
        figures=[(figure, *_inline(folder / figure.file)) for figure in figures],
        metadata=list(_metadata_rows(recording, estimate, score)),
        scene=None if scene is None else json.dumps(scene, indent=2, ensure_ascii=False),
    )


def _notices(metadata: Mapping[str, Any]) -> Iterator[str]:
    warnings = metadata.get("warnings") or []
    yield from ([warnings] if isinstance(warnings, str) else map(str, warnings))
    if metadata.get("render_fallback_reason"):
        yield f"Rendered with the fallback backend: {metadata['render_fallback_reason']}"


def _headline(score: Score, title: str, quantity: str, statistic: str) -> dict[str, str]:
    spelled = {region: _spell(score.regions[region][quantity][statistic], statistic) for region in REGIONS}
    relative = score.regions["interior"][quantity].get("relative_rms")
    percent = statistic != "rms"
    return {
        "title": title if percent else f"{title}, rms error",
        "value": spelled["interior"],
        "units": "%" if percent else units_of(quantity),
        "whole": spelled["all"],
        "relative": "" if percent or relative is None else f"{format_percent(relative)} % of the true rms",
    }


def _spell(value: float | None, statistic: str) -> str:
    return format_number(value) if statistic == "rms" else format_percent(value)


def _rows(score: Score, region: str) -> Iterator[tuple[str, str, Mapping[str, float | int | None]]]:
    titles = {name: entry.title for name, entry in QUANTITIES.items()} | {ENDPOINT: "Velocity endpoint"}
    for name, title in {**titles, **(GROWTH_QUANTITIES if score.grows else {})}.items():
        if name in score.regions[region]:
            yield title, units_of(name), score.regions[region][name]


def _by_region(score: Score) -> dict[str, Any]:
    """Return the headings and rows of the table that sets all regions with any pixel beside each other."""
    known = [name for name in _BY_REGION if name in score.regions["all"]]
    shown = [name for name in known if score.grows or name not in GROWTH_QUANTITIES]
    return {
        "quantities": [(_SHORT.get(name) or QUANTITIES[name].symbol, units_of(name)) for name in shown],
        "rows": [
            (region, values["depth"], [values[name]["rms"] for name in shown], values[OUTLIERS])
            for region, values in score.regions.items()
            if values["depth"]["count"] or region in REGIONS
        ],
    }


def _settings(score: Score) -> dict[str, str]:
    """Return the settings of the score as text; those by default where the score does not say."""
    told = score.metadata.get("score_settings") or ScoreSettings().model_dump()
    contrast = [format_percent(bound) for bound in told["contrast_classes"]]
    return {
        "contrast_low": contrast[0],
        "contrast_high": contrast[1],
        "contrast_window": f"{told['contrast_window_px']:g}",
        "growth_window": f"{told['growth_window_px']:g}",
        "growth_coverage": format_percent(told["growth_min_coverage"]),
        "growth_slope": f"{told['growth_max_slope_deg']:g}",
    }


def _metadata_rows(recording: xr.Dataset, estimate: xr.Dataset, score: Score) -> Iterator[tuple[str, str]]:
    sizes = recording["image"].sizes
    yield (
        "recording",
        f"{sizes['s']} cameras × {sizes['t']} frames of {sizes['x']} × {sizes['y']} px, {recording['image'].dtype}",
    )
    for key, value in intrinsics_of(estimate).to_attrs().items():
        yield humanise(key), flatten(value)
    # A score may have been made apart from the recording; what the data sets say is then all that is known.
    known = {key: recording.attrs[key] for key in ("scene_hash", "seed", "render_backend") if key in recording.attrs}
    known |= {key: estimate.attrs[key] for key in ("method",) if key in estimate.attrs}
    for key, value in {**known, **score.metadata}.items():
        if key not in _SHOWN_ELSEWHERE and value is not None:
            yield humanise(key), flatten(value)


def _inline(file: Path) -> tuple[str, int]:
    """Return a picture as a data URL, and how wide to show it, so that all have letters of the same size."""
    content = file.read_bytes()
    # The width stands at this place of every PNG file's first chunk.
    (width,) = struct.unpack(">I", content[16:20])
    return "data:image/png;base64," + base64.b64encode(content).decode("ascii"), round(width * _SCREEN_SCALE)
