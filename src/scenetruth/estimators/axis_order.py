"""Likely causes of an estimate without valid pixels: the order of the image axes and the sign of the baseline."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenetruth.number_format import format_two_digits
from scenetruth.schema.validity import excluded_pixels

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["describe_likely_causes", "measure_shift", "share_of_valid"]

_VALID_SHARE, _NO_SHARE = 0.2, 0.01
"""Shares of valid pixels below which the axes are examined, and below which no displacement of the cameras is required.
With swapped axes, up to 8 % of the pixels of a cube were valid by chance."""

_CROP = 384
_PAIRS = 3
_CORRELATED = 0.4
_SMALLEST_PX = 0.5
_ACROSS = 0.1
_SPREAD = 0.25

Shift = tuple[float, float]


def share_of_valid(valid_pixels: int, estimate: xr.Dataset, recording: xr.Dataset) -> float:
    """Return the share of valid pixels among those that the exclusion mask admits; 1 if it admits none."""
    pixels = estimate.sizes["t"] * estimate.sizes["y"] * estimate.sizes["x"]
    if valid_pixels >= _VALID_SHARE * pixels:
        return valid_pixels / pixels
    excluded = excluded_pixels(recording, estimate["t"].values)
    admitted = pixels if excluded is None else pixels - int(excluded.sum())
    return valid_pixels / admitted if admitted > 0 else 1.0


def describe_likely_causes(recording: xr.Dataset, valid_share: float = 0.0) -> str:
    """Return the likely errors in the order of the axes or in the sign of the baseline; empty if none is detected.

    ``valid_share``: Share of the pixels that are valid; estimates with 20 % or more are not examined.

    The displacement of the image content between neighbouring cameras and between neighbouring frames is measured by
    correlation in the image centre. Between cameras it is along x, and opposite to the sign of the baseline. Where it
    is not, every change of the order that would explain the images is named. Images without texture, and images that
    do not correlate, give no cause.
    """
    if valid_share >= _VALID_SHARE:
        return ""
    image = recording["image"]
    image = image.isel({dim: image.sizes[dim] // 2 for dim in image.dims if dim in ("s_y", "channel")})
    for dim in ("y", "x"):
        first = max(0, (image.sizes[dim] - _CROP) // 2)
        image = image.isel({dim: slice(first, first + _CROP)})
    cameras, frames = _shift_along(image, "s"), _shift_along(image, "t")
    sign = 1.0 if float(recording.attrs["baseline_mm"]) > 0 else -1.0
    if cameras is None and valid_share >= _NO_SHARE:
        return ""
    if cameras is not None and _is_along(cameras, 1) and -sign * cameras[1] > 0:
        return ""
    causes = []
    if frames is not None and _is_along(frames, 1) and -sign * frames[1] > 0:
        causes.append("the axes s and t are swapped: make_recording takes images as (s, t, y, x)")
    if cameras is not None and _is_along(cameras, 0):
        causes.append("rows and columns are swapped: make_recording takes images as (s, t, y, x)")
    if cameras is not None and _is_along(cameras, 1):
        causes.append("the sign of baseline_mm, or the order of s, is reversed")
    if not causes:
        return ""
    measured = [
        f"{_in_words(shift)} between neighbouring {what}"
        for shift, what in ((cameras, "cameras (s)"), (frames, "frames (t)"))
        if shift is not None
    ]
    remedy = "Likely: " + "; or ".join(causes)
    return (
        f"only {format_two_digits(100 * valid_share)} % of the pixels are valid, "
        "although the images have texture. The images move by "
        f"(x, y) = {' and '.join(measured)}; between cameras they must move along x, towards "
        f"{'negative' if sign > 0 else 'positive'} x for this baseline_mm. {remedy}."
    )


def _in_words(shift: Shift) -> str:
    return f"({shift[1] + 0.0:.1f}, {shift[0] + 0.0:.1f}) px"


def _is_along(shift: Shift, axis: int) -> bool:
    """Return whether a displacement (y, x) is distinct and along one axis."""
    along, across = abs(shift[axis]), abs(shift[1 - axis])
    return along > _SMALLEST_PX and across <= _ACROSS * along + _SPREAD


def _shift_along(image: xr.DataArray, dim: str) -> Shift | None:
    """Return the displacement (y, x) between images that are neighbours along a dimension; None if unsteady."""
    size = image.sizes[dim]
    first = max(0, (size - 1 - _PAIRS) // 2)
    chosen = image.isel({dim: slice(first, first + _PAIRS + 1)})
    other = "t" if dim == "s" else "s"
    stack = chosen.isel({other: image.sizes[other] // 2}).transpose(dim, "y", "x").values.astype(np.float64)
    shifts = [measure_shift(one, two) for one, two in pairwise(stack)]
    if not shifts or any(shift is None for shift in shifts):
        return None
    found = np.array(shifts, dtype=np.float64)
    middle = np.median(found, axis=0)
    if np.any(np.abs(found - middle) > _SPREAD * np.abs(middle).max() + _SMALLEST_PX):
        return None
    return float(middle[0]), float(middle[1])


def measure_shift(one: NDArray[np.float64], two: NDArray[np.float64]) -> Shift | None:
    """Return the displacement (y, x) in px from one image to another; None if they do not correlate.

    The correlation is that of the gradients, so that brightness and slow shading have no influence.

    >>> image = np.random.default_rng(0).standard_normal((70, 90))
    >>> image = sum(np.roll(image, (j, i), (0, 1)) for j in range(3) for i in range(3))
    >>> measure_shift(image[5:55, 5:75], image[3:53, 9:79])
    (2.0, -4.0)
    """
    if min(one.shape) < 8:
        return None
    window = np.hanning(one.shape[0])[:, None] * np.hanning(one.shape[1])
    spectra, energy = [], 1.0
    for values in (one, two):
        rows, columns = np.gradient(values)
        gradient = np.asarray(columns + 1j * rows)
        # Invalid pixels (NaN) have no gradient.
        valid = np.isfinite(gradient)
        if not valid.any():
            return None
        gradient = np.where(valid, gradient - gradient[valid].mean(), 0.0) * window
        energy *= float(np.sum(np.abs(gradient) ** 2))
        spectra.append(np.fft.fft2(gradient))
    if not energy > 0:
        return None
    correlation = np.fft.ifft2(np.conj(spectra[0]) * spectra[1]).real / np.sqrt(energy)
    peak = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    # Displaced windows overlap in part only.
    if correlation[peak] < _CORRELATED:
        return None
    found = []
    for axis, place in enumerate(peak):
        size = correlation.shape[axis]
        line = np.moveaxis(correlation, axis, 0)[(..., peak[1 - axis])]
        before, here, after = (float(line[(int(place) + step) % size]) for step in (-1, 0, 1))
        curvature = before - 2 * here + after
        part = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
        found.append((int(place) + size // 2) % size - size // 2 + round(part, 1))
    return float(found[0]), float(found[1])
