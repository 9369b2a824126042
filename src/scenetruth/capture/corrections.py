"""Corrections of recorded images: dark frame, flat field and lens distortion; whether dark frames belong to images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation, gaussian_filter, map_coordinates, uniform_filter

from scenetruth.camera import Camera, Distortion, two_point_correction
from scenetruth.capture.image_reading import FrameMoments
from scenetruth.errors import ArgumentError, Problem, RecordingError
from scenetruth.schema import (
    IncrementalDataset,
    blank_map,
    check_dataset,
    describe_variable,
    digest,
    read_intrinsics,
)

__all__ = [
    "FixedPatternCorrection", "PatternMatch", "correct_images", "noise_share", "resample_image", "spline_share",
    "touched_pixels", "undistort_images",
]  # fmt: skip

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REACH_PX = 3  # half width of a quintic B-spline
_FILL_SIGMA_PX = 1.5
_PLACES = 4096  # subpixel positions at which the sum of the squared weights is tabulated
_TAPS = 16  # pixels on either side with a weight; those beyond are below 1e-6
_DARK_SHARE = 0.01  # largest share of pixels whose flat field is not brighter than the dark frame
_COEFFICIENTS = (4, 5, 8)
_WINDOW_PX = 5
_BLOCKS = 8  # along either axis, for the uncertainty (jackknife)
_MOST_PIXELS = 4_000_000  # of an image; of larger images the middle is used
_LEAST_VARIANCE = 1 / 12
_CLEAR = 5.0  # least pattern in standard deviations of its own uncertainty
_HOT = 8.0  # standard deviations of the pattern beyond which a pixel is excluded


@dataclass(frozen=True, eq=False)
class FixedPatternCorrection:
    """Subtraction of a dark frame, and division by a flat field (two-point correction).

    ``dark``: Mean dark frame in digital numbers, shape (y, x[, channel]).
    ``flat``: Mean flat-field image of the same shape; None for no division.
    ``full_scale``: Largest digital number.
    ``defects``: Pixels that are invalid in every image, shape (y, x); None for none.
    """

    dark: Floats
    flat: Floats | None
    full_scale: float
    defects: Mask | None = None

    @cached_property
    def corrected_full_scale(self) -> float:
        """Full scale of the corrected images, less the mean dark frame."""
        return float(self.full_scale - self.dark.mean())

    def apply(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return corrected values; NaN where a pixel is saturated, defective, or does not respond to light."""
        if self.flat is None:
            out = (values - self.dark).astype(np.float32)
        elif values.ndim == 2:
            out = two_point_correction(values, self.dark, self.flat)
        else:
            channels = range(values.shape[-1])
            out = np.stack(
                [two_point_correction(values[..., n], self.dark[..., n], self.flat[..., n]) for n in channels], axis=-1
            )
        out[values >= self.full_scale] = np.nan
        if self.defects is not None:
            out[self.defects] = np.nan
        return out


def correct_images(
    recording: xr.Dataset,
    dark: ArrayLike | None = None,
    flat: ArrayLike | None = None,
    *,
    black_level_dn: float | None = None,
    defects: ArrayLike | None = None,
) -> xr.Dataset:
    """Correct the images of a recording with dark frames and flat fields.

    Parameters
    ----------
    recording
        Recording of linear digital numbers, as from `read_images` or `make_recording`.
    dark
        Mean dark frame, shape (y, x[, channel]), or dark frames, shape (n, y, x[, channel]), in digital numbers.
        Exposure time and temperature should be those of the images.
    flat
        Mean image of a uniformly bright surface, or such images, below saturation; default: no division.
    black_level_dn
        Digital number without light, where there is no dark frame.
    defects
        Pixels that are marked as invalid in every image, boolean, shape (y, x), as from
        `scenetruth.capture.find_defects`.

    Returns
    -------
    xarray.Dataset
        The recording with images in float32: (image - dark) / (flat - dark) times the mean of (flat - dark). Saturated
        and defective pixels are NaN, as are pixels that do not respond to light. ``full_scale`` is reduced by the mean
        dark frame.

    Raises
    ------
    ArgumentError
        If neither a dark frame nor a black level is given, or an array does not fit the images; lists every problem.

    See Also
    --------
    average_frames : Computes the mean of repeated image files.
    undistort_images : Removes the distortion of the lens.
    scenetruth.camera.two_point_correction : The same for arrays.

    References
    ----------
    EMVA Standard 1288, Standard for Characterization of Image Sensors and Cameras: dark-signal and photo-response
    non-uniformity (DSNU, PRNU).

    Examples
    --------
    The left half of the sensor is darker by 20 %:

    >>> import scenetruth as st
    >>> shading = np.where(np.arange(8) < 4, 0.8, 1.0) * np.ones((6, 1))
    >>> images = np.broadcast_to(10 + 100 * shading, (3, 1, 6, 8)).astype(np.uint8)
    >>> recording = st.make_recording(images, focal_length_px=100, baseline_mm=5)
    >>> corrected = correct_images(recording, dark=np.full((6, 8), 10), flat=10 + 200 * shading)
    >>> np.unique(corrected.image).tolist(), corrected.attrs["full_scale"]
    ([90.0], 245.0)
    """
    image = recording["image"]
    full_scale = float(recording.attrs["full_scale"])
    shape = tuple(size for dim, size in image.sizes.items() if dim in ("y", "x", "channel"))
    problems: list[Problem] = []
    if dark is None and black_level_dn is None:
        problems.append(Problem("dark", "is missing; give dark frames, or black_level_dn"))
    if dark is not None and black_level_dn is not None:
        problems.append(Problem("black_level_dn", "must be omitted where a dark frame is given", black_level_dn))
    low = _mean_frame("dark", dark, shape, problems)
    high = None if flat is None else _mean_frame("flat", flat, shape, problems)
    bad = None if defects is None else np.asarray(defects)
    if bad is not None and (bad.dtype != np.bool_ or bad.shape != shape[:2]):
        problems.append(Problem("defects", f"must be boolean, of shape {shape[:2]}", f"{bad.dtype} {bad.shape}"))
    if dark is None and black_level_dn is not None:
        if not 0 <= black_level_dn < full_scale:
            problems.append(Problem("black_level_dn", f"must be from 0 to {full_scale:g}", black_level_dn))
        low = np.full(shape, float(black_level_dn))
    if low is not None:
        problems += correction_problems(low, high, full_scale)
    if problems or low is None:
        raise ArgumentError(problems, source="correct_images")
    correction = FixedPatternCorrection(low, high, full_scale, bad)
    return _each_image(
        recording, lambda values: correction.apply(values), {"full_scale": correction.corrected_full_scale}
    )


def correction_problems(dark: Floats, flat: Floats | None, full_scale: float) -> list[Problem]:
    """Return why a dark frame and a flat field do not serve for a correction."""
    problems = []
    if not np.isfinite(dark).all() or dark.mean() >= full_scale:
        problems.append(Problem("dark", f"must be finite, and below the full scale of {full_scale:g}"))
    if flat is None:
        return problems
    if not np.isfinite(flat).all():
        return [*problems, Problem("flat", "must be finite")]
    unlit = float(np.mean(flat <= dark))
    if unlit > _DARK_SHARE:
        message = f"is not brighter than the dark frame at {100 * unlit:.3g} % of the pixels: are they exchanged?"
        problems.append(Problem("flat", message))
    saturated = float(np.mean(flat >= full_scale))
    if saturated > 0:
        message = f"is saturated at {100 * saturated:.3g} % of the pixels; take it with a shorter exposure"
        problems.append(Problem("flat", message))
    return problems


def _mean_frame(name: str, frames: Any, shape: tuple[int, ...], problems: list[Problem]) -> Floats | None:
    if frames is None:
        return None
    try:
        values = np.asarray(frames, dtype=np.float64)
    except (TypeError, ValueError):
        problems.append(Problem(name, "must be an array of numbers"))
        return None
    if values.shape[1:] == shape and values.ndim == len(shape) + 1:
        values = values.mean(axis=0)
    if values.shape != shape:
        problems.append(Problem(name, f"must have the shape {shape} of an image, or (n, ...) of several", values.shape))
        return None
    return values


def _each_image(
    recording: xr.Dataset, change: Callable[[NDArray[Any]], NDArray[np.float32]], attrs: dict[str, Any]
) -> xr.Dataset:
    """Return a recording with a function applied to each image, one at a time."""
    image = recording["image"]
    blank = recording.assign(image=(image.dims, blank_map(np.float32, image.shape), image.attrs)).assign_attrs(attrs)
    filling = IncrementalDataset(blank)
    leading = [dim for dim in image.dims if dim not in ("y", "x", "channel")]
    for index in product(*(range(image.sizes[dim]) for dim in leading)):
        at = dict(zip(map(str, leading), index, strict=True))
        filling.put("image", at, change(image.isel(at).values))
    done = filling.dataset()
    check_dataset(done, "recording")
    return done


def undistort_images(recording: xr.Dataset, distortion: Sequence[float] | None = None, *, order: int = 5) -> xr.Dataset:
    """Resample the images of a recording to those of a pinhole camera with the same intrinsics.

    Parameters
    ----------
    recording
        Recording of linear images.
    distortion
        Coefficients of the lens in the order of OpenCV, (k1, k2, p1, p2[, k3[, k4, k5, k6]]); default: those that the
        recording states.
    order
        Degree of the interpolating spline, 1 to 5.

    Returns
    -------
    xarray.Dataset
        The recording with images in float32, without ``distortion``. Pixels whose ray meets no pixel of the distorted
        image, or one that is saturated, excluded or not finite, are NaN. An exclusion mask is resampled likewise.
        ``noise_share`` states by how much the resampling reduces the variance of the noise.

    Raises
    ------
    ArgumentError
        If there are no coefficients, or they fold the image.

    See Also
    --------
    correct_images : Correction with dark frames and flat fields, which precedes.
    scenetruth.estimate : The method ``refined`` takes distorted images as they are.

    Notes
    -----
    Splines reduce the noise of the images, and correlate it between neighbours. Standard deviations of ``refined``
    take account of it by ``noise_share``; those of other methods are too small by about 7 % for quintic splines. Method
    ``refined`` also models the distortion (`scenetruth.make_recording` with ``distortion``) without any resampling.

    Examples
    --------
    The grey value is the distance r from the image centre. A lens with k1 = -0.1 images what belongs at r = 20.5 px at
    r (1 + k1 r² / f²) = 20.3 px:

    >>> import scenetruth as st
    >>> y, x = np.mgrid[:40, :60]
    >>> image = np.hypot(x - 29.5, y - 19.5).astype(np.float32)
    >>> recording = st.make_recording(image[None, None], 60, 5, distortion=[-0.1, 0, 0, 0], full_scale=50)
    >>> straight = undistort_images(recording)
    >>> [round(float(one[20, 50]), 1) for one in (image, straight.image[0, 0])]
    [20.5, 20.3]
    """
    lens, problems = _lens(recording, distortion)
    if order not in range(1, 6):
        problems.append(Problem("order", "must be from 1 to 5", order))
    if problems or lens is None:
        raise ArgumentError(problems, source="undistort_images")
    intrinsics = read_intrinsics(recording)
    columns, rows = (recording[dim].values.astype(np.float64) for dim in ("x", "y"))
    camera = Camera(
        width=max(int(columns.max()) + 1, 1),
        height=max(int(rows.max()) + 1, 1),
        focal_length_px=intrinsics.focal_length_px,
        principal_point_px=intrinsics.principal_point_px,
    )
    directions = camera.ray_directions(np.stack(np.meshgrid(columns, rows), axis=-1))[..., :2]
    pixels = intrinsics.focal_length_px * lens.distort(directions) + intrinsics.principal_point_px
    steps = [float(values[1] - values[0]) if len(values) > 1 else 1.0 for values in (columns, rows)]
    where = np.stack([(pixels[..., 1] - rows[0]) / steps[1], (pixels[..., 0] - columns[0]) / steps[0]])
    full_scale = float(recording.attrs["full_scale"])
    digital = recording["image"].dtype.kind in "iu"

    def resample(values: NDArray[Any]) -> NDArray[np.float32]:
        bad = values >= full_scale if digital else ~np.isfinite(values)
        if values.ndim == 2:
            return resample_image(values, bad, where, order)
        return np.stack(
            [resample_image(values[..., n], bad[..., n], where, order) for n in range(values.shape[-1])], -1
        )

    done = _each_image(recording, resample, {})
    share = xr.DataArray(noise_share(where, order), dims=("y", "x"))
    if "noise_share" in recording:
        # The images were resampled before.
        share = (recording["noise_share"] * share).astype(np.float32)
    done["noise_share"] = (share.dims, share.values, describe_variable("recording", "noise_share"))
    if "recording_hash" in recording.attrs:
        # The ground truth of a simulated recording is that of the distorted camera.
        done.attrs["recording_hash"] = digest([recording.attrs["recording_hash"], "undistorted", *lens.coefficients])
    for name in ("distortion", "distortion_std"):
        done.attrs.pop(name, None)
    if "exclusion_mask" in recording:
        mask = recording["exclusion_mask"]
        flat = mask.values.reshape(-1, *mask.shape[-2:])
        moved = np.stack([touched_pixels(each, where) for each in flat]).reshape(mask.shape)
        done = done.assign(exclusion_mask=(mask.dims, moved, mask.attrs))
    return done


def _lens(recording: xr.Dataset, given: Any) -> tuple[Distortion | None, list[Problem]]:
    """Return the lens of a recording, or why it is none."""
    stated = recording.attrs.get("distortion") if given is None else given
    if stated is None:
        return None, [Problem("distortion", "is missing: the recording states none; give (k1, k2, p1, p2)")]
    try:
        values = [float(value) for value in stated]
    except (TypeError, ValueError):
        return None, [Problem("distortion", "must be a list of numbers", stated)]
    if len(values) not in _COEFFICIENTS or not np.isfinite(values).all():
        return None, [Problem("distortion", "must hold 4, 5 or 8 finite coefficients in the order of OpenCV", values)]
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    lens = Distortion(**dict(zip(names, values, strict=False)))
    try:
        intrinsics = read_intrinsics(recording)
    except (KeyError, RecordingError):
        return lens, []
    camera = Camera(
        width=int(recording["x"].values.max()) + 1,
        height=int(recording["y"].values.max()) + 1,
        focal_length_px=intrinsics.focal_length_px,
        principal_point_px=intrinsics.principal_point_px,
    )
    # Copied without validation, which would raise the same problem.
    problem = camera.model_copy(update={"distortion": lens}).folding_problem(0)
    return (None, [Problem("distortion", problem)]) if problem else (lens, [])


def noise_share(where: Floats, order: int) -> NDArray[np.float32]:
    """Return the variance of white noise after a resampling relative to that before, shape (y, x); 1 outside.

    ``where``: Rows and columns of the recorded image, shape (2, y, x).
    """
    rows, columns = (spline_share(each, order) for each in where)
    share = rows * columns
    return np.asarray(np.where(np.isfinite(share), share, 1.0), dtype=np.float32)


def spline_share(positions: Floats, order: int) -> Floats:
    """Return the sum of the squared weights of the pixels in an interpolating spline, in one dimension."""
    places = np.mod(positions, 1.0) * _PLACES
    return np.asarray(np.interp(places, np.arange(_PLACES + 1), _share_table(order)))


@lru_cache(maxsize=5)
def _share_table(order: int) -> Floats:
    impulse = np.zeros(4 * _TAPS + 1)
    impulse[2 * _TAPS] = 1.0
    fine = np.arange(_PLACES + 1) / _PLACES
    at = 2 * _TAPS + fine + np.arange(-_TAPS, _TAPS)[:, None]
    return np.asarray((map_coordinates(impulse, at[None], order=order, mode="mirror") ** 2).sum(axis=0))


def resample_image(values: NDArray[Any], bad: Mask, where: Floats, order: int) -> NDArray[np.float32]:
    """Return an image at other places, shape (2, y, x) in rows and columns; NaN where it rests on a bad pixel."""
    if bad.all():
        return np.full(where.shape[1:], np.nan, dtype=np.float32)
    given = values.astype(np.float64)
    if bad.any():
        given = _filled(given, bad)
    out: NDArray[np.float32] = np.asarray(
        map_coordinates(given, where, order=order, mode="constant", cval=np.nan), dtype=np.float32
    )
    if bad.any():
        out[touched_pixels(bad, where)] = np.nan
    return out


def _filled(values: Floats, bad: Mask) -> Floats:
    """Return an image whose bad pixels have the weighted mean of their neighbours, else of the image."""
    good = np.where(bad, 0.0, values)
    weight = gaussian_filter((~bad).astype(np.float64), _FILL_SIGMA_PX)
    near = gaussian_filter(good, _FILL_SIGMA_PX) / np.where(weight > 1e-6, weight, 1.0)
    return np.where(bad, np.where(weight > 1e-6, near, values[~bad].mean()), values)


def touched_pixels(bad: Mask, where: Floats) -> Mask:
    """Return the places whose spline rests on a bad pixel, or that lie outside the image."""
    around = binary_dilation(bad, np.ones((3, 3)), iterations=_REACH_PX) if bad.any() else bad
    nearest = np.rint(np.nan_to_num(where, nan=-1e6)).astype(np.intp)
    inside = (nearest >= 0).all(axis=0) & (nearest[0] < bad.shape[0]) & (nearest[1] < bad.shape[1])
    out: Mask = ~inside
    out[inside] = around[nearest[0][inside], nearest[1][inside]]
    return out


class PatternMatch:
    """How many times the pattern of dark frames is contained in images.

    Both are taken less their local means. Every pixel has the weight of the inverse variance of its neighbours, so that
    smooth parts count: the inside of squares of a board, or a background without texture.
    """

    def __init__(self, dark: FrameMoments) -> None:
        self._part = _middle(dark.mean.shape)
        pattern = _fine(dark.mean[self._part])
        noise = (1 - 1 / _WINDOW_PX**2) * dark.variance[self._part] / dark.count
        # Defective pixels are excluded: clipping and their own noise obey no model.
        usual = float(np.median(np.abs(pattern))) * 1.4826
        self._used = np.abs(pattern) < _HOT * max(usual, 1e-9)
        self._pattern = np.where(self._used, pattern, 0.0)
        self._own = np.where(self._used, pattern**2 - noise, 0.0)
        self._sums = np.zeros(pattern.shape)
        self._weights = np.zeros(pattern.shape)

    @property
    def measurable(self) -> bool:
        """Whether the dark frames have a pattern that exceeds its uncertainty."""
        own, count = self._own[self._used], int(self._used.sum())
        spread = float(own.std()) / np.sqrt(max(count, 1))
        return count > 1000 and float(own.mean()) > _CLEAR * spread

    def add(self, image: NDArray[Any]) -> None:
        """Add an image of the same camera settings as the dark frames, shape (y, x)."""
        values = _fine(image[self._part].astype(np.float64))
        squares = values**2
        # A pixel whose own value reduced its weight would contain too little of the pattern.
        variance = (_WINDOW_PX**2 * uniform_filter(squares, _WINDOW_PX) - squares) / (_WINDOW_PX**2 - 1)
        # Rounding hides the pattern where there is no noise.
        weight = np.where(variance > _LEAST_VARIANCE, 1 / np.maximum(variance, _LEAST_VARIANCE), 0.0)
        self._sums += weight * values
        self._weights += weight

    def slope(self) -> tuple[float, float]:
        """Return the number of times that the images contain the pattern, and its standard deviation."""
        if not self.measurable or not self._weights.any():
            return np.nan, np.inf
        row, column = (np.arange(size) * _BLOCKS // size for size in self._pattern.shape)
        blocks = (row[:, None] * _BLOCKS + column).ravel()
        upper = np.bincount(blocks, (self._pattern * self._sums).ravel(), _BLOCKS**2)
        lower = np.bincount(blocks, (self._own * self._weights).ravel(), _BLOCKS**2)
        if lower.sum() <= 0:
            return np.nan, np.inf
        without = (upper.sum() - upper) / (lower.sum() - lower)
        spread = np.sqrt((len(without) - 1) / len(without) * np.sum((without - without.mean()) ** 2))
        return float(upper.sum() / lower.sum()), float(spread)


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the middle part of an image with at most a certain number of pixels."""
    share = min(1.0, np.sqrt(_MOST_PIXELS / (shape[0] * shape[1])))
    found = []
    for size in shape[:2]:
        length = max(int(size * share), min(size, 64))
        first = (size - length) // 2
        found.append(slice(first, first + length))
    return found[0], found[1]


def _fine(values: Floats) -> Floats:
    return np.asarray(values - uniform_filter(values, _WINDOW_PX))
