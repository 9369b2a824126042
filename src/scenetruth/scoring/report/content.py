"""What the page of a score shows, besides figures: headlines, tables and settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenetruth.scoring._format import format_number, format_percent
from scenetruth.scoring.outliers import RATES
from scenetruth.scoring.quantities import ENDPOINT, OUTLIERS, QUANTITIES, title_of, units_of
from scenetruth.scoring.regions import REGIONS
from scenetruth.scoring.score import Score
from scenetruth.scoring.summary import shown_quantities
from scenetruth.settings import ScoreSettings

__all__ = ["content_of_score"]

_HEADLINES = (
    ("Depth", "depth", "rms"),
    ("Disparity", "disparity", "rms"),
    ("Velocity in Z", "velocity_z", "rms"),
    ("Velocity endpoint", ENDPOINT, "rms"),
    ("Normal", "normal", "rms"),
    ("Growth rate", "growth_rate", "rms"),
    ("Growth rate, windowed", "growth_rate_windowed", "rms"),
    ("Density of depth", "depth", "density"),
    ("Scene flow outliers", OUTLIERS, "scene_flow_rate"),
)
_HEADLINES_OF_FLOW = (
    ("Optical flow in x", "flow_x", "rms"),
    ("Optical flow in y", "flow_y", "rms"),
    ("Density of optical flow", "flow_x", "density"),
)
"""Of an estimate without depth and velocity, flow is all that there is."""
_BY_REGION = ("depth", "disparity", "normal", "velocity_z", ENDPOINT, "growth_rate", "growth_rate_windowed")
"""Quantities whose rms errors are shown for every region."""
_SHORT = {
    ENDPOINT: "U, endpoint",
    "normal": "normal",
    "growth_rate": "growth rate",
    "growth_rate_windowed": "growth, windowed",
}
_RATES = {"disparity_rate": "disparity", "flow_rate": "optical flow", "scene_flow_rate": "scene flow"}


def content_of_score(score: Score) -> dict[str, Any]:
    """Return what the template of a score shows, apart from figures and origin."""
    shown = shown_quantities(score.regions, grows=score.grows)
    return {
        "headlines": list(_headlines(score, shown)),
        "regions": [(region, list(_rows(score, region, shown))) for region in REGIONS],
        "outliers": _outliers(score),
        "by_region": _by_region(score, shown),
        "margin": f"{score.metadata.get('margin_px', 20.0):g}",
        "settings": _settings(score),
        "shown": shown,
        "grows": score.grows,
    }


def _headlines(score: Score, shown: list[str]) -> Iterator[dict[str, str]]:
    further = () if "velocity_z" in shown or "depth" in shown else _HEADLINES_OF_FLOW
    for title, quantity, statistic in (*_HEADLINES, *further):
        # A rate of outliers is there only where it says something.
        if quantity in shown or (quantity == OUTLIERS and statistic in score.regions["all"].get(OUTLIERS, {})):
            yield _headline(score, title, quantity, statistic)


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


def _rows(score: Score, region: str, shown: list[str]) -> Iterator[tuple[str, str, Mapping[str, float | int | None]]]:
    for name in shown:
        yield title_of(name), units_of(name), score.regions[region][name]


def _outliers(score: Score) -> dict[str, Any]:
    """Return headings and rows of the table of outliers; without headings where no rate says anything."""
    told = [rate for rate in RATES[:-1] if rate in score.regions["all"].get(OUTLIERS, {})]
    return {
        "headings": [_RATES[rate] for rate in told],
        "rows": [
            (region, [score.regions[region][OUTLIERS][rate] for rate in told], score.regions[region][OUTLIERS]["count"])
            for region in (REGIONS if told else ())
        ],
    }


def _by_region(score: Score, shown: list[str]) -> dict[str, Any]:
    """Return the headings and rows of the table that sets all regions with any pixel beside each other."""
    names = [name for name in _BY_REGION if name in shown] or shown
    # Densities and counts are those of what most of the others follow from.
    first = "depth" if "depth" in shown else shown[0]
    rate = "scene_flow_rate" if "scene_flow_rate" in score.regions["all"].get(OUTLIERS, {}) else None
    return {
        "first": title_of(first).lower(),
        "quantities": [(_SHORT.get(name) or QUANTITIES[name].symbol, units_of(name)) for name in names],
        "rate": rate is not None,
        "rows": [
            (
                region,
                values[first],
                [values[name]["rms"] for name in names],
                None if rate is None else values[OUTLIERS][rate],
            )
            for region, values in score.regions.items()
            if values[first]["count"] or region in REGIONS
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
