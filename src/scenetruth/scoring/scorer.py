"""Scoring of an estimate against the truth: statistics of all quantities in all regions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy import ndimage

from scenetruth.errors import Problem, ScoreError
from scenetruth.plain_data import plain_problems
from scenetruth.schema import check_same_run, read_lineage, read_object_names
from scenetruth.scoring.alignment import (
    check_alignable,
    check_recording,
    count_blocks,
    iterate_aligned_blocks,
    select_pixels,
)
from scenetruth.scoring.common_statistics import CommonAccumulator, CommonErrors
from scenetruth.scoring.error_pairs import EstimateTruthPair, EstimateTruthPairs
from scenetruth.scoring.growth_rate import compute_growth_pairs, has_growth_rate
from scenetruth.scoring.quantities import OUTLIERS, QUANTITIES
from scenetruth.scoring.regions import further_regions, main_regions, visible_throughout
from scenetruth.scoring.score_result import Score
from scenetruth.scoring.statistics import (
    ErrorSamples,
    OutlierAccumulator,
    Outliers,
    Statistics,
    StatisticsAccumulator,
    select_meaningful_rates,
)
from scenetruth.settings import ScoreSettings
from scenetruth.validation_problems import list_problems

__all__ = ["StatisticsAggregator", "local_contrast", "reference_images", "score", "score_settings"]


Map = NDArray[np.float64]


def local_contrast(image: Map, window_px: float) -> Map:
    """Return the RMS contrast: the standard deviation of grey values in a Gaussian window around every pixel.

    Image noise contributes its variance. The window is reflected at the image border.
    """
    # Subtracting the mean avoids cancellation in the difference of squares.
    centred = image - image.mean(axis=(-2, -1), keepdims=True)
    sigma = (*(0.0,) * (image.ndim - 2), window_px, window_px)
    mean = ndimage.gaussian_filter(centred, sigma)
    variance = ndimage.gaussian_filter(centred**2, sigma) - mean**2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def reference_images(recording: xr.Dataset, frames: NDArray[np.integer]) -> Map:
    """Return images of the reference camera as fractions of full scale, colours averaged, float64, shape (t, y, x)."""
    image = recording["image"].sel({dim: 0 for dim in ("s_y", "s") if dim in recording["image"].dims} | {"t": frames})
    values = image.values.astype(np.float64) / float(recording.attrs["full_scale"])
    return np.asarray(values.mean(axis=-1) if "channel" in image.dims else values)


Mask = NDArray[np.bool_]


class StatisticsAggregator:
    """Accumulates the statistics and outlier rates in every region; ``single``: whether there is only one block."""

    def __init__(self, rates: Sequence[str], *, single: bool) -> None:
        self._rates, self._single = rates, single
        self._tallies: dict[str, dict[str, StatisticsAccumulator | Statistics]] = {}
        self._outliers: dict[str, OutlierAccumulator] = {}
        self._common: dict[tuple[str, str], CommonAccumulator] = {}

    def add(
        self, pairs: Mapping[str, EstimateTruthPair], regions: Mapping[str, Mask], common: CommonErrors | None = None
    ) -> None:
        """Accumulate a block with region masks of the shape (t, y, x), and common errors of its estimate."""
        for quantity, pair in pairs.items():
            scored = ErrorSamples.of(pair, QUANTITIES[quantity].error)
            samples = None if common is None else common.samples(quantity, scored)
            for name, region in regions.items():
                if samples is not None:
                    self._common.setdefault((name, quantity), CommonAccumulator()).add(samples.at(region))
                own = self._tallies.setdefault(name, {})
                tally = own.setdefault(quantity, StatisticsAccumulator(single=self._single))
                assert isinstance(tally, StatisticsAccumulator)
                tally.add(scored, region)
                if self._single:
                    # Frees its values before the next quantity.
                    own[quantity] = tally.statistics()
        if self._rates:
            outliers = Outliers.of(pairs, self._rates)
            for name, region in regions.items():
                self._outliers.setdefault(name, OutlierAccumulator(self._rates)).add(outliers, region)

    def regions(self) -> dict[str, dict[str, Statistics]]:
        """Return the statistics by region and quantity, with ``outliers`` if there are rates to report."""
        found = {
            region: {
                name: item.statistics() if isinstance(item, StatisticsAccumulator) else item
                for name, item in tallies.items()
            }
            for region, tallies in self._tallies.items()
        }
        for (region, name), common in self._common.items():
            values = found[region][name]
            found[region][name] = values | common.statistics(values["bias"], int(values["count"] or 0))
        for region, tally in self._outliers.items():
            found[region][OUTLIERS] = tally.rates()
        return found


def score_settings(**settings: Any) -> ScoreSettings:
    """Validate the settings of a score."""
    try:
        return ScoreSettings(**settings)
    except ValidationError as error:
        raise ScoreError(list_problems(error, settings, model=ScoreSettings), source="settings") from error


def score(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None = None,
    *,
    settings: ScoreSettings | Mapping[str, Any] | None = None,
    allow_mismatch: bool = False,
    metadata: Mapping[str, Any] | None = None,
) -> Score:
    """Score an estimate against the truth.

    All quantities that the estimate contains are scored. The errors e = estimate - truth are evaluated over all frames
    of the estimate in the regions ``all`` and ``interior`` (see `region_masks`), and in regions by visibility, slope,
    distance to discontinuities, contrast and object as far as the truth defines them (see `further_regions`):

    - depth, disparity, the components of velocity and of optical flow: bias, RMSE, median and 95th percentile of
      abs(e), relative RMSE, density and count (see `error_statistics`);
    - ``velocity_epe``: the same statistics of the distance ‖U_estimate - U_truth‖ (see `endpoint_statistics`);
    - ``rms_z`` and ``coverage_2_std`` of the stated standard deviations (``depth_std``, ``velocity_std``,
      ``growth_rate_std``, ...); where a part of them is stated to be common to pixels (``depth_std_common``, ...),
      ``bias_z`` and ``rms_z_pixel`` of the mean and of the rest (see `COMMON_STATISTICS`);
    - ``outliers``: the outlier rates, where they are meaningful (see `outlier_rates` and `meaningful_rates`);
    - slopes, the angle between the normals, mean and Gaussian curvature, the rotation rate, and the principal growth
      rates and their direction, if both data sets have them (see `QUANTITIES`);
    - ``growth_rate`` and ``growth_rate_windowed`` in %/h, if the truth has ``growth_rate`` and the estimate has depth
      and velocity (see `compute_growth_rate` and `compute_growth_pairs`); a ``growth_rate`` variable of the estimate
      takes precedence for the former.

    A pixel is scored where truth and estimate are finite and the estimate is valid: ``status_disparity`` for depth and
    disparity, ``status_motion`` for optical flow, both for velocity and outliers. Without a status every finite pixel
    is scored (see `find_valid_pixels`). Fallback values are scored only with the setting ``include_fallback``. The
    density is the fraction of the pixels with a finite truth that are scored.

    Pixels are matched by their coordinates: the estimate may cover a part of the truth's image (see `align`).

    Parameters
    ----------
    estimate
        The estimate, dimensions (t, y, x).
    truth
        The truth, dimensions (t, y, x), or (s, t, y, x), of which s = 0 is used; it may have more frames and pixels.
    recording
        The recording of the estimate; regions of contrast are omitted without it.
    settings
        Bounds of regions and windows as `scenetruth.settings.ScoreSettings`, or some of them by name; default: its
        defaults.
    allow_mismatch
        Whether the data sets may belong to different recordings.
    metadata
        Additional metadata of the score: JSON values, NumPy numbers and paths. NaN becomes None.

    Returns
    -------
    Score
        The statistics; its metadata also contains frames, image size, margin and settings.

    Raises
    ------
    ScoreError
        If the data sets cannot be compared, or the settings or the metadata are invalid; lists every problem.
    MismatchError
        If the data sets belong to different recordings.

    See Also
    --------
    write_report : Report with figures.

    Examples
    --------
    A static plane at 500 mm, and a method that returns depth only, 0.1 mm too large:

    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=1000.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> still, one = np.zeros((3, 1, 24, 32)), np.ones((1, 24, 32))
    >>> maps = {"depth": 500 * one, "disparity": 10 * one, "velocity": still, "flow": still[:2], "mixed": one == 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 500.1 * one}, camera, t=[0])
    >>> found = score(estimate, truth)
    >>> found
    Score(regions: all, interior and 4 more; quantities: depth; RMSE in the interior: depth 0.1 mm)
    >>> f"{found.regions['all']['depth']['bias']:.3f}", found.regions["all"]["depth"]["density"]
    ('0.100', 1.0)
    """
    given = {"estimate": estimate, "truth": truth, **({} if recording is None else {"recording": recording})}
    wrong = [
        Problem(name, "must be an xarray.Dataset", type(part).__name__)
        for name, part in given.items()
        if not isinstance(part, xr.Dataset)
    ]
    if not (metadata is None or isinstance(metadata, Mapping)):
        wrong.append(Problem("metadata", "must be a mapping", metadata))
    wrong += [
        Problem(f"metadata.{item.path}", item.message, item.value)
        for item in plain_problems(metadata or {}, any_keys=True)
    ]
    if not (settings is None or isinstance(settings, ScoreSettings | Mapping)):
        wrong.append(Problem("settings", "must be a mapping or ScoreSettings", settings))
    if wrong:
        raise ScoreError(wrong)
    chosen = settings if isinstance(settings, ScoreSettings) else score_settings(**(settings or {}))
    if not allow_mismatch:
        check_same_run({name: given[name].attrs for name in ("truth", "estimate", "recording") if name in given})
    check_alignable(estimate, truth)
    if recording is not None:
        check_recording(recording, estimate)
        missing = sorted(set(estimate["t"].values.tolist()) - set(recording["t"].values.tolist()))
        if missing:
            raise ScoreError([Problem("recording.t", "lacks frames of the estimate", missing)])
    count = count_blocks(estimate)
    grows = any(has_growth_rate(*part) for part in iterate_aligned_blocks(estimate, truth))
    rates = select_meaningful_rates(
        lambda: (
            (
                EstimateTruthPairs(*part, include_fallback=chosen.include_fallback),
                main_regions(part[1], chosen.interior_margin_px)["all"],
            )
            for part in iterate_aligned_blocks(estimate, truth)
        ),
        count,
    )
    throughout = visible_throughout(select_pixels(truth, estimate))
    gathering = StatisticsAggregator(rates, single=count == 1)
    for found, exact in iterate_aligned_blocks(estimate, truth):
        masks = main_regions(exact, chosen.interior_margin_px)
        masks |= further_regions(
            exact,
            masks["interior"],
            chosen,
            throughout=throughout,
            contrast=None if recording is None else _contrast(recording, found, chosen),
        )
        growth = compute_growth_pairs(found, exact, chosen) if grows else None
        pairs = EstimateTruthPairs(found, exact, growth, include_fallback=chosen.include_fallback)
        gathering.add(pairs, masks, CommonErrors(found))
    own = {
        "frames": estimate["t"].values.tolist(),
        "image_size_px": [estimate.sizes["x"], estimate.sizes["y"]],
        "margin_px": chosen.interior_margin_px,
        "score_settings": chosen.model_dump(),
        **read_lineage(estimate),
    }
    return Score(
        regions=_in_order(gathering.regions(), read_object_names(truth)),
        metadata=_plain({**own, **(metadata or {})}, "metadata"),
    )


def _in_order(regions: Mapping[str, Any], objects: Sequence[str]) -> dict[str, Any]:
    """Return regions with the objects in the order of the scene, independent of the blocks."""
    last = [region for name in objects if (region := f"object_{name}") in regions]
    return {region: regions[region] for region in (*(name for name in regions if name not in last), *last)}


def _contrast(recording: xr.Dataset, estimate: xr.Dataset, settings: ScoreSettings) -> NDArray[np.float64]:
    frames = estimate["t"].values
    # The window may extend beyond the estimate's pixels.
    contrast = local_contrast(reference_images(recording, frames), settings.contrast_window_px)
    named = {dim: recording.coords[dim] for dim in ("y", "x") if dim in recording.coords}
    labelled = xr.Dataset({"contrast": (("t", "y", "x"), contrast)}, coords=named)
    return np.asarray(select_pixels(labelled, estimate)["contrast"].values)


def _plain(value: Any, path: str) -> Any:
    """Return a value converted to plain JSON types."""
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
