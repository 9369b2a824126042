"""The score of an estimate against the truth, and its spellings as JSON, table and CSV."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import ValidationError

from scenetruth.errors import Problem, ScoreError
from scenetruth.scoring.alignment import align, check_recording
from scenetruth.scoring.contrast import local_contrast, reference_images
from scenetruth.scoring.growth import growth_pairs
from scenetruth.scoring.quantities import ENDPOINT, GROWTH_QUANTITIES, OUTLIERS, QUANTITIES, read_pairs, units_of
from scenetruth.scoring.regions import REGIONS, further_regions, is_further_region, region_masks, seen_throughout
from scenetruth.scoring.statistics import RATES, STATISTICS, region_statistics
from scenetruth.settings import ScoreSettings

if TYPE_CHECKING:
    import pandas as pd  # type: ignore[import-untyped]

__all__ = ["Score", "score", "score_settings"]

_COLUMNS = (*STATISTICS[:-1], *RATES)


_EXPECTED = {**dict.fromkeys((*QUANTITIES, ENDPOINT), STATISTICS), OUTLIERS: RATES}
"""The statistics of every quantity that each score has."""

_GROWTH = set(GROWTH_QUANTITIES)


_ROUNDING = 1e9
"""Errors that are so many times larger than the truth have only roundings for a truth."""


@dataclass(frozen=True)
class Score:
    """The figures of merit of one estimate.

    Parameters
    ----------
    regions
        Region to quantity to statistic to value; None where a value is undefined. Errors are estimate minus truth, in
        the units of the quantity; ``density``, ``relative_rms``, ``within_2_std`` and rates are fractions, and
        ``calibration`` is a ratio. ``all`` and ``interior`` come first; which others there are depends on the truth.
    metadata
        What the score was made from, as plain JSON values.
    """

    regions: Mapping[str, Mapping[str, Mapping[str, float | int | None]]]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def grows(self) -> bool:
        """Whether any true growth rate is more than rounding; of what moves rigidly, growth is not worth showing."""
        error = self.regions["all"].get("growth_rate", {}).get("relative_rms")
        return error is not None and error < _ROUNDING

    def to_json(self) -> str:
        """Return strict JSON with the regions and ``metadata`` as its top-level keys."""
        return json.dumps({**self.regions, "metadata": self.metadata}, indent=2, allow_nan=False, ensure_ascii=False)

    @classmethod
    def from_json(cls, text: str) -> Score:
        """Read what `to_json` wrote.

        Raises
        ------
        ScoreError
            If the text is not JSON, lacks ``all`` or ``interior``, or a quantity or statistic of any region, or has
            keys that are no region's name; lists all that is wrong.
        """
        try:
            content = json.loads(text)
        except json.JSONDecodeError as error:
            raise ScoreError([Problem("", f"is not JSON: {error}", text)]) from error
        if not isinstance(content, dict):
            raise ScoreError([Problem("", "must be a JSON object", content)])
        keys = (*REGIONS, "metadata")
        problems = [
            Problem(key, "must be a JSON object", content.get(key))
            for key in keys
            if not isinstance(content.get(key), dict)
        ]
        further = [key for key in content if is_further_region(key)]
        problems += [
            Problem(key, "must be a JSON object", content[key]) for key in further if not _is_map(content[key])
        ]
        problems += [
            Problem(key, f"is not one of the keys {keys}, and no further region")
            for key in content
            if key not in keys and key not in further
        ]
        regions = [*REGIONS, *further]
        grows = any(_is_map(content.get(region)) and _GROWTH & set(content[region]) for region in regions)
        expected = _EXPECTED | (dict.fromkeys(GROWTH_QUANTITIES, STATISTICS) if grows else {})
        problems += [
            Problem(f"{region}.{quantity}.{statistic}", "is missing")
            for region in regions
            for quantity, statistics in expected.items()
            for statistic in statistics
            if not _has(content.get(region), quantity, statistic)
        ]
        if problems:
            raise ScoreError(problems)
        return cls(regions={region: content[region] for region in regions}, metadata=content["metadata"])

    def to_frame(self) -> pd.DataFrame:
        """Return a table.

        Returns
        -------
        pandas.DataFrame
            One row for each region and quantity (its two index levels), a column ``units``, and one column for each
            statistic; NaN where a statistic is undefined or does not belong to the quantity.
        """
        import pandas as pd

        rows = {
            (region, quantity): {"units": units_of(quantity)}
            | {column: math.nan if values.get(column) is None else values[column] for column in _COLUMNS}
            for region, quantities in self.regions.items()
            for quantity, values in quantities.items()
        }
        index = pd.MultiIndex.from_tuples(list(rows), names=["region", "quantity"])
        return pd.DataFrame(list(rows.values()), index=index, columns=["units", *_COLUMNS])

    def to_csv(self) -> str:
        """Return the table of `to_frame` as comma-separated values with a header, undefined values left empty."""
        return str(self.to_frame().to_csv(lineterminator="\n"))


def score_settings(**settings: Any) -> ScoreSettings:
    """Validate the settings of a score.

    Raises
    ------
    ScoreError
        With every setting that is unknown or impossible.
    """
    try:
        return ScoreSettings(**settings)
    except ValidationError as error:
        problems = [
            Problem(".".join(map(str, entry["loc"])), entry["msg"].removeprefix("Value error, "), entry.get("input"))
            for entry in error.errors()
        ]
        raise ScoreError(problems, source="settings") from error


def score(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None = None,
    *,
    margin_px: float | None = None,
    metadata: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Score:
    """Score an estimate against the truth.

    In each of the regions ``all`` and ``interior`` (see `region_masks`), and in those of visibility, slope, distance to
    edges and contrast that the truth can tell (see `further_regions`), the errors e = estimate - truth of depth,
    disparity, the three components of velocity and the two of optical flow are summed up over all frames of the
    estimate as bias, rms, median and 95th percentile of abs(e), relative rms, density and count (see
    `error_statistics`). Where the estimate states standard deviations (``depth_std``, ``disparity_std``,
    ``velocity_std``), ``calibration`` and ``within_2_std`` tell whether the errors are as large as they say.
    ``velocity_endpoint`` does the same for ‖U_estimate - U_truth‖ (`endpoint_statistics`), and ``outliers`` has the
    shares of gross errors (`outlier_rates`). Where the truth has ``growth_rate`` and the estimate velocities,
    ``growth_rate`` and ``growth_rate_windowed`` are scored in % per hour (see `surface_growth` and `growth_pairs`).

    A pixel counts where truth and estimate are finite and the estimate claims to know the quantity: ``kind_disparity``
    is full for depth and disparity, ``kind_motion`` for optical flow, both for velocity and outliers (see
    `full_pixels`). The density is the share of the pixels with a finite truth that count; it is 0 for what an estimate
    of one camera or one frame cannot know.

    Parameters
    ----------
    estimate
        The estimate, dimensions (t, y, x).
    truth
        The truth, dimensions (t, y, x), or (s, t, y, x), of which s = 0 is taken; it may have more frames.
    recording
        What was estimated from; without it there are no regions of contrast.
    margin_px
        Distance of the interior from silhouettes and face edges, in px; the setting ``interior_margin_px`` by another
        name.
    metadata
        More to keep with the score: anything that JSON can say, NumPy's numbers and paths. NaN becomes None.
    **settings
        Bounds of regions and windows, see `scenetruth.settings.ScoreSettings`.

    Returns
    -------
    Score
        With the frames, their size, the margin and the settings in the metadata, besides those given.

    Raises
    ------
    ScoreError
        If the data sets cannot be compared, or the settings or the metadata are not acceptable; lists what is wrong.
    """
    chosen = score_settings(**settings, **({} if margin_px is None else {"interior_margin_px": margin_px}))
    whole = truth
    estimate, truth = align(estimate, truth)
    masks = region_masks(truth["depth"].values, truth["mixed"].values.astype(bool), chosen.interior_margin_px)
    masks |= further_regions(
        truth,
        masks["interior"],
        chosen,
        throughout=seen_throughout(whole),
        contrast=None if recording is None else _contrast(recording, estimate, chosen),
    )
    pairs = read_pairs(estimate, truth) | growth_pairs(estimate, truth, chosen)
    own = {
        "frames": estimate["t"].values.tolist(),
        "image_size_px": [estimate.sizes["x"], estimate.sizes["y"]],
        "margin_px": chosen.interior_margin_px,
        "score_settings": chosen.model_dump(),
    }
    return Score(
        regions={region: region_statistics(pairs, mask) for region, mask in masks.items()},
        metadata=_plain({**own, **(metadata or {})}, "metadata"),
    )


def _contrast(recording: xr.Dataset, estimate: xr.Dataset, settings: ScoreSettings) -> NDArray[np.float64]:
    check_recording(recording, estimate)
    frames = estimate["t"].values
    missing = sorted(set(frames.tolist()) - set(recording["t"].values.tolist()))
    if missing:
        raise ScoreError([Problem("recording.t", "lacks frames of the estimate", missing)])
    return local_contrast(reference_images(recording, frames), settings.contrast_window_px)


def _is_map(value: Any) -> bool:
    return isinstance(value, dict)


def _has(quantities: Any, quantity: str, statistic: str) -> bool:
    statistics = quantities.get(quantity) if isinstance(quantities, dict) else None
    return isinstance(statistics, dict) and statistic in statistics


def _plain(value: Any, path: str) -> Any:
    """Return a value as JSON can spell it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry, f"{path}.{key}") for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist(), path)
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(entry, f"{path}.{index}") for index, entry in enumerate(value)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Path):
        return str(value)
    raise ScoreError([Problem(path, f"a {type(value).__name__} cannot be written as JSON", value)])
