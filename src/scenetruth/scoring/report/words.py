"""The answer in a few sentences, with which the page begins: how large errors are, beside what, and where."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from scenetruth.scoring._format import format_number, format_percent
from scenetruth.scoring.quantities import ENDPOINT, units_of
from scenetruth.scoring.regions import REGIONS
from scenetruth.scoring.report.maps import MapSummary
from scenetruth.scoring.report.viewer.content import Viewer
from scenetruth.scoring.report.viewer.places import Place
from scenetruth.scoring.score import Score

__all__ = ["Sentence", "sentences_of_estimate", "sentences_of_score"]

_FEW = 100
"""Regions with fewer scored pixels say little about where errors are large."""

Values = Mapping[str, float | int | None]


@dataclass(frozen=True)
class Sentence:
    """One part of the answer.

    Parameters
    ----------
    title
        What it is about.
    figure, units
        The number that matters most, spelled, and its units.
    rest
        What follows it.
    place
        Where errors are largest, if that is known.
    layer
        The viewer's name of the map that shows it there.
    """

    title: str
    figure: str
    units: str
    rest: str
    place: Place | None = None
    layer: str = ""

    @property
    def where(self) -> str:
        """The place in words."""
        if self.place is None:
            return ""
        side = f"{self.place.side_px:.0f}"
        return (
            f"by place worst around x = {self.place.x:g}, y = {self.place.y:g} px "
            f"({format_number(self.place.rms)} {self.units} within {side} × {side} px)"
        )


def sentences_of_score(score: Score, viewer: Viewer) -> list[Sentence]:
    """Return a sentence each about depth, motion and growth, of what the estimate holds."""
    return [*_shape(score, viewer), *_motion(score, viewer), *_growth(score, viewer)]


def sentences_of_estimate(summaries: Mapping[str, MapSummary]) -> list[Sentence]:
    """Return a sentence each about depth, motion and growth of an estimate without truth."""
    found = []
    wanted = (("depth", "disparity"), ("velocity_z", "flow_x"), ("growth_rate",))
    for names in wanted:
        name = next((name for name in names if name in summaries and summaries[name].count), None)
        if name is None:
            continue
        told = summaries[name]
        bar = (
            ""
            if told.median_std is None
            else f", with a median error bar of {format_number(told.median_std)} {told.units}"
        )
        rest = (
            f"is the median{bar}; 90 % of the values lie between {format_number(told.low)} and "
            f"{format_number(told.high)} {told.units}. It is known at {format_percent(told.density)} % of all pixels."
        )
        found.append(Sentence(told.title, format_number(told.median), told.units, rest))
    return found


def _shape(score: Score, viewer: Viewer) -> Iterator[Sentence]:
    name = next((name for name in ("depth", "disparity", "normal") if name in score.regions["all"]), None)
    if name is None:
        return
    values = score.regions["interior"][name]
    signal = _signal(values, name)
    spread = viewer.spread.get(name, 0.0)
    rms = values["rms"]
    if spread and rms is not None:
        varies = f"{format_percent(rms / spread)} % of the standard deviation of the true {name} there"
        signal += f"{' and ' if signal else ''}{varies}"
    title = {"depth": "Depth", "disparity": "Disparity", "normal": "Normal"}[name]
    yield _sentence(score, viewer, title, name, signal)


def _motion(score: Score, viewer: Viewer) -> Iterator[Sentence]:
    regions = score.regions
    if ENDPOINT in regions["all"]:
        yield _sentence(score, viewer, "Motion", ENDPOINT, _signal(regions["interior"][ENDPOINT], ENDPOINT))
    elif "flow_x" in regions["all"]:
        rms = _length(regions["interior"])
        truth = math.hypot(*(_true_rms(regions["interior"][name]) or 0.0 for name in ("flow_x", "flow_y")))
        signal = f"{format_percent(rms / truth)} % of the true flow" if rms is not None and truth else ""
        worst = _worst_region({region: _length(values) for region, values in _large(score, "flow_x")}, "px/frame")
        yield Sentence(
            "Motion in the image",
            format_number(rms),
            "px/frame",
            _tail(signal, worst),
            viewer.worst.get("flow"),
            "flow_endpoint:error",
        )


def _growth(score: Score, viewer: Viewer) -> Iterator[Sentence]:
    if not score.grows:
        return
    for name, title in (("growth_rate", "Growth"), ("growth_rate_windowed", "Growth")):
        # What windows smooth away is no error of the estimate; the place is told of what the viewer shows.
        shown = name if name in viewer.worst else "growth_rate_windowed"
        if name in score.regions["all"] and score.regions["interior"][name]["count"]:
            yield _sentence(score, viewer, title, name, _signal(score.regions["interior"][name], name), shown)
            return


def _sentence(score: Score, viewer: Viewer, title: str, name: str, signal: str, shown: str | None = None) -> Sentence:
    units = units_of(name)
    worst = _worst_region({region: values[name]["rms"] for region, values in _large(score, name)}, units)
    rms = score.regions["interior"][name]["rms"]
    place = shown or name
    return Sentence(title, format_number(rms), units, _tail(signal, worst), viewer.worst.get(place), f"{place}:error")


def _tail(signal: str, worst: str) -> str:
    text = "rms error in the interior"
    return text + (f", {signal}" if signal else "") + (f"; of all regions, it is largest {worst}" if worst else "")


def _signal(values: Values, name: str) -> str:
    """Return what the error is a part of."""
    truth, relative = _true_rms(values), values.get("relative_rms")
    if truth is None or relative is None:
        return ""
    return f"{format_percent(relative)} % of the true value (rms {format_number(truth)} {units_of(name)})"


def _true_rms(values: Values) -> float | None:
    rms, relative = values.get("rms"), values.get("relative_rms")
    return rms / relative if rms and relative else None


def _length(values: Mapping[str, Values]) -> float | None:
    parts = [values[name]["rms"] for name in ("flow_x", "flow_y")]
    known = [part for part in parts if part is not None]
    return math.hypot(*known) if len(known) == len(parts) else None


def _large(score: Score, name: str) -> Iterator[tuple[str, Mapping[str, Values]]]:
    """Give the regions, but the two that all scores have, in which enough pixels are scored."""
    for region, values in score.regions.items():
        if region not in REGIONS and (values[name]["count"] or 0) >= _FEW:
            yield region, values


def _worst_region(errors: Mapping[str, float | None], units: str) -> str:
    known = {region: rms for region, rms in errors.items() if rms is not None}
    if len(known) < 2:
        return ""
    region = max(known, key=lambda region: known[region])
    return f"{_spell(region)} ({format_number(known[region])} {units})"


def _spell(region: str) -> str:
    """Return where a region is, in words.

    Examples
    --------
    >>> _spell("edge_0_5"), _spell("edge_20_inf"), _spell("slope_45_70"), _spell("object_leaf 3")
    ('within 0 to 5 px of an edge', 'from 20 px from an edge on', 'on slopes of 45 to 70°', 'on the object “leaf 3”')
    """
    fixed = {
        "visible": "where all images see the point",
        "partly_hidden": "where some image does not see the point",
        "contrast_low": "where contrast is low",
        "contrast_mid": "where contrast is middling",
        "contrast_high": "where contrast is high",
    }
    if region in fixed:
        return fixed[region]
    if region.startswith("object_"):
        return f"on the object “{region.removeprefix('object_')}”"
    bounds = re.fullmatch(r"(slope|edge)_([^_]+)_([^_]+)", region)
    if bounds is None:
        return f"in the region “{region}”"
    kind, low, high = bounds.groups()
    if kind == "slope":
        return f"on slopes of {low} to {high}°"
    return f"from {low} px from an edge on" if high == "inf" else f"within {low} to {high} px of an edge"
