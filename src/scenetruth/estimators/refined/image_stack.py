"""Images of a fit: window of frames, spline coefficients, and arrays for warping."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.channel_noise import CorrelatedNoise
from scenetruth.estimators.refined.acquisition import PosePriors
from scenetruth.estimators.refined.kernels.warp import CUBIC, QUINTIC, REACH, ImageView
from scenetruth.estimators.refined.lens_distortion import Lens
from scenetruth.estimators.refined.noise_estimation import (
    EVEN,
    GreyVariance,
    estimate_noise,
    resampled_transfer,
    spline_slope_transfer,
    spline_transfer,
)
from scenetruth.estimators.refined.pixel_defects import DefectFilteredFrames
from scenetruth.threads import in_threads

__all__ = [
    "NO_DEFECTS", "FramesNeeded", "ImageStack", "Region", "Splines", "filter_image", "frames_needed", "without_aliases",
]  # fmt: skip

# Smallest ratio of the mean square gradient of a texture to that of the noise in the mean of the images.
_ABOVE_NOISE = 4.0


@dataclass(frozen=True)
class FramesNeeded:
    """Frames of one estimate, as indices along t."""

    output: int
    first: int
    """First frame of the fit."""
    last: int
    """Last frame of the fit + 1."""


def frames_needed(count: int, window: int, *, every: bool) -> list[FramesNeeded]:
    """Return the frames that can be estimated, with the frames of each fit.

    >>> [frames.output for frames in frames_needed(9, 9, every=False)]
    [4]
    >>> frames_needed(3, 9, every=True)[0]
    FramesNeeded(output=0, first=0, last=3)
    """
    window = window if every else min(window, count)
    before = (window - 1) // 2
    after = window - before
    return [
        FramesNeeded(n, max(n - before, 0), min(n + after, count))
        for n in range(count)
        if every or (n >= before and n + after <= count)
    ]


class Splines:
    """Spline coefficients, order 3 or 5, of the images of a window of frames; each frame is transformed once."""

    def __init__(self, images: DefectFilteredFrames, order: int) -> None:
        self._images, self._order = images, order
        self._held: dict[int, NDArray[np.float32]] = {}

    def frames(self, first: int, last: int) -> list[NDArray[np.float32]]:
        """Return the coefficients of consecutive frames, shape (channel, s, y, x) each."""
        for frame in [frame for frame in self._held if not first <= frame < last]:
            del self._held[frame]
        for frame in range(first, last):
            if frame not in self._held:
                self._held[frame] = _coefficients(self._images.frames(frame, frame + 1)[:, :, 0], self._order)
        return [self._held[frame] for frame in range(first, last)]


def _coefficients(images: NDArray[Any], order: int) -> NDArray[np.float32]:
    out = np.empty(images.shape, dtype=np.float32)

    def transform(index: tuple[int, int]) -> None:
        out[index] = filter_image(images[index], order)

    in_threads(transform, list(np.ndindex(images.shape[:2])))
    return out


def filter_image(image: NDArray[Any], order: int) -> Map:
    """Return the spline coefficients of an image, mirrored at its border."""
    from scipy.ndimage import spline_filter

    return np.asarray(spline_filter(image.astype(np.float64), order, mode="mirror"))


_LEAST_OF_RESIDUAL = 1e-3  # smallest part of a mean square residual that is due to noise


def without_aliases(square: NDArray[Any], by_aliases: Map | None) -> NDArray[Any]:
    """Return mean square residuals without those by aliases of demosaicing, the first of the maps (n, y, x)."""
    return square if by_aliases is None else np.maximum(square - by_aliases[0], _LEAST_OF_RESIDUAL * square)


# Values of B-splines at integer positions, by order.
_VALUES = {CUBIC: np.array([1.0, 4.0, 1.0]) / 6.0, QUINTIC: np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0}

NO_DEFECTS = np.zeros((0, 0, 0), dtype=np.uint8)
NO_LENS = np.zeros(0)

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Region:
    """Rectangle of the reference image, whose pixels are estimated together."""

    top: int
    left: int
    height: int
    width: int
    whole: tuple[int, int]
    """Numbers of rows and columns of the image."""

    @property
    def rows(self) -> slice:
        """Rows of the image."""
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        """Columns of the image."""
        return slice(self.left, self.left + self.width)


@dataclass(frozen=True, eq=False)
class ImageStack:
    """Images that are fitted together.

    ``coefficients``: Spline coefficients by frame, shape (channel, s, y, x) each.
    ``positions``: Positions (s, s_y) of the cameras in steps, shape (cameras, 2).
    ``times``: Times of the reference camera's images relative to the estimated frame.
    ``focal``, ``centre``: Focal length, and principal point (x, y), in columns and rows of the region.
    ``moved``: Pose correction of every image in the order of `stack`, as in `warp.corrected`, shape (n, 4).
    ``bad``: Nonzero at pixels whose surroundings must not be sampled, by frame, shape (s, y, x) each; empty if none.
    ``left_out``: Excluded images, as indices of frame and camera.
    ``delays``: Times of the images of a frame after that of its reference camera, in frames, shape (frames, cameras);
      None if they are simultaneous.
    ``shutter``: Rolling shutter: frames and stage steps from one row to the next.
    ``lens``: Distortion of the images; None for a pinhole camera. Maps of a fit are those of a pinhole camera.
    ``priors``: Prior standard deviations of the pose errors; None if poses are taken as exact.
    ``region``: Pixels of the reference that are estimated; None for all of them.
    ``origin``: Column and row of the region at which the array of each image begins, in the order of `stack`, shape
      (n, 2); None if all begin at the first pixel.
    ``beside``: A larger region and its initial fields, whose points may occlude those of the region; None if there are
      none.
    ``noise``: Residual of windows that fit well; None if it is estimated from those of this stack. If it is given, so
      are the excluded images and ``variance``: all are properties of whole images, from a sample of them.
    ``noise_of_plain``: The same of the plain motion model, before others are fitted.
    ``noise_limit``: Largest residual of windows that fit well.
    ``noise_share``: Variance of the noise after a resampling of the images, relative to that before, at the pixels of
      the whole image: mean over all images, and that of the reference, shape (2, y, x); None for images as recorded.
    ``demosaiced``: Noise of the demosaicing; None for images that were not demosaiced.
    """

    coefficients: list[NDArray[np.float32]]
    positions: Map
    times: Map
    focal: float
    centre: tuple[float, float]
    moved: Map
    bad: list[NDArray[np.uint8]] = field(default_factory=list)
    left_out: frozenset[tuple[int, int]] = frozenset()
    variance: GreyVariance = EVEN
    spline: int = QUINTIC
    delays: Map | None = None
    shutter: tuple[float, float] = (0.0, 0.0)
    lens: Lens | None = None
    priors: PosePriors | None = None
    region: Region | None = None
    origin: Map | None = None
    noise: float | None = None
    noise_of_plain: float | None = None
    beside: tuple[Region, Map] | None = None
    noise_limit: float = math.inf
    noise_share: Map | None = None
    demosaiced: CorrelatedNoise | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns that are estimated."""
        return self._array_shape if self.region is None else (self.region.height, self.region.width)

    @property
    def whole_shape(self) -> tuple[int, int]:
        """Numbers of rows and columns of the images."""
        return self._array_shape if self.region is None else self.region.whole

    @property
    def _array_shape(self) -> tuple[int, int]:
        height, width = self.coefficients[0].shape[-2:]
        return height, width

    @property
    def corner(self) -> tuple[int, int]:
        """Column and row of the image at which the region begins."""
        return (0, 0) if self.region is None else (self.region.left, self.region.top)

    @property
    def bounds(self) -> tuple[int, int, int, int]:
        """First column and row, and last column and row, of the images, counted from the first pixel of the region."""
        (left, top), (height, width) = self.corner, self.whole_shape
        return -left, -top, width - 1 - left, height - 1 - top

    @property
    def sampled_bounds(self) -> tuple[int, int, int, int]:
        """As ``bounds``, of the places at which splines have all their samples."""
        left, top, right, bottom = self.bounds
        return left + REACH, top + REACH, right - REACH, bottom - REACH

    @property
    def channels(self) -> int:
        """Number of colour channels."""
        return len(self.coefficients[0])

    @property
    def transfer(self) -> float:
        """Ratio of the standard deviation of residuals due to noise to that of the noise of recorded images."""
        if self.noise_share is None:
            return spline_transfer(self.spline)
        return float(resampled_transfer(self.spline, self.mean_share))

    @property
    def noise_ratio(self) -> float:
        """Variance of fits by noise relative to that which residuals state, if these are noise; 1 as recorded.

        Residuals that may be those of aliases have 1, until `RefinedState.noise_ratio` is measured.
        """
        if self.demosaiced is None or self.demosaiced.aliases:
            return 1.0
        return (spline_transfer(self.spline) / self.transfer) ** 2

    def noise_gradient(
        self, noise: float | Map, images: int | NDArray[np.floating[Any]] | None = None, *, of_residual: bool = False
    ) -> Any:
        """Return the mean square gradient of the mean image that noise causes, in squares of grey values per px.

        ``noise``: Standard deviation of white noise of the power at low frequencies, or of residuals that it leaves.
        ``images``: Number of images in the mean, possibly of every window; None for all.
        """
        if self.demosaiced is not None:
            # Demosaicing reduces the gradients of noise more than its residuals.
            noise = noise * math.sqrt(self.demosaiced.of_gradient)
            noise = noise * (spline_transfer(self.spline) / self.transfer) if of_residual else noise
        return 2.0 * (spline_slope_transfer(self.spline) * noise) ** 2 / (self.count if images is None else images)

    def is_textured(
        self,
        mean_square_gradient: Map,
        noise: float | Map,
        images: int | NDArray[np.floating[Any]] | None = None,
        *,
        of_residual: bool = False,
    ) -> NDArray[np.bool_]:
        """Return where the windowed mean square gradient of the mean image exceeds that of noise, see above."""
        with np.errstate(invalid="ignore", divide="ignore"):
            by_noise = self.noise_gradient(noise, images, of_residual=of_residual)
            return np.asarray(mean_square_gradient > _ABOVE_NOISE * by_noise)

    @property
    def mean_share(self) -> float:
        """Mean of the noise share over all images; 1 for images as they were recorded."""
        return 1.0 if self.noise_share is None else float(np.mean(self.noise_share[0]))

    @property
    def reference_share(self) -> Map | float:
        """Noise share of the reference at every pixel of the region, shape (y, x); 1 for images as recorded."""
        return 1.0 if self.noise_share is None else self._of_region(self.noise_share[1])

    def _of_region(self, values: Map) -> Map:
        return values if self.region is None else values[self.region.rows, self.region.columns]

    @property
    def transfers(self) -> Map | float:
        """Ratio as `transfer` of every pixel of the region, shape (y, x), or of all."""
        if self.noise_share is None:
            return spline_transfer(self.spline)
        return np.asarray(resampled_transfer(self.spline, self._of_region(self.noise_share[0])))

    def transfers_of(self, square: Map, by_aliases: Map | None, coupling: Map | float = 1.0) -> Map | float:
        """Return the ratio as `transfers`, of mean square residuals with those by aliases, which are not correlated.

        ``coupling``: Variance of a fit by correlated noise relative to that by white noise.
        """
        transfers = self.transfers / np.sqrt(coupling) if self.demosaiced is not None else self.transfers
        if by_aliases is None:
            return transfers
        with np.errstate(invalid="ignore", divide="ignore"):
            share = without_aliases(square, by_aliases) / square
        inverse = share / transfers**2 + (1.0 - share) / spline_transfer(self.spline) ** 2
        return np.asarray(1.0 / np.sqrt(inverse))

    @property
    def farthest(self) -> float:
        """Distance of the farthest camera, in steps."""
        return float(np.hypot(*self.positions.T).max())

    @property
    def longest(self) -> float:
        """Time to the farthest frame, in frames."""
        return float(np.abs(self.times).max())

    @property
    def aside(self) -> float:
        """Largest ratio of the image displacement due to U_Z = Z to that due to U_X = Z."""
        return max(at + first for at, first in zip(self.centre, self.corner, strict=True)) / self.focal

    @property
    def frames(self) -> int:
        """Number of frames with at least one image that is not excluded."""
        cameras = range(len(self.positions))
        return sum(any((frame, s) not in self.left_out for s in cameras) for frame in range(len(self.times)))

    def within(self, reach: float) -> ImageStack:
        """Return the images of the frames up to a distance before and after."""
        return self._of(np.flatnonzero(np.abs(self.times) <= reach))

    def few(self) -> ImageStack:
        """Return the images of the first, the estimated and the last frame."""
        return self._of(np.unique([np.argmin(self.times), np.argmin(np.abs(self.times)), np.argmax(self.times)]))

    def included(self) -> ImageStack:
        """Return the images of the frames that are not excluded as a whole."""
        count = len(self.positions)
        lost = np.bincount([frame for frame, _ in self.left_out], minlength=len(self.times)) == count
        return self._of(np.flatnonzero(~lost)) if lost.any() and not lost.all() else self

    def pair(self, frame: int) -> ImageStack:
        """Return the images of the estimated frame and of another one; all of them, if all of that are excluded."""
        found = self._of(np.unique([np.argmin(np.abs(self.times)), frame]))
        place = int(np.argmax(np.abs(found.times)))
        left_out = {image for image in found.left_out if image[0] == place}
        return found.without(found.left_out - left_out) if len(left_out) == len(self.positions) else found

    def _of(self, frames: NDArray[np.intp]) -> ImageStack:
        return replace(
            self,
            coefficients=[self.coefficients[n] for n in frames] if self.coefficients else [],
            times=self.times[frames],
            moved=self.moved.reshape(len(self.times), -1, 4)[frames].reshape(-1, 4),
            origin=None if self.origin is None else self.origin.reshape(len(self.times), -1, 2)[frames].reshape(-1, 2),
            bad=[self.bad[n] for n in frames] if self.bad else [],
            delays=None if self.delays is None else self.delays[frames],
            left_out=frozenset((place, s) for place, n in enumerate(frames) for t, s in self.left_out if t == n),
        )

    def without(self, left_out: Iterable[tuple[int, int]]) -> ImageStack:
        """Return the images with another set of excluded images."""
        return replace(self, left_out=frozenset(left_out))

    @property
    def count(self) -> int:
        """Number of images that are not excluded."""
        return len(self.times) * len(self.positions) - len(self.left_out)

    def stack(self, channel: int) -> list[NDArray[np.float32]]:
        """Return the coefficients of one channel by frame, shape (s, y, x) each."""
        return [part[channel] for part in self.coefficients]

    def bad_stack(self) -> list[NDArray[np.uint8]]:
        """Return where images must not be sampled, in the order of `stack`, by frame; shape (0, 0, 0) if nowhere."""
        shape = (len(self.positions), *self._array_shape)
        found = []
        for frame in range(len(self.times)):
            excluded = [camera for left_out, camera in self.left_out if left_out == frame]
            flags = self.bad[frame] if self.bad else NO_DEFECTS
            # Frames without defects are arrays of a single number.
            flags = flags if flags.any() else NO_DEFECTS
            if excluded:
                flags = flags.copy() if len(flags) else np.zeros(shape, dtype=np.uint8)
                flags[excluded] = 1
            found.append(flags)
        return found

    def view(self) -> ImageView:
        """Return positions, times and corrections of all images, in the order of `stack`."""
        # Contiguous also for a single frame, so that kernels are compiled once.
        s, s_y = np.ascontiguousarray(np.tile(self.positions.T, len(self.times)))
        t = np.repeat(self.times, len(self.positions))
        t = t if self.delays is None else t + self.delays.ravel()
        lens = NO_LENS if self.lens is None else self.lens.kernel
        view = ImageView(s, s_y, t, self.moved, self.focal, *self.centre, self.spline, *self.shutter, lens)
        return view if self.origin is None else view._replace(origin=self.origin, size=self._array_shape)

    def view_of(self, places: list[int]) -> ImageView:
        """Return positions, times and corrections of some images, by their indices in `stack`."""
        whole = self.view()
        origin = whole.origin if self.origin is None else self.origin[places]
        parts = {name: getattr(whole, name)[places] for name in ("s", "s_y", "t", "moved")}
        return whole._replace(**parts, origin=origin)

    def whole_view(self) -> ImageView:
        """Return positions, times and corrections of all images, with the principal point in whole images."""
        view = self.view()
        return view._replace(centre_x=view.centre_x + self.corner[0], centre_y=view.centre_y + self.corner[1])

    def reference(self) -> tuple[int, int]:
        """Return the indices of frame and camera of the reference image."""
        return int(np.argmin(np.abs(self.times))), int(np.argmin(np.abs(self.positions).sum(axis=1)))

    def cut(self, array: NDArray[Any], frame: int, camera: int) -> NDArray[Any]:
        """Return the region of the array of an image, a view if the array contains the region, as for the reference."""
        if self.origin is None:
            return array
        starts = (-self.origin[frame * len(self.positions) + camera][::-1]).astype(int).tolist()
        sizes = list(zip(starts, self.shape, array.shape, strict=True))
        if all(0 <= start <= size - count for start, count, size in sizes):
            return array[tuple(slice(start, start + count) for start, count, _ in sizes)]
        rows, columns = (np.clip(np.arange(start, start + count), 0, size - 1) for start, count, size in sizes)
        return np.asarray(array[np.ix_(rows, columns)])

    def usable(self, frame: int, camera: int) -> NDArray[np.bool_]:
        """Return the pixels of an image without defects, shape (y, x)."""
        if not self.bad:
            return np.ones(self.shape, dtype=np.bool_)
        return np.asarray(self.cut(self.bad[frame][camera], frame, camera) == 0)

    def grey(self, frame: int, camera: int, channel: int) -> Map:
        """Return the grey values of an image, shape (y, x), without distortion."""
        from scipy.ndimage import convolve1d

        image: Map = self.coefficients[frame][channel, camera].astype(np.float64)
        if self.lens is not None:
            at = None if self.origin is None else self.origin[frame * len(self.positions) + camera]
            return self.lens.sample(image, self.spline, at)
        image = self.cut(image, frame, camera)
        for axis in (0, 1):
            image = np.asarray(convolve1d(image, _VALUES[self.spline], axis=axis, mode="mirror"))
        return image

    def reference_grey(self) -> Map:
        """Return the grey values of the reference, averaged over channels, shape (y, x)."""
        return np.asarray(np.mean([self.grey(*self.reference(), channel) for channel in range(self.channels)], axis=0))

    def mean_grey(self) -> float:
        """Return the mean grey value of the reference."""
        return float(np.mean([self.grey(*self.reference(), channel) for channel in range(self.channels)]))

    def residual_noise(self, square: NDArray[Any], *, of_plain: bool = False) -> float:
        """Return the residual of windows that fit well, from the mean square residuals of windows.

        It is at least the rounding of the images: blank parts of images without noise have no residual.

        ``of_plain``: Whether the residuals are those of the plain motion model, before others are fitted.
        """
        given = self.noise_of_plain if of_plain else self.noise
        found = estimate_noise(np.sqrt(square)) if given is None else given
        if math.isnan(found):
            return found
        frame, camera = self.reference()
        largest = float(np.nanmax(np.abs(self.coefficients[frame][:, camera])))
        return max(min(found, self.noise_limit), float(np.finfo(np.float32).eps) * largest)

    def moved_px(self, before: Map, after: Map) -> Map:
        """Return the largest displacement over all images, in px, due to a change of fields, shape (4 or 7, ...)."""
        steps = np.abs(after - before)
        first, *others = self.arms(len(steps))
        moved = steps[0] * first
        for step, arm in zip(steps[1:], others, strict=True):
            moved = np.maximum(moved, step * np.abs(before[0]) * arm)
        return np.asarray(moved)

    def arms(self, fields: int) -> NDArray[np.float64]:
        """Return the displacements in px by a unit of disparity, and by one of velocity and acceleration times it."""
        each = self.longest * np.array([1.0, 1.0, self.aside])
        return np.array([self.farthest, *each, *(0.5 * self.longest * each)])[:fields]
