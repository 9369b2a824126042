"""A small method that is right, from gradients of the images, to be broken in one way at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators import Method, MethodSettings, Needs
from scenetruth.progress import Progress
from scenetruth.schema import make_estimate
from scenetruth.validated_model import FrozenModel

__all__ = ["Gradients", "GradientsSettings"]

Array = NDArray[np.float64]

_BORDER_PX = 8
_DERIVATIVE = np.array([1, -8, 0, 8, -1]) / 12


class GradientsSettings(MethodSettings):
    """What the images are shifted by first."""

    start_px: int = 4
    """Disparity by which images are registered, px per step of s."""


class Gradients(Method):
    """Lucas and Kanade's least squares: disparity of all cameras of a frame, flow of the reference camera."""

    name = "gradients"
    settings: type[FrozenModel] = GradientsSettings
    gives = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(cameras=2, frames=2, channels=1)

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Progress | None) -> xr.Dataset:
        images = self.images(recording)
        self.look(images)
        reference = self.reference(recording)
        if progress is not None:
            progress("matching", 0, 1)
        disparity = self.disparity(images, reference, self.steps(recording), self.start(recording, settings))
        flow = self.flow(images[reference])
        border = np.ones(images.shape[2:], dtype=bool)
        border[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = False
        disparity[..., border] = np.nan
        flow[..., border] = np.nan
        if progress is not None:
            progress("matching", 1, 1)
        return self.made(recording, disparity, flow)

    def images(self, recording: xr.Dataset) -> Array:
        values = recording["image"].values.astype(np.float64)
        return np.asarray(values / recording.attrs["full_scale"])

    def look(self, images: Array) -> None:
        if not np.isfinite(images).all():
            raise EstimateError([Problem("image", "holds values that are not finite")])

    def reference(self, recording: xr.Dataset) -> int:
        return int(np.flatnonzero(recording["s"].values == 0)[0])

    def steps(self, recording: xr.Dataset) -> Array:
        return np.asarray(recording["stage_x_mm"].values / recording.attrs["baseline_mm"])

    def start(self, recording: xr.Dataset, settings: Any) -> int:
        # Disparity has the sign of the baseline.
        return int(settings.start_px * np.sign(recording.attrs["baseline_mm"]))

    def disparity(self, images: Array, reference: int, steps: Array, start: int) -> Array:
        slope = correlate1d(images[reference], _DERIVATIVE, axis=-1, mode="nearest")
        above, below = np.zeros_like(slope), np.zeros_like(slope)
        unseen = np.zeros(slope.shape[-1], dtype=bool)
        columns = np.arange(slope.shape[-1])
        for image, step in zip(images, steps, strict=True):
            shift = round(step * start)
            at = columns - shift
            unseen |= (at < _BORDER_PX) | (at >= len(at) - _BORDER_PX)
            difference = image[..., np.clip(at, 0, len(at) - 1)] - images[reference]
            above += step * slope * difference
            below += (step * slope) ** 2
        found = start + _windowed(above) / np.maximum(_windowed(below), 1e-12)
        found[..., unseen] = np.nan
        found[found * start <= 0] = np.nan
        return np.asarray(found)

    def flow(self, images: Array) -> Array:
        # After smoothing, fewer short waves bend what is taken as straight.
        g_x, g_y = (correlate1d(images, _DERIVATIVE, axis=axis, mode="nearest") for axis in (-1, -2))
        g_t = np.gradient(images, axis=0)
        xx, xy, yy, xt, yt = (_windowed(part) for part in (g_x**2, g_x * g_y, g_y**2, g_x * g_t, g_y * g_t))
        determinant = np.maximum(xx * yy - xy**2, 1e-12)
        return np.stack([xy * yt - yy * xt, xy * xt - xx * yt]) / determinant

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        return make_estimate(recording=recording, disparity=disparity, flow=flow, method=self.name)


def _windowed(values: Array) -> Array:
    return np.asarray(gaussian_filter(values, (0, 3, 3)))
