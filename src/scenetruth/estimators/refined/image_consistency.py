"""Detection of inconsistent images, which contradict the others, and report of all exclusions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateWarning
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.agreement import correlate_images
from scenetruth.estimators.refined.kernels.warp import warp_rows
from scenetruth.threads import in_threads

__all__ = [
    "ExclusionReport",
    "ImageAgreement",
    "compute_agreement",
    "describe_missing_contrast",
    "find_inconsistent_images",
    "find_inconsistent_of_regions",
    "fine_contrast",
    "replace_reference",
]


_CUT, _ROWS = 2.0, 6  # blocks are squares of window size; number of rows of blocks evaluated
# Smallest median correlation of an informative block with the mean of the other images; smallest number of such blocks;
# and smallest usable fraction of a block in an image.
_AGREE, _LEAST_BLOCKS, _LEAST_SHARE = 0.5, 3, 0.5
_LEAST_IMAGES = 3  # with fewer images, there is no mean of the others
_TEXTURED, _UPPER = 0.25, 90  # a block is textured if its contrast is at least this fraction of the 90th percentile
# An image is excluded if its median correlation is below this fraction of that of the median image, or if less than
# this fraction of it is usable.
_FAR_BELOW, _LEAST_USABLE = 0.5, 0.1
# Smallest number of images that must remain, for one camera or frame and for several; and fraction below which images
# may be excluded.
_REMAIN, _REMAIN_OF_BOTH, _MOST_LEFT = 4, 7, 1 / 4

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImageAgreement:
    """Agreement of images warped by the same fields."""

    images: Map
    """Correlation of each image with the mean of all others, median over the informative blocks; NaN for an image with
    too few of them, shape (n,)."""
    blocks: float
    """Fraction of the textured blocks that are visible in half of the images, and agree."""


def compute_agreement(images: ImageStack, fields: Map, sigma_px: float, *, even: bool = False) -> ImageAgreement:
    """Correlate every image with the mean of all others, block by block, for fields of shape (4, y, x)."""
    return judge_blocks([correlate_blocks(images, fields, sigma_px, even=even)])


def correlate_blocks(images: ImageStack, fields: Map, sigma_px: float, *, even: bool) -> tuple[Map, Map]:
    """Return the correlations of the images in blocks with the mean of all others, shape (blocks, n), and contrasts."""
    height, width = images.shape
    edge = min(2 * math.ceil(_CUT * sigma_px) + 1, height, width)
    rows = np.unique(np.linspace(0, height - edge, min(_ROWS, height // edge)).round().astype(np.intp))
    view, bad = images.view(), images.without(()).bad_stack()
    fields = fields.copy()
    columns = range(0, width - edge + 1, edge)
    for row, left in product(rows if even else (), columns):
        block = fields[:, row : row + edge, left : left + edge]
        block[:] = np.median(block, axis=(1, 2), keepdims=True)
    count = len(view.s)
    stacks = [images.stack(channel) for channel in range(images.channels)]
    jobs = [(stack, int(row)) for stack in stacks for row in rows]
    parts: dict[int, tuple[Map, Map]] = {}

    def work(number: int) -> None:
        stack, row = jobs[number]
        warped = np.empty((count, edge, width), dtype=np.float32)
        gradient = np.empty((2, edge, width), dtype=np.float32)
        warp_rows(stack, view, fields, np.zeros((0, 0, 0), np.uint8), bad, row, warped, gradient, (0, edge))
        found, contrast = (np.empty((len(columns), count)) for _ in range(2))
        for place, left in enumerate(columns):
            correlate_images(warped, (left, left + edge), _LEAST_SHARE, found[place], contrast[place])
        shown = np.isfinite(contrast).any(axis=1)
        middle = np.zeros(len(columns))
        middle[shown] = np.nanmedian(contrast[shown], axis=1)
        parts[number] = found, middle

    in_threads(work, range(len(jobs)))
    found, contrasts = zip(*(parts[n] for n in range(len(jobs))), strict=True)
    return np.concatenate(found), np.concatenate(contrasts)


def judge_blocks(blocks: Sequence[tuple[Map, Map]]) -> ImageAgreement:
    """Return the agreement of images from the blocks of one region or several."""
    each, contrast = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    enough = np.isfinite(each).sum(axis=1) >= _LEAST_IMAGES
    middle = np.full(len(each), -np.inf)
    middle[enough] = np.nanmedian(each[enough], axis=1)
    tell = middle >= _AGREE
    textured = enough & (contrast >= _TEXTURED * np.percentile(contrast, _UPPER)) & (contrast > 0)
    scores = np.full(each.shape[1], np.nan)
    shown = np.isfinite(each[tell]).sum(axis=0) >= _LEAST_BLOCKS
    if shown.any():
        scores[shown] = np.nanmedian(each[tell][:, shown], axis=0)
    # With a wrong initial estimate, two of many cameras may agree by chance outside the view of the others.
    most = np.median(np.nan_to_num(each), axis=1) >= _AGREE
    return ImageAgreement(scores, float((most & textured).sum() / max(textured.sum(), 1)))


def find_inconsistent_images(
    images: ImageStack, fields: Map, sigma_px: float, part: ImageStack
) -> frozenset[tuple[int, int]]:
    """Return the images that contradict the others, as indices of frame and camera.

    Their correlation with the mean of the others is below half of the usual value, due to a shift by a sixth of a
    texture wavelength in most windows, another scene, or missing contrast. With few images, the inconsistent image
    cannot be identified: a shifted reference agrees with all frames of a second camera and one frame of its own, with
    another depth and a motion in depth. Therefore four must remain, of several cameras and frames seven, and more than
    three quarters; images without contrast are not counted.
    """
    if images.noise is not None:
        return part.left_out
    cameras = len(images.positions)
    least = _REMAIN if min(cameras, len(images.times)) == 1 else _REMAIN_OF_BOTH
    if len(part.times) * cameras <= least and len(part.times) < len(images.times):
        places = {int(frame): n for n, frame in enumerate(np.flatnonzero(np.isin(images.times, part.times)))}
        every = find_inconsistent_images(images, fields, sigma_px, images)
        return frozenset((places[frame], camera) for frame, camera in every if frame in places)
    return find_inconsistent_of_regions([(part, fields)], sigma_px)


def find_inconsistent_of_regions(
    regions: Sequence[tuple[ImageStack, Map]], sigma_px: float
) -> frozenset[tuple[int, int]]:
    """Return the images that contradict the others in regions with fields, as `find_inconsistent_images`."""
    part, _ = regions[0]
    cameras = len(part.positions)
    least = _REMAIN if min(cameras, len(part.times)) == 1 else _REMAIN_OF_BOTH
    found = {
        (frame, camera)
        for frame in range(len(part.bad))
        for camera in range(cameras)
        if np.mean([each.bad[frame][camera].mean() for each, _ in regions if each.bad]) > 1.0 - _LEAST_USABLE
    }
    scores = judge_blocks([correlate_blocks(each, fields, sigma_px, even=False) for each, fields in regions]).images
    off = scores == 0
    shown = np.isfinite(scores) & ~off
    if shown.any():
        low = shown & (scores < _FAR_BELOW * np.median(scores[shown]))
        if low.sum() < _MOST_LEFT * shown.sum() and shown.sum() - low.sum() >= least:
            off |= low
    found |= {(int(n) // cameras, int(n) % cameras) for n in np.flatnonzero(off)}
    # If nearly all pixels of all images are saturated, no image is an exception.
    return frozenset(found) if len(found) < cameras * len(part.times) else frozenset()


# Power of the noise share by which a quintic resampling reduces second differences of noise, to 10 %.
_SHARE_POWER = 2.6


def fine_contrast(images: ImageStack, sigma_px: float) -> Map:
    """Return the standard deviation (y, x) of noise and finest texture of an image, infinite at too few valid pixels.

    Correct fits have no larger residual; if all fits are wrong, their residuals are no reference. Second differences
    along x and y, divided by 6, preserve the power of white noise and suppress texture.
    """
    from scipy.ndimage import convolve1d, gaussian_filter

    frame, camera = _nearest_included(images)
    usable = images.usable(frame, camera).astype(np.float64)
    squares = np.zeros(images.shape)
    second = np.array([1.0, -2.0, 1.0]) / np.sqrt(6.0)
    for channel in range(images.channels):
        grey = images.grey(frame, camera, channel)
        squares += convolve1d(convolve1d(grey, second, 0, mode="mirror"), second, 1, mode="mirror") ** 2
    squares /= images.reference_share**_SHARE_POWER
    share = gaussian_filter(usable, sigma_px)
    mean = gaussian_filter(usable * squares, sigma_px) / images.channels / np.maximum(share, _LEAST_USABLE)
    return np.where(share > _LEAST_USABLE, np.sqrt(mean), np.inf)


def _nearest_included(images: ImageStack) -> tuple[int, int]:
    """Return frame and camera of the image nearest to the reference that is not excluded."""
    cameras, view = len(images.positions), images.view()
    order = np.lexsort((np.hypot(view.s, view.s_y), np.abs(view.t)))
    place = next(int(n) for n in order if (int(n) // cameras, int(n) % cameras) not in images.left_out)
    return place // cameras, place % cameras


def replace_reference(images: ImageStack, fields: Map) -> ImageStack:
    """Return the images with an excluded reference replaced by the nearest other image, warped by fields (n, y, x)."""
    reference, nearest = images.reference(), _nearest_included(images)
    if reference not in images.left_out:
        return images
    from scipy.ndimage import spline_filter

    place = nearest[0] * len(images.positions) + nearest[1]
    view = images.view_of([place])
    bad = images.bad[nearest[0]][[nearest[1]]] if images.bad else np.zeros((0, 0, 0), dtype=np.uint8)
    coefficients = [frame.copy() for frame in images.coefficients]
    missing = np.zeros(images.shape, dtype=np.bool_)
    for channel in range(images.channels):
        stack = images.coefficients[nearest[0]][channel, [nearest[1]]]
        warped = np.empty((1, *images.shape), dtype=np.float32)
        gradient = np.empty((2, *images.shape), dtype=np.float32)
        rows = (0, images.shape[0])
        warp_rows(
            stack, view, np.ascontiguousarray(fields), np.zeros((0, 0, 0), np.uint8), bad, 0, warped, gradient, rows
        )
        missing |= np.isnan(warped[0])
        grey = np.where(missing, np.nanmean(warped[0]) if not missing.all() else 0.0, warped[0]).astype(np.float64)
        out = images.cut(coefficients[reference[0]][channel, reference[1]], *reference)
        out[:] = spline_filter(grey, images.spline, mode="mirror")
    flags = [each.copy() for each in images.bad] or [np.zeros(each.shape[1:], np.uint8) for each in coefficients]
    images.cut(flags[reference[0]][reference[1]], *reference)[:] = missing
    return replace(images, coefficients=coefficients, bad=flags, left_out=images.left_out - {reference})


# Frames of the call stack up to the caller of `scenetruth.estimate`, to whose line the warning refers.
_CALLER = 7
_MOST_NAMED = 6
_FEW_OF_FRAME = 0.5  # largest fraction of the cameras of a frame whose exclusion indicates no motion
_BLANK_SHARE = 0.9  # share of excluded pixels of an image that the user leaves out


def describe_missing_contrast(images: ImageStack) -> str:
    """Return why identical images determine no estimate; empty if they differ."""
    first = images.coefficients[0][:, :1]
    alike = [bool((frame == frame[:, :1]).all()) for frame in images.coefficients]
    if all(alike) and all(np.array_equal(frame[:, :1], first) for frame in images.coefficients):
        return "all images are equal and determine neither depth nor motion"
    if len(images.positions) > 1 and all(alike):
        return "the images of all cameras are equal in every frame: no disparity, hence no depth"
    return ""


class ExclusionReport:
    """Record of excluded images and of frames without an estimate, identified by the coordinates of the recording."""

    def __init__(self, recording: xr.Dataset) -> None:
        self._recording = recording
        self._t = recording["t"].values.tolist()
        self._dims = [dim for dim in ("s_y", "s") if dim in recording["image"].dims]
        self._cameras = list(product(*(recording[dim].values.tolist() for dim in self._dims)))
        self._left_out: set[tuple[int, ...]] = set()
        self._reasons: dict[str, str] = {}

    def leave_out(self, first: int, images: frozenset[tuple[int, int]]) -> None:
        """Add excluded images."""
        self._left_out |= {(*self._cameras[camera], self._t[first + frame]) for frame, camera in images}

    def report_invalid_frame(self, frame: int, reason: str) -> None:
        """Add a frame without an estimate."""
        self._reasons[str(self._t[frame])] = reason

    def _is_blank(self, image: tuple[int, ...]) -> bool:
        """Return whether the user has excluded nearly all pixels of an image, by its mask or as NaN."""
        at = dict(zip([*self._dims, "t"], image, strict=True))
        values = self._recording["image"].sel(at).values
        bad = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, dtype=np.bool_)
        bad = bad.any(axis=-1) if "channel" in self._recording["image"].dims else bad
        if "exclusion_mask" in self._recording:
            mask = self._recording["exclusion_mask"]
            bad = bad | mask.sel({dim: n for dim, n in at.items() if dim in mask.dims}).values
        return float(bad.mean()) > _BLANK_SHARE

    def _list_causes(self, images: Sequence[tuple[int, ...]]) -> str:
        """Return possible causes: a camera is moved by itself; a motion concerns most cameras of a frame."""
        causes = "a camera that was moved, a wrong file or a wrong exposure"
        of_frame = [sum(image[-1] == t for image in images) for t in {image[-1] for image in images}]
        if len(self._cameras) == 1 or max(of_frame) <= _FEW_OF_FRAME * len(self._cameras):
            return causes
        motion = "a motion that is not uniformly accelerated over the frames of the window (reduce window_frames)"
        return f"{motion}, {causes}"

    def attributes(self) -> dict[str, Any]:
        """Return the attributes of the estimate, and warn about exclusions that the user has not made."""
        named = sorted(self._left_out)
        unexpected = [image for image in named if not self._is_blank(image)]
        if unexpected:
            dims = [*self._dims, "t"]
            spelled = ([f"{dim} {n}" for dim, n in zip(dims, image, strict=True)] for image in unexpected[:_MOST_NAMED])
            listed = ", ".join(f"({', '.join(each)})" for each in spelled)
            more = f" and {len(unexpected) - _MOST_NAMED} more" if len(unexpected) > _MOST_NAMED else ""
            message = (
                f"images: {listed}{more} are excluded because they contradict the other images; check for "
                f"{self._list_causes(unexpected)} (attribute excluded_images)"
            )
            warnings.warn(message, EstimateWarning, stacklevel=_CALLER)
        for frame, reason in self._reasons.items():
            warnings.warn(f"frame {frame}: no estimate: {reason}", EstimateWarning, stacklevel=_CALLER)
        return {"excluded_images": [list(image) for image in named], "frames_without_estimate": self._reasons}
