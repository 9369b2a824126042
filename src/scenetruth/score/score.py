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

from scenetruth.errors import Problem, ScoreError
from scenetruth.score.alignment import align
from scenetruth.score.quantities import ENDPOINT, OUTLIERS, QUANTITIES, units_of
from scenetruth.score.regions import REGIONS, region_masks
from scenetruth.score.statistics import RATES, STATISTICS, region_statistics

if TYPE_CHECKING:
    import pandas as pd  # type: ignore[import-untyped]

__all__ = ["Score", "score"]

_COLUMNS = (*STATISTICS[:-1], *RATES)


_EXPECTED = {**dict.fromkeys((*QUANTITIES, ENDPOINT), STATISTICS), OUTLIERS: RATES}
"""The statistics of every quantity."""


@dataclass(frozen=True)
class Score:
    """The figures of merit of one estimate.

    Parameters
    ----------
    regions
        Region to quantity to statistic to value; None where a value is undefined. Errors are estimate minus truth, in
        the units of the quantity; ``density``, ``relative_rms``, ``within_2_std`` and rates are fractions, and
        ``calibration`` is a ratio.
    metadata
        What the score was made from, as plain JSON values.
    """

    regions: Mapping[str, Mapping[str, Mapping[str, float | int | None]]]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return strict JSON with the regions and ``metadata`` as its top-level keys."""
        return json.dumps({**self.regions, "metadata": self.metadata}, indent=2, allow_nan=False, ensure_ascii=False)

    @classmethod
    def from_json(cls, text: str) -> Score:
        """Read what `to_json` wrote.

        Raises
        ------
        ScoreError
            If the text is not JSON, or lacks a region, quantity or statistic; lists all that is wrong.
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
        problems += [Problem(key, f"is not one of the keys {keys}") for key in content if key not in keys]
        problems += [
            Problem(f"{region}.{quantity}.{statistic}", "is missing")
            for region in REGIONS
            for quantity, statistics in _EXPECTED.items()
            for statistic in statistics
            if not _has(content.get(region), quantity, statistic)
        ]
        if problems:
            raise ScoreError(problems)
        return cls(regions={region: content[region] for region in REGIONS}, metadata=content["metadata"])

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


def score(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    *,
    margin_px: float = 20.0,
    metadata: Mapping[str, Any] | None = None,
) -> Score:
    """Score an estimate against the truth.

    In each of the regions ``all`` and ``interior`` (see `region_masks`), the errors e = estimate - truth of depth,
    disparity, the three components of velocity and the two of optical flow are summed up over all frames of the
    estimate as bias, rms, median and 95th percentile of abs(e), relative rms, density and count (see
    `error_statistics`). Where the estimate states standard deviations (``depth_std``, ``disparity_std``,
    ``velocity_std``), ``calibration`` and ``within_2_std`` tell whether the errors are as large as they say.
    ``velocity_endpoint`` does the same for ‖U_estimate - U_truth‖ (`endpoint_statistics`), and ``outliers`` has the
    shares of gross errors (`outlier_rates`).

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
    margin_px
        Distance of the interior from silhouettes and face edges, in px.
    metadata
        More to keep with the score: anything that JSON can say, NumPy's numbers and paths. NaN becomes None.

    Returns
    -------
    Score
        With the frames, their size and the margin in the metadata, besides those given.

    Raises
    ------
    ScoreError
        If the two cannot be compared, or the margin or the metadata are not acceptable; lists what is wrong.
    """
    estimate, truth = align(estimate, truth)
    masks = region_masks(truth["depth"].values, truth["mixed"].values.astype(bool), margin_px)
    own = {
        "frames": estimate["t"].values.tolist(),
        "image_size_px": [estimate.sizes["x"], estimate.sizes["y"]],
        "margin_px": float(margin_px),
    }
    return Score(
        regions={region: region_statistics(estimate, truth, masks[region]) for region in REGIONS},
        metadata=_plain({**own, **(metadata or {})}, "metadata"),
    )


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
