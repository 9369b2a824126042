"""Textures of a twin: mean of all images on a surface, without the noise that remains in it, for its renderer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from scenetruth.camera import Camera, Distortion
from scenetruth.capture.twin.measured_motion import MeasuredMotion
from scenetruth.capture.twin.measured_surface import Canvas, SurfacePart
from scenetruth.estimators.refined.noise_estimation import spline_transfer
from scenetruth.schema import read_intrinsics

__all__ = ["ImageMean", "ImageSet", "NoiseLine", "average_images", "fit_noise_line", "make_texture"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SPLINE = 5
_EDGE_PX = 3
_OUTLIER_STDS, _LEAST_SPREAD = 5.0, 1e-4
_BINS, _LEAST_BIN = 24, 50
_BANDS_PX = (0.6, 1.2, 2.4, 4.8)
_UPSAMPLING = 2
_SUPERSAMPLING = 4
_MOST_GAIN = 1.6
_LEAST_IMAGES = 4


@dataclass(frozen=True, eq=False)
class ImageSet:
    """Images of a recording as fractions of full scale, with the geometry that the recording states."""

    recording: xr.Dataset
    camera: Camera

    @classmethod
    def of(cls, recording: xr.Dataset) -> ImageSet:
        """Return the images of a recording."""
        intrinsics = read_intrinsics(recording)
        listed = [float(value) for value in recording.attrs.get("distortion", ())]
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        lens = Distortion(**dict(zip(names, listed, strict=False))) if any(listed) else None
        camera = Camera(
            width=recording.sizes["x"],
            height=recording.sizes["y"],
            focal_length_px=intrinsics.focal_length_px,
            principal_point_px=intrinsics.principal_point_px,
            distortion=lens,
        )
        return cls(recording, camera)

    def __iter__(self) -> Iterator[tuple[Floats, float, Floats]]:
        """Yield every image that exists, NaN where it is unknown, with its time in frames and its camera position."""
        image = self.recording["image"]
        interval = float(self.recording.attrs["frame_interval_s"])
        planned = self.recording.get("planned_time_s")
        scale = float(self.recording.attrs["full_scale"])
        rows = self.recording["s_y"].values.tolist() if "s_y" in image.dims else [None]
        for row in rows:
            for s in self.recording["s"].values.tolist():
                for t in self.recording["t"].values.tolist():
                    at: dict[str, Any] = {"s": s, "t": t} if row is None else {"s_y": row, "s": s, "t": t}
                    values = image.sel(at).values.astype(np.float64) / scale
                    values = values.mean(axis=-1) if values.ndim == 3 else values
                    if not np.isfinite(values).any():
                        continue
                    time = t if planned is None else float(planned.sel(at)) / interval
                    x_mm = float(self.recording["stage_x_mm"].sel(s=s))
                    y_mm = 0.0 if row is None else float(self.recording["stage_y_mm"].sel(s_y=row))
                    yield values, float(time), np.array([x_mm, y_mm, 0.0])

    @property
    def noise_transfer(self) -> float:
        """Variance of the noise of samples between pixels relative to that of the recorded images."""
        share = self.recording.get("noise_share")
        return spline_transfer(_SPLINE) ** 2 * (1.0 if share is None else float(share.mean()))

    @property
    def full_scale(self) -> float:
        """Largest value of the images of the recording."""
        return float(self.recording.attrs["full_scale"])

    def reference(self) -> Floats:
        """Return the image of the reference camera at the reference frame."""
        image = self.recording["image"]
        at = {dim: 0 for dim in ("s_y", "s", "t") if dim in image.dims}
        values = image.sel(at).values.astype(np.float64) / self.full_scale
        return np.asarray(values.mean(axis=-1) if values.ndim == 3 else values)


@dataclass(frozen=True, eq=False)
class ImageMean:
    """Mean of the images on one surface, on the canvas.

    ``mean``: NaN where no image shows the surface. ``halves``: Means of the even and the odd images.
    ``counts``: Numbers of images of both halves, shape (2, h, w). ``variance``: Variance between images, NaN below 4
    images.
    """

    mean: Floats
    halves: Floats
    counts: Floats
    variance: Floats

    def noise(self) -> Floats:
        """Return a map with the noise of the mean: half the difference of the halves; NaN where a half is missing."""
        total = self.counts.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            # The variance of the difference is that of the mean times (n + m)² / (n m).
            factor = np.sqrt(self.counts[0] * self.counts[1]) / total
        return np.where((self.counts > 0).all(axis=0), factor * (self.halves[0] - self.halves[1]), np.nan)


@dataclass(frozen=True)
class _Surface:
    """Points of a surface on the canvas with their motion."""

    part: SurfacePart
    points_mm: Floats
    velocity: Floats

    def pixels(self, camera: Camera, time: float, place_mm: Floats) -> Floats:
        """Return the pixels of the points in an image, shape (h, w, 2)."""
        return camera.project(self.points_mm + time * self.velocity - place_mm)


def average_images(
    images: ImageSet, canvas: Canvas, parts: Sequence[SurfacePart], motions: Sequence[MeasuredMotion]
) -> list[ImageMean]:
    """Return the mean over all images that show each surface.

    Images are scaled to a common brightness. Points that a nearer surface hides are excluded, and values that differ by
    5 standard deviations from the median of the others.
    """
    surfaces = []
    for part, motion in zip(parts, motions, strict=True):
        points = canvas.rays * part.depth_mm[..., None]
        surfaces.append(_Surface(part, points, motion.velocity(points)))
    found = []
    reference = images.reference()
    for surface in surfaces:
        others = [other for other in surfaces if other is not surface]
        samples = [
            _sample(values, surface.pixels(images.camera, time, place), surface, others, canvas, (time, place))
            for values, time, place in images
        ]
        found.append(_mean(np.stack(samples), canvas.extend(reference), surface.part))
    return found


def _sample(
    values: Floats,
    pixels: Floats,
    surface: _Surface,
    others: Sequence[_Surface],
    canvas: Canvas,
    at: tuple[float, Floats],
) -> NDArray[np.float32]:
    """Return the values of one image at the points of a surface; NaN where it does not show them."""
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    if not known.all():
        known = ndimage.binary_erosion(known, iterations=_EDGE_PX, border_value=1)
    places = np.where(np.isfinite(pixels), pixels, -1.0)[..., ::-1].transpose(2, 0, 1)
    height, width = values.shape
    shown = (places[0] >= 0) & (places[0] <= height - 1) & (places[1] >= 0) & (places[1] <= width - 1)
    shown &= surface.part.mask
    nearest = np.rint(places).astype(np.int64)
    shown &= known[np.clip(nearest[0], 0, height - 1), np.clip(nearest[1], 0, width - 1)]
    for other in others:
        shown &= ~_hidden(pixels, surface, other, canvas, at)
    found = np.full(shown.shape, np.nan, dtype=np.float32)
    found[shown] = ndimage.map_coordinates(filled, places[:, shown], order=_SPLINE, mode="mirror")
    return found


def _hidden(
    pixels: Floats, surface: _Surface, other: _Surface, canvas: Canvas, at: tuple[float, Floats]
) -> Mask:  # fmt: skip
    """Return where another surface, nearer than this one, covers pixels of an image."""
    shift = other.pixels(canvas.camera, *at) - canvas.pixels
    shift = np.where(np.isfinite(shift), shift, 0.0)
    inside = np.where(np.isfinite(pixels), pixels, -1e6)
    # The pixel of the reference image that shows the same point of the other surface, by iteration.
    source = inside.copy()
    for _ in range(4):
        places = (source + canvas.margin)[..., ::-1].transpose(2, 0, 1)
        step = [ndimage.map_coordinates(shift[..., axis], places, order=1, mode="nearest") for axis in (0, 1)]
        source = inside - np.stack(step, axis=-1)
    places = (source + canvas.margin)[..., ::-1].transpose(2, 0, 1)
    # A border of one pixel, because edges are located to about one pixel.
    cover = ndimage.binary_dilation(other.part.front)
    covered = ndimage.map_coordinates(cover.astype(np.float32), places, order=1, mode="constant") > 0.5
    depth = ndimage.map_coordinates(other.part.depth_mm, places, order=1, mode="nearest")
    return np.asarray(covered & (depth < surface.part.depth_mm))


def _mean(samples: NDArray[np.float32], reference: Floats, part: SurfacePart) -> ImageMean:
    """Return the mean of samples of all images, shape (n, h, w)."""
    for number, each in enumerate(samples):
        both = np.isfinite(each) & np.isfinite(reference) & part.front
        if both.any():
            # Fluctuations of the light between images.
            gain = float(np.sum(each[both] * reference[both]) / max(float(np.sum(each[both] ** 2)), 1e-12))
            samples[number] *= np.float32(gain)
    with np.errstate(invalid="ignore"):
        shown = np.isfinite(samples)
        ordered = np.sort(samples, axis=0)  # NaN last
        count = shown.sum(axis=0)
        middle = _at_rank(ordered, (count - 1) // 2)
        deviation = np.abs(samples - middle)
        spread = 1.4826 * _at_rank(np.sort(deviation, axis=0), (count - 1) // 2)
        typical = float(np.median(spread[count >= _LEAST_IMAGES])) if (count >= _LEAST_IMAGES).any() else 0.0
        limit = _OUTLIER_STDS * np.maximum(spread, max(typical, _LEAST_SPREAD))
        shown &= (deviation <= limit) | (count < _LEAST_IMAGES)
    kept = np.where(shown, samples, 0).astype(np.float64)
    counts = np.stack([shown[half::2].sum(axis=0) for half in (0, 1)]).astype(np.float64)
    sums = np.stack([kept[half::2].sum(axis=0) for half in (0, 1)])
    total = counts.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums.sum(axis=0) / total
        halves = sums / counts
        square = np.where(shown, (samples - mean) ** 2, 0).sum(axis=0)
        variance = np.where(total >= _LEAST_IMAGES, square / (total - 1), np.nan)
    return ImageMean(mean, halves, counts, variance)


def _at_rank(ordered: NDArray[np.float32], rank: NDArray[np.int64]) -> NDArray[np.float32]:
    return np.asarray(np.take_along_axis(ordered, np.maximum(rank, 0)[None], axis=0)[0])


@dataclass(frozen=True)
class NoiseLine:
    """Variance of the noise of an image over its value, as fractions of full scale: ``dark`` + ``slope`` value."""

    dark: float
    slope: float

    def divided(self, factor: float) -> NoiseLine:
        """Return the line with all variances divided by a factor."""
        return NoiseLine(self.dark / factor, self.slope / factor)

    def variance(self, values: Floats) -> Floats:
        """Return the variance at values."""
        return np.asarray(self.dark + self.slope * np.maximum(values, 0.0))


def fit_noise_line(means: Sequence[ImageMean]) -> NoiseLine | None:
    """Fit the variance between images over their mean; None without pixels that four images show."""
    values = np.concatenate([each.mean[np.isfinite(each.variance)] for each in means])
    variance = np.concatenate([each.variance[np.isfinite(each.variance)] for each in means])
    order = np.argsort(values, kind="stable")
    groups = [group for group in np.array_split(order, _BINS) if len(group) >= _LEAST_BIN]
    if not groups:
        return None
    # The median of a chi-squared variable is below its mean, and edges of surfaces do not change it.
    level = np.array([values[group].mean() for group in groups])
    square = np.array([_robust_mean(variance[group]) for group in groups])
    if len(groups) < 3 or np.ptp(level) < 0.05 * max(level.max(), 1e-12):
        return NoiseLine(float(square.mean()), 0.0)
    slope, dark = np.polyfit(level, square, 1)
    if slope < 0:
        return NoiseLine(float(square.mean()), 0.0)
    if dark < 0:
        return NoiseLine(0.0, float(np.sum(level * square) / np.sum(level**2)))
    return NoiseLine(float(dark), float(slope))


def _robust_mean(values: Floats) -> float:
    """Return the mean without the largest values, above six times the median."""
    return float(values[values <= 6 * np.median(values)].mean())


def make_texture(canvas: Canvas, part: SurfacePart, mean: ImageMean, noise: NoiseLine, seed: int) -> Floats:
    """Return the texture of a surface: radiances at twice the resolution of the canvas.

    The noise that remains in the mean is removed by its power: in four bands of spatial frequency, the local power of
    the mean is reduced by that of the noise, which the difference of two halves of the images shows. The mean over a
    pixel and the interpolation between texels, which the renderer adds, are compensated.
    """
    known = np.isfinite(mean.mean) & part.mask
    if not known.any():
        return np.zeros((_UPSAMPLING * canvas.shape[0], _UPSAMPLING * canvas.shape[1]))
    filled = _fill(mean.mean, known)
    total = np.maximum(mean.counts.sum(axis=0), 1)
    drawn = np.random.default_rng(seed).standard_normal(filled.shape) * np.sqrt(noise.variance(filled) / total)
    remaining = mean.noise()
    remaining = np.where(np.isfinite(remaining) & known, remaining, drawn)
    return np.asarray(_sharpen(_reduce_noise(filled, remaining, known)))


def _fill(values: Floats, known: Mask) -> Floats:
    """Return values with smooth continuations where they are unknown."""
    found = np.where(known, values, 0.0)
    weight = known.astype(np.float64)
    result = np.full(values.shape, float(values[known].mean()))
    for sigma in (32.0, 16.0, 8.0, 4.0, 2.0, 1.0):
        near = ndimage.gaussian_filter(weight, sigma, mode="constant")
        use = near > 0.05
        mean = ndimage.gaussian_filter(found, sigma, mode="constant") / np.maximum(near, 1e-12)
        result[use] = mean[use]
    return np.asarray(np.where(known, values, result))


def _reduce_noise(values: Floats, noise: Floats, known: Mask) -> Floats:
    """Return values whose local power in every band is less by that of the noise."""
    low, low_noise = values, noise
    found = np.zeros(values.shape)
    for sigma in _BANDS_PX:
        smooth, smooth_noise = (ndimage.gaussian_filter(each, sigma, mode="mirror") for each in (low, low_noise))
        band, band_noise = low - smooth, low_noise - smooth_noise
        window = max(8 * sigma, 8.0)
        power = ndimage.gaussian_filter(np.where(known, band**2, 0.0), window, mode="constant")
        power_noise = ndimage.gaussian_filter(np.where(known, band_noise**2, 0.0), window, mode="constant")
        share = 1 - power_noise / np.maximum(power, 1e-300)
        found += band * np.sqrt(np.clip(share, 0.0, 1.0))
        low, low_noise = smooth, smooth_noise
    return np.asarray(found + low)


def _sharpen(values: Floats) -> Floats:
    """Return the texels whose image, averaged over pixels and interpolated, has the given values.

    Cosine transforms have their samples at pixel and texel centres, and no border.
    """
    spectrum = fft.dctn(values, type=2, norm="ortho")
    for axis, size in enumerate(values.shape):
        frequency = np.arange(size) / (2 * size)
        offsets = (np.arange(_SUPERSAMPLING) + 0.5) / _SUPERSAMPLING - 0.5
        pixel = np.cos(2 * np.pi * frequency[:, None] * offsets).mean(axis=1)
        gain = np.minimum(1 / (pixel * np.sinc(frequency / _UPSAMPLING) ** 2), _MOST_GAIN)
        spectrum *= gain[:, None] if axis == 0 else gain
    larger = np.zeros(tuple(_UPSAMPLING * size for size in values.shape))
    larger[: values.shape[0], : values.shape[1]] = spectrum * _UPSAMPLING
    return np.asarray(np.clip(fft.idctn(larger, type=2, norm="ortho"), 0.0, 1.0))
