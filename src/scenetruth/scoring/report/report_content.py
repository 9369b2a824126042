"""The content of a report besides figures and viewer: headlines, tables, settings and summary sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.number_format import (
    UNDEFINED,
    format_measured,
    format_number,
    format_percent_value,
    format_share,
    format_two_digits,
    format_with_std,
)
from scenetruth.schema import REASONS
from scenetruth.scoring.alignment import iterate_aligned_blocks
from scenetruth.scoring.common_statistics import COMMON_STATISTICS
from scenetruth.scoring.quantities import ENDPOINT, OUTLIERS, QUANTITIES, get_title
from scenetruth.scoring.regions import REGIONS, describe_region, title_region
from scenetruth.scoring.report.hotspot_pictures import HotspotPicture
from scenetruth.scoring.report.map_summaries import MapSummary, format_value, get_units, main_summaries
from scenetruth.scoring.report.viewer import Viewer
from scenetruth.scoring.report.viewer_layers import ErrorHotspot
from scenetruth.scoring.score_result import Score, find_growing_objects, is_growth, select_summary_quantities
from scenetruth.scoring.statistics import RATES
from scenetruth.settings import ScoreSettings

__all__ = [
    "SummarySentence",
    "build_score_content",
    "describe_invalidity",
    "describe_noise",
    "interior_share",
    "list_empty_objects",
    "state_result",
    "summarise_estimate",
    "summarise_score",
]


_HEADLINES = (
    ("Depth", "depth", "rmse"),
    ("Disparity", "disparity", "rmse"),
    ("Velocity in Z", "velocity_z", "rmse"),
    ("Velocity endpoint", ENDPOINT, "rmse"),
    ("Normal", "normal", "rmse"),
    ("Growth rate", "growth_rate", "rmse"),
    ("Growth rate, windowed", "growth_rate_windowed", "rmse"),
    ("Density of depth", "depth", "density"),
    ("Scene flow outliers", OUTLIERS, "scene_flow_rate"),
)
_HEADLINES_OF_FLOW = (
    ("Optical flow in x", "flow_x", "rmse"),
    ("Optical flow in y", "flow_y", "rmse"),
    ("Density of optical flow", "flow_x", "density"),
)
"""Additional headlines of an estimate that has flow only."""
_BY_REGION = ("depth", "disparity", "normal", "velocity_z", ENDPOINT, "growth_rate", "growth_rate_windowed")
"""Quantities whose RMSE is shown for every region."""
_SHORT = {
    ENDPOINT: "U, endpoint",
    "normal": "normal",
    "growth_rate": "growth rate",
    "growth_rate_windowed": "growth, windowed",
}
_RATES = {"disparity_rate": "disparity", "flow_rate": "optical flow", "scene_flow_rate": "scene flow"}


def build_score_content(score: Score) -> dict[str, Any]:
    """Return the template values of a score, without figures and provenance."""
    shown = select_summary_quantities(score.regions, grows=score.grows)
    return {
        "headlines": list(_headlines(score, shown)),
        "regions": [(region, list(_rows(score, region, shown))) for region in REGIONS],
        "common": [(region, rows) for region in REGIONS if (rows := list(_common_rows(score, region, shown)))],
        "outliers": _outliers(score),
        "by_region": _by_region(score, shown),
        "margin": f"{score.metadata.get('margin_px', 20.0):g}",
        "settings": _settings(score),
        "shown": shown,
        "grows": score.grows,
    }


def interior_share(score: Score) -> float | None:
    """Return the fraction of the pixels with a surface that are in the interior; None if no quantity states it."""
    for name, whole in score.regions["all"].items():
        inner = score.regions["interior"][name]
        numbers = [values.get(key) for values in (inner, whole) for key in ("count", "density")]
        if all(numbers):
            count, density, of_all, density_of_all = (float(number or 0.0) for number in numbers)
            return min(count / density / (of_all / density_of_all), 1.0)
    return None


def list_empty_objects(names: Sequence[str], regions: Iterable[str]) -> list[str]:
    """Return the objects without a region of their own; the region of a single object is the whole surface.

    >>> list_empty_objects(["leaf", "soil"], ["all", "object_leaf"]), list_empty_objects(["cube"], ["all"])
    (['soil'], [])
    """
    found = set(regions)
    return [name for name in names if len(names) > 1 and f"object_{name}" not in found]


def describe_invalidity(estimate: xr.Dataset, truth: xr.Dataset) -> str:
    """Return the reasons for invalid pixels with their fractions of the surface; empty if none are stated."""
    if "invalid_reason" not in estimate:
        return ""
    counts, size = np.zeros(len(REASONS), dtype=np.int64), 0
    for part, reference in iterate_aligned_blocks(estimate, truth):
        values = np.nan_to_num(part["invalid_reason"].values, nan=REASONS.index("not_determined")).astype(np.int64)
        values = values[np.isfinite(reference["depth"].values)]
        counts += np.bincount(values, minlength=len(REASONS))
        size += values.size
    if not size:
        return ""
    shares = sorted(((count / size, name) for name, count in zip(REASONS, counts.tolist(), strict=True)), reverse=True)
    return ", ".join(
        f"{_REASONS.get(name, name.replace('_', ' '))} {100 * share:.1f} %"
        for share, name in shares
        if name != "none" and share >= _LEAST_SHARE
    )


_LEAST_SHARE = 5e-4
_REASONS = {"border": "border of the image"}


def _headlines(score: Score, shown: list[str]) -> Iterator[dict[str, str]]:
    further = () if "velocity_z" in shown or "depth" in shown else _HEADLINES_OF_FLOW
    for title, quantity, statistic in (*_HEADLINES, *further):
        # Outlier rates are present only where they are meaningful.
        values = score.regions["all"].get(quantity, {})
        if values.get(statistic) is not None and quantity in (*shown, OUTLIERS):
            yield _headline(score, title, quantity, statistic)


def _headline(score: Score, title: str, quantity: str, statistic: str) -> dict[str, str]:
    spelled = {region: _spell(score.regions[region][quantity][statistic], statistic) for region in REGIONS}
    relative = score.regions["interior"][quantity].get("relative_rmse")
    percent = statistic != "rmse"
    return {
        "title": title if percent else f"{title}, RMSE",
        "value": spelled["interior"],
        "units": "%" if percent else get_units(quantity),
        "whole": spelled["all"],
        "relative": "" if percent or relative is None else _share_of(relative, "the true RMS"),
    }


def _spell(value: float | None, statistic: str) -> str:
    return format_number(value) if statistic == "rmse" else format_percent_value(value)


def _rows(score: Score, region: str, shown: list[str]) -> Iterator[tuple[str, str, Mapping[str, float | int | None]]]:
    for name in shown:
        yield get_title(name), get_units(name), score.regions[region][name]


def _common_rows(
    score: Score, region: str, shown: list[str]
) -> Iterator[tuple[str, str, Mapping[str, float | int | None]]]:
    """Yield the rows of quantities with a stated common part of their standard deviations."""
    yield from (row for row in _rows(score, region, shown) if set(COMMON_STATISTICS) <= set(row[2]))


def _outliers(score: Score) -> dict[str, Any]:
    """Return headings and rows of the outlier table; without headings if no rate is meaningful."""
    entries = [rate for rate in RATES[:-1] if rate in score.regions["all"].get(OUTLIERS, {})]
    return {
        "headings": [_RATES[rate] for rate in entries],
        "rows": [
            (
                region,
                [score.regions[region][OUTLIERS][rate] for rate in entries],
                score.regions[region][OUTLIERS]["count"],
            )
            for region in (REGIONS if entries else ())
        ],
    }


def _by_region(score: Score, shown: list[str]) -> dict[str, Any]:
    """Return the headings and rows of the table that compares all non-empty regions."""
    names = [name for name in _BY_REGION if name in shown] or shown
    # Densities and counts are those of the quantity on which the majority of the others depend.
    first = "depth" if "depth" in shown else shown[0]
    rate = "scene_flow_rate" if "scene_flow_rate" in score.regions["all"].get(OUTLIERS, {}) else None
    return {
        "first": get_title(first).lower(),
        "quantities": [(_SHORT.get(name) or QUANTITIES[name].symbol, get_units(name)) for name in names],
        "rate": rate is not None,
        "rows": [
            (
                title_region(region),
                values[first],
                [values[name]["rmse"] for name in names],
                None if rate is None else values[OUTLIERS][rate],
            )
            for region, values in score.regions.items()
            if values[first]["count"] or region in REGIONS
        ],
    }


def _settings(score: Score) -> dict[str, str]:
    """Return the settings of the score as text, by default the default settings."""
    defaults = ScoreSettings()
    entries = score.metadata.get("score_settings") or defaults.model_dump()
    contrast = [format_percent_value(bound) for bound in entries["contrast_classes"]]
    return {
        "contrast_low": contrast[0],
        "contrast_high": contrast[1],
        "contrast_window": f"{entries['contrast_window_px']:g}",
        "specular_share": format_percent_value(entries.get("specular_share", defaults.specular_share)),
        "shadow_width": f"{entries.get('shadow_width_px', defaults.shadow_width_px):g}",
        "growth_window": f"{entries['growth_window_px']:g}",
        "growth_coverage": format_percent_value(entries["growth_min_coverage"]),
        "growth_slope": f"{entries['growth_max_slope_deg']:g}",
    }


_FEW = 100
"""Minimum number of scored pixels of a region for the summary."""

_LEAST_DENSITY = 0.1
"""Minimum density of a region for the summary: the pixels of an almost invalid region are not typical of it."""

Values = Mapping[str, float | int | None]


@dataclass(frozen=True)
class SummarySentence:
    """One entry of the summary: subject, number and text; position, viewer layer and picture of the largest errors.

    ``relative``: RMSE over the RMS of the truth, None where this is undefined. ``whole``: RMSE over all scored pixels.
    """

    title: str
    figure: str
    units: str
    rest: str
    place: ErrorHotspot | None = None
    layer: str = ""
    picture: HotspotPicture | None = None
    relative: float | None = None
    whole: str = ""

    @property
    def has_figure(self) -> bool:
        """Whether there is an error."""
        return self.figure != UNDEFINED

    @property
    def is_measured(self) -> bool:
        """Whether there is an error, and it is smaller than the quantity."""
        return self.has_figure and (self.relative is None or self.relative < 1)

    @property
    def where(self) -> str:
        """The position as text."""
        if self.place is None:
            return ""
        side = f"{self.place.side_px:.0f}"
        return (
            f"Largest errors of the map: {format_number(self.place.rmse)} {self.units} RMSE over {side} × {side} px, "
            f"near x = {self.place.x:g} px, y = {self.place.y:g} px."
        )

    @property
    def legend(self) -> str:
        """The meaning of the colours of the picture."""
        if self.picture is None:
            return ""
        limit = f"{format_number(self.picture.limit, 2)} {self.units}"
        colours = f"red: {limit} and more" if self.is_length else f"blue: −{limit} and less; red: {limit} and more"
        error = "length of the error" if self.is_length else "error"
        side = (
            ""
            if self.place is None
            else f" with the largest RMSE ({self.place.side_px:.0f} × {self.place.side_px:.0f} px)"
        )
        return f"Left: image. Right: {error}; {colours}; hatched: invalid. Square: the part{side}."

    @property
    def limit(self) -> str:
        """The error of the strongest colour of the picture, without its unit."""
        return "" if self.picture is None else format_number(self.picture.limit, 2)

    @property
    def is_length(self) -> bool:
        """Whether the error of the picture is that of a vector, which has no sign."""
        return "epe" in self.layer or "endpoint" in self.layer


def summarise_score(score: Score, viewer: Viewer) -> list[SummarySentence]:
    """Return one sentence each about depth, motion and growth, as available.

    Where some objects grow and others do not, the number of growth is that of the objects that grow.
    """
    return [*_shape_sentence(score, viewer), *_motion_sentence(score, viewer), *_growth_sentence(score, viewer)]


def state_result(sentences: Sequence[SummarySentence], method: str, interior: float | None = None) -> str:
    """Return the result as sentences, for the beginning of the page; empty if no quantity has a number.

    ``interior``: Fraction of the pixels with a surface that are in the interior.

    >>> depth = SummarySentence("Depth", "0.107", "mm", "RMSE in the interior.", whole="2.30")
    >>> motion = SummarySentence("Motion", "0.0336", "mm/frame", "RMSE.", relative=0.1, whole="0.0500")
    >>> growth = SummarySentence("Growth", "60.0", "%/h", "RMSE.", relative=47.0)
    >>> first, second = state_result([depth, motion, growth], "refined", 0.4).split(". ")
    >>> for part in first.split(" (")[0], first.split("over ")[1]:
    ...     print(part)
    The method refined measures depth to 0.107 mm and motion to 0.0336 mm/frame
    all valid pixels: 2.30 mm and 0.0500 mm/frame), relative to the exact truth
    >>> second
    'Growth is not measurable here: the error is 47 times the true value.'
    """
    found = [one for one in sentences if one.is_measured]
    lost = [one for one in sentences if one.has_figure and not one.is_measured]
    none = [one for one in sentences if not one.has_figure]
    texts = []
    if found:
        subject, verb = (f"The method {method}", "measures") if method else ("The estimate", "gives")
        listed = _join(f"{_lower(one.title)} to {one.figure} {one.units}" for one in found)
        share = "" if interior is None else f", {format_percent_value(interior)} % of the surface"
        whole = [f"{one.whole} {one.units}" for one in found if one.whole]
        over_all = f"; over all valid pixels: {_join(whole)}" if whole else ""
        region = f"RMSE in the interior{share}{over_all}"
        if interior == 1 and all(one.whole in ("", one.figure) for one in found):
            region = "RMSE over all valid pixels"
        texts.append(f"{subject} {verb} {listed} ({region}), relative to the exact truth.")
    if lost:
        names = _join(_lower(one.title) for one in lost)
        factors = _join(format_two_digits(one.relative or 0.0) for one in lost)
        verb, errors, values = ("are", "errors are", "values") if len(lost) > 1 else ("is", "error is", "value")
        text = f"{names[0].upper()}{names[1:]} {verb} not measurable here"
        texts.append(f"{text}: the {errors} {factors} times the true {values}.")
    if texts:
        texts += [f"{one.title} is not scored: {one.rest}" for one in none]
    return " ".join(texts)


def _lower(title: str) -> str:
    return f"{title[0].lower()}{title[1:]}"


def _join(texts: Iterable[str]) -> str:
    """Return a list in words."""
    *most, last = texts
    return f"{', '.join(most)} and {last}" if most else last


def summarise_estimate(summaries: Mapping[str, MapSummary]) -> list[SummarySentence]:
    """Return one sentence each about depth, motion and growth of an estimate without truth.

    Growth is omitted if its standard deviation is unknown.
    """
    found = []
    for entries in main_summaries(summaries):
        bar = ""
        if entries.median_std is not None:
            bar = f", with a median stated standard deviation of {format_number(entries.median_std, 2)} {entries.units}"
        if entries.median_common is not None:
            bar += f" (common to all pixels: {format_number(entries.median_common, 2)} {entries.units})"
        rest = (
            f"is the median{bar}; 90 % of the values lie between {format_value(entries.low, entries.median_std)} "
            f"and {format_value(entries.high, entries.median_std)} {entries.units}. "
            f"The density is {format_percent_value(entries.density)} % of all pixels."
        )
        middle = format_value(entries.median, entries.median_std)
        found.append(SummarySentence(entries.title, middle, entries.units, rest))
    return found


def describe_noise(summaries: Mapping[str, MapSummary]) -> dict[str, Any]:
    """Return the medians with the standard deviation of a pixel, and a sentence on those that it exceeds."""
    found = main_summaries(summaries)
    medians = []
    for entries in found:
        std = entries.median_std
        value = format_measured(entries.median, std) if std is None else format_with_std(entries.median or 0.0, std)
        value = f"({value})" if std is not None and entries.units and not value.startswith("(") else value
        medians.append(f"{_lower(entries.title)} {value} {entries.units}".rstrip())
    hidden = [
        _lower(entries.title)
        for entries in found
        if entries.median is not None and entries.median_std is not None and abs(entries.median) < entries.median_std
    ]
    return {
        "medians": ", ".join(medians),
        "stated": any(entries.median_std is not None for entries in found),
        "hidden": f"{_hidden_by_noise(hidden)} smaller than the standard deviation of a pixel." if hidden else "",
    }


def _hidden_by_noise(titles: Sequence[str]) -> str:
    return f"The medians of {_join(titles)} are" if len(titles) > 1 else f"The median of {titles[0]} is"


_MOST_SPREADS = 10
"""Ratio of an error to the standard deviation of the truth up to which it is stated."""


def _shape_sentence(score: Score, viewer: Viewer) -> Iterator[SummarySentence]:
    name = next((name for name in ("depth", "disparity", "normal") if name in score.regions["all"]), None)
    if name is None:
        return
    values = score.regions["interior"][name]
    signal = _signal(values, name)
    spread = viewer.spread.get(name, 0.0)
    rms = values["rmse"]
    # A surface without relief has nothing to compare with.
    if rms is not None and 0 < rms <= _MOST_SPREADS * spread:
        varies = f"{format_percent_value(rms / spread)} % of the standard deviation of the true {name}"
        signal += f"{' and ' if signal else ''}{varies}"
    title = {"depth": "Depth", "disparity": "Disparity", "normal": "Normal"}[name]
    yield _sentence(score, viewer, title, name, signal)


def _motion_sentence(score: Score, viewer: Viewer) -> Iterator[SummarySentence]:
    regions = score.regions
    if ENDPOINT in regions["all"]:
        inner = regions["interior"]
        signal = ", ".join(filter(None, (_signal(inner[ENDPOINT], ENDPOINT), _dominant_component(inner))))
        yield _sentence(score, viewer, "Motion", ENDPOINT, signal)
    elif "flow_x" in regions["all"]:
        rms = _length(regions["interior"])
        truth = math.hypot(*(_true_rms(regions["interior"][name]) or 0.0 for name in ("flow_x", "flow_y")))
        signal = _share_of(rms / truth, "the true flow") if rms is not None and truth else ""
        worst = _worst_region({region: _length(values) for region, values in _large(score, "flow_x")}, "px/frame")
        yield SummarySentence(
            "Optical flow",
            format_number(rms),
            "px/frame",
            _tail(signal, rms, _length(regions["all"]), "px/frame", worst),
            viewer.worst.get("flow"),
            "flow_endpoint:error",
            viewer.pictures.get("flow"),
            rms / truth if rms is not None and truth else None,
            format_number(_length(regions["all"])),
        )


def _growth_sentence(score: Score, viewer: Viewer) -> Iterator[SummarySentence]:
    if not score.grows:
        return
    rates = [score.regions["interior"].get(name, {}) for name in ("growth_rate", "growth_rate_windowed")]
    if not any(is_growth(values.get("relative_rmse")) or values.get("rmse") == 0 for values in rates):
        # The error of surfaces that do not grow is not that of those that do.
        yield SummarySentence("Growth", UNDEFINED, "", "no surface that grows is scored in the interior.")
        return
    for name, title in (("growth_rate", "Growth"), ("growth_rate_windowed", "Growth")):
        # Attenuation by windows is not an error of the estimate; the position is that of the layer in the viewer.
        shown = name if name in viewer.worst else "growth_rate_windowed"
        if name in score.regions["all"] and score.regions["interior"][name]["count"]:
            sentence = _sentence(score, viewer, title, name, _signal(score.regions["interior"][name], name), shown)
            yield _of_growing_objects(score, sentence, name)
            return


def _of_growing_objects(score: Score, sentence: SummarySentence, name: str) -> SummarySentence:
    """Return the sentence about growth with the number of the objects that grow, if others do not."""
    growing = find_growing_objects(score.regions)
    values = {} if growing is None else growing.values(score.regions, name)
    if growing is None or not values["count"]:
        return sentence
    signal = _signal(values, name)
    rest = (
        f"RMSE in the interior of {growing.names}{f', {signal}' if signal else ''}; "
        f"{sentence.figure} {sentence.units} with the objects that do not grow."
    )
    worst = sentence.rest.partition(". ")[2]
    return replace(
        sentence,
        title=f"{sentence.title} of {growing.names}",
        figure=format_number(values["rmse"]),
        rest=f"{rest} {worst}".rstrip(),
    )


def _sentence(
    score: Score, viewer: Viewer, title: str, name: str, signal: str, shown: str | None = None
) -> SummarySentence:
    units = get_units(name)
    worst = _worst_region({region: values[name]["rmse"] for region, values in _large(score, name)}, units)
    rms = score.regions["interior"][name]["rmse"]
    place = shown or name
    return SummarySentence(
        title,
        format_number(rms),
        units,
        _tail(signal, rms, score.regions["all"][name]["rmse"], units, worst),
        viewer.worst.get(place),
        f"{place}:error",
        viewer.pictures.get(place),
        score.regions["interior"][name].get("relative_rmse"),
        format_number(score.regions["all"][name]["rmse"]),
    )


def _tail(signal: str, rms: float | None, whole: float | None, units: str, worst: str) -> str:
    over_all = "" if whole is None else f"ver all valid pixels: {format_number(whole)} {units}"
    if rms is None:
        text = f"no pixel of the interior has a valid value{over_all and '; o'}{over_all}{over_all and ' RMSE'}."
    else:
        text = "RMSE in the interior" + (f", {signal}" if signal else "") + "."
        if whole is not None:
            smaller = " (less than in the interior: edges do not dominate this error)" if whole < rms else ""
            text += f" O{over_all}{smaller}."
    return f"{text} Region with the largest RMSE: {worst}." if worst else text


def _signal(values: Values, name: str) -> str:
    """Return the error relative to the true value as text."""
    truth, relative = _true_rms(values), values.get("relative_rmse")
    if truth is None or relative is None:
        return ""
    return _share_of(relative, f"the true value of {format_number(truth)} {get_units(name)} (RMS)")


def _share_of(fraction: float, reference: str) -> str:
    """Return an error relative to a reference: as a percentage, or as a factor."""
    return f"{format_share(fraction)} {'of ' if fraction < 2 else ''}{reference}"


def _true_rms(values: Values) -> float | None:
    rms, relative = values.get("rmse"), values.get("relative_rmse")
    return rms / relative if rms and relative else None


def _dominant_component(values: Mapping[str, Values]) -> str:
    """Return the component of the velocity with at least half of the squared error; empty if there is none."""
    whole = values[ENDPOINT]["rmse"]
    for axis in "xyz":
        part = values.get(f"velocity_{axis}", {}).get("rmse")
        if whole and part and part**2 >= 0.5 * whole**2:
            share = part**2 / whole**2
            percent = "over 99" if share > 0.99 else f"{100 * share:.0f}"
            return f"mainly in {axis.upper()} ({percent} % of the mean square)"
    return ""


def _length(values: Mapping[str, Values]) -> float | None:
    parts = [values[name]["rmse"] for name in ("flow_x", "flow_y")]
    known = [part for part in parts if part is not None]
    return math.hypot(*known) if len(known) == len(parts) else None


def _large(score: Score, name: str) -> Iterator[tuple[str, Mapping[str, Values]]]:
    """Yield the further regions with enough scored pixels, of which the region is not nearly empty."""
    for region, values in score.regions.items():
        enough = (values[name]["count"] or 0) >= _FEW and (values[name].get("density") or 0.0) >= _LEAST_DENSITY
        if region not in REGIONS and enough:
            yield region, values


def _worst_region(errors: Mapping[str, float | None], units: str) -> str:
    known = {region: rms for region, rms in errors.items() if rms is not None}
    if len(known) < 2:
        return ""
    region = max(known, key=lambda region: known[region])
    return f"{describe_region(region)}, {format_number(known[region])} {units}"
