"""Common parts of the methods based on OpenCV: 8-bit grey images, stereo matching and optical flow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from math import prod
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scenetruth.errors import Problem
from scenetruth.estimators.protocol import MethodSettings
from scenetruth.progress import Progress
from scenetruth.schema import compute_pixel_grid

__all__ = [
    "FlowSettings",
    "StereoSettings",
    "camera_problems",
    "cv2_problems",
    "disparities",
    "disparity_between",
    "eight_bit_images",
    "flow_between",
    "flows",
    "outer_percentiles",
]


Values = NDArray[np.float64]


def outer_percentiles(parts: Iterable[Values], percent: float, most: int) -> tuple[float, float]:
    """Return the lower and upper percentiles of all values together, exactly as `numpy.nanpercentile`.

    Only one part and about twice the values beyond the percentiles are in memory.

    >>> outer_percentiles([np.array([3.0, 1.0]), np.array([[2.0], [np.nan]])], 25, 4)
    (1.5, 2.5)
    """
    quantiles = np.true_divide((percent, 100 - percent), 100)
    count = int(most * quantiles[0]) + 3
    lowest, highest, known = _Least(count), _Least(count), 0
    for part in parts:
        values = part[~np.isnan(part)]
        known += values.size
        lowest.add(values)
        highest.add(-values)
    if known == 0:
        # NaN, with NumPy's warning.
        low, high = np.nanquantile([np.nan], quantiles).tolist()
        return low, high
    least, greatest = lowest.in_order(), -highest.in_order()

    def between(place: float) -> float:
        """Return the value at a fractional rank, interpolated linearly."""
        below = int(place)
        ranks = (below, min(below + 1, known - 1))
        pair = [least[rank] if rank < least.size else greatest[known - 1 - rank] for rank in ranks]
        return float(np.quantile(pair, place - below))

    return between((known - 1) * quantiles[0]), between((known - 1) * quantiles[1])


class _Least:
    """Collects the smallest of the values that are added, at least ``count`` of them."""

    def __init__(self, count: int) -> None:
        self._count, self._bound = count, np.inf
        self._kept: list[Values] = []
        self._size = 0

    def add(self, values: Values) -> None:
        self._kept.append(values[values <= self._bound])
        self._size += self._kept[-1].size
        if self._size > 2 * self._count:
            least = np.partition(np.concatenate(self._kept), self._count - 1)[: self._count]
            self._kept, self._size, self._bound = [least], least.size, float(least[-1])

    def in_order(self) -> Values:
        return np.sort(np.concatenate(self._kept))


Map = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]
GreyImages = Callable[[int, int], tuple[Bytes, Mask | None]]
"""Return the image of a camera s in a frame, counted from 0: uint8 of shape (y, x), and its invalid pixels, if any."""

# Images in the cache: two cameras and two frames.
_HELD = 4
_SIXTEENTHS = 16
_PATCH_PX = 8  # side length of the patches of dense inverse search
_LEAST_WIDTH = 160  # smallest number of columns that suffices to determine the disparity range


class StereoSettings(MethodSettings):
    """Settings of the OpenCV stereo matching of a rectified pair."""

    stereo: Literal["sgbm", "bm"] = "sgbm"
    """Stereo matching: ``sgbm``, semi-global block matching; ``bm``, local block matching."""
    camera: Annotated[int, Field(ge=-1001, le=1001)] | None = None
    """Position s that is matched with the reference s = 0; null: the nearest, of two equally near the right one."""
    min_disparity_px: Annotated[int, Field(ge=0, le=32768)] | Literal["auto"] = "auto"
    """Smallest disparity between the two images in px; ``auto`` estimates the range from the images."""
    disparity_range_px: Annotated[int, Field(ge=16, le=32768, multiple_of=16)] = 32
    """Number of disparities searched from the smallest: a multiple of 16."""
    stereo_block_px: Annotated[int, Field(ge=1, le=255)] | None = None
    """Side length of the blocks, odd; null: 7 for ``sgbm``, 21 for ``bm``."""

    @model_validator(mode="after")
    def _block(self) -> StereoSettings:
        block = self.stereo_block_px
        least = 5 if self.stereo == "bm" else 1
        if block is not None and (block % 2 == 0 or block < least):
            msg = f"stereo_block_px must be odd and at least {least} for '{self.stereo}' (got {block})"
            raise ValueError(msg)
        return self


class FlowSettings(MethodSettings):
    """Settings of the OpenCV optical flow between consecutive frames."""

    flow: Literal["farneback", "dis"] = "farneback"
    """Optical flow: ``farneback``, polynomial expansion; ``dis``, dense inverse search (medium preset)."""
    flow_window_px: Annotated[int, Field(ge=3, le=1001)] = 25
    """Side length of Farnebäck's window in px."""
    flow_levels: Annotated[int, Field(ge=1, le=10)] = 3
    """Number of levels of Farnebäck's pyramid."""
    flow_iterations: Annotated[int, Field(ge=1, le=1000)] = 3
    """Number of iterations of Farnebäck's method at each level."""
    flow_polynomial_sigma_px: Annotated[float, Field(ge=0.1, le=100, allow_inf_nan=False)] = 1.5
    """Standard deviation of the Gaussian for the fit of Farnebäck's polynomials to 7 x 7 pixels, in px."""


def cv2_problems() -> list[Problem]:
    """Return the reason why OpenCV cannot be used, if so."""
    try:
        import cv2  # noqa: F401
    except ImportError as error:
        remedy = "install it: pip install 'scenetruth[opencv]' (or opencv-python-headless)"
        return [Problem("method", f"requires OpenCV, which cannot be imported ({error}); {remedy}")]
    return []


def eight_bit_images(recording: xr.Dataset) -> GreyImages:
    """Return a reader of 8-bit grey images; other types are scaled from the 0.1th to the 99.9th percentile of all.

    Invalid pixels (NaN) have the grey value of the nearest valid pixel; `disparities` and `flows` omit them.
    """
    image = recording["image"].variable
    # A grid of one row is a single row.
    image = image.isel(s_y=0) if "s_y" in image.dims else image
    positions = recording["s"].values.tolist()

    def recorded(camera: int, frame: int) -> NDArray[Any]:
        return np.asarray(image.isel(s=camera, t=frame).values)

    low, high = 0.0, 255.0
    if image.dtype != np.uint8:
        everywhere = ((camera, frame) for camera in range(len(positions)) for frame in range(image.sizes["t"]))
        sampled = (recorded(*place)[..., ::4, ::4].astype(np.float64) for place in everywhere)
        rows, columns = (len(range(0, size, 4)) for size in image.shape[-2:])
        low, high = outer_percentiles(sampled, 0.1, prod(image.shape[:-2]) * rows * columns)

    @lru_cache(maxsize=_HELD)
    def grey(s: int, frame: int) -> tuple[Bytes, Mask | None]:
        values = recorded(positions.index(s), frame)
        values = values[..., 0] if "channel" in image.dims else values
        invalid = None
        if values.dtype != np.uint8:
            scaled = (values.astype(np.float64) - low) * (255 / max(high - low, 1e-12))
            missing = np.isnan(scaled)
            if missing.any():
                scaled, invalid = _filled(scaled, missing), missing
            values = np.rint(np.clip(np.nan_to_num(scaled), 0, 255)).astype(np.uint8)
        return np.ascontiguousarray(values), invalid

    return grey


def _filled(values: Map, invalid: Mask) -> Map:
    """Return values, those of invalid pixels replaced by the nearest valid value; 0 if there is none."""
    from scipy.ndimage import distance_transform_edt

    if invalid.all():
        return np.zeros_like(values)
    return np.asarray(values[tuple(distance_transform_edt(invalid, return_distances=False, return_indices=True))])


def _without_support(here: Mask | None, there: Mask | None, shift: Map, reach_px: int) -> Mask:
    """Return the pixels whose window, or that of their point in the other image, contains an invalid pixel.

    ``here``, ``there``: Invalid pixels of the two images, shape (y, x); None without any.
    ``shift``: Displacement of the points, down and right, in px, shape (2, y, x).
    """
    from scipy.ndimage import maximum_filter

    def around(invalid: Mask) -> Mask:
        return np.asarray(maximum_filter(invalid.view(np.uint8), 2 * reach_px + 1, mode="constant") > 0)

    found = np.zeros(shift.shape[1:], dtype=np.bool_) if here is None else around(here)
    if there is not None:
        at = np.rint(np.indices(there.shape) + np.nan_to_num(shift, nan=0.0)).astype(np.int64)
        rows, columns = (np.clip(each, 0, size - 1) for each, size in zip(at, there.shape, strict=True))
        found |= around(there)[rows, columns]
    return found


def camera_problems(recording: xr.Dataset, settings: StereoSettings) -> list[Problem]:
    """Return the problems of the camera position that is matched with the reference."""
    others = [s for s in recording["s"].values.tolist() if s != 0]
    if settings.camera is not None and settings.camera not in others:
        return [Problem("estimate.camera", f"must be one of the positions {others}", settings.camera)]
    return []


def disparities(
    recording: xr.Dataset, images: GreyImages, settings: StereoSettings, progress: Progress | None
) -> Iterator[Map]:
    """Yield the disparity of the reference camera in every frame, px per step of s, each of shape (y, x)."""
    positions = recording["s"].values.tolist()
    other = settings.camera or min((s for s in positions if s != 0), key=lambda s: (abs(s), -s))
    stage = recording["stage_x_mm"].values
    apart_mm = float(stage[positions.index(other)] - stage[positions.index(0)])
    # Per step of s, and in camera pixels if the recording is subsampled.
    per_step = apart_mm / float(recording.attrs["baseline_mm"])
    scale = float(np.sign(apart_mm) * compute_pixel_grid(recording).step_px / per_step)

    reach_px = _block_px(settings) // 2

    def found(frame: int) -> Map:
        # The matcher returns the shift to the left, for a camera to the right.
        (one, here), (two, there) = images(0, frame), images(other, frame)
        shift = disparity_between(one, two, settings, to_the_right=apart_mm > 0)
        moved = np.stack([np.zeros_like(shift), -np.sign(apart_mm) * shift])
        shift[_without_support(here, there, moved, reach_px)] = np.nan
        return shift * scale

    return _frame_by_frame("stereo", found, recording.sizes["t"], progress)


def flows(
    recording: xr.Dataset, images: GreyImages, settings: FlowSettings, progress: Progress | None
) -> Iterator[Map]:
    """Yield the flow of the reference camera between consecutive frames, px per frame, each of shape (2, y, x)."""
    step_px = compute_pixel_grid(recording).step_px

    reach_px = settings.flow_window_px // 2 if settings.flow == "farneback" else _PATCH_PX // 2

    def found(frame: int) -> Map:
        (one, here), (two, there) = images(0, frame), images(0, frame + 1)
        flow = flow_between(one, two, settings)
        flow[:, _without_support(here, there, flow[::-1], reach_px)] = np.nan
        return step_px * flow

    return _frame_by_frame("flow", found, recording.sizes["t"] - 1, progress)


def _frame_by_frame(what: str, found: Callable[[int], Map], count: int, progress: Progress | None) -> Iterator[Map]:
    """Yield the result for each frame and report the progress."""
    tell = progress or (lambda *_: None)
    tell(what, 0, count)
    for frame in range(count):
        values = found(frame)
        tell(what, frame + 1, count)
        yield values


def _block_px(settings: StereoSettings) -> int:
    """Return the side length of the blocks."""
    return settings.stereo_block_px or (7 if settings.stereo == "sgbm" else 21)


def disparity_between(reference: Bytes, other: Bytes, settings: StereoSettings, *, to_the_right: bool) -> Map:
    """Return the disparity of a rectified pair at the pixels of the reference, shape (y, x), in px; NaN if invalid."""
    if not to_the_right:
        # In mirrored images, the left camera becomes the right one.
        mirrored = disparity_between(
            np.ascontiguousarray(reference[:, ::-1]), np.ascontiguousarray(other[:, ::-1]), settings, to_the_right=True
        )
        return np.ascontiguousarray(mirrored[:, ::-1])
    import cv2

    span = settings.disparity_range_px
    least = (
        _least_disparity(reference, other, span) if settings.min_disparity_px == "auto" else settings.min_disparity_px
    )
    # Pixels to the left of the range in the other image would have no disparity; padding is added for them.
    pad = least + span
    padded = [cv2.copyMakeBorder(image, 0, 0, pad, 0, cv2.BORDER_REPLICATE) for image in (reference, other)]
    matcher: Any
    if settings.stereo == "sgbm":
        block = _block_px(settings)
        penalties = {"P1": 8 * block**2, "P2": 32 * block**2}
        matcher = cv2.StereoSGBM.create(least, span, block, **penalties, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    else:
        matcher = cv2.StereoBM.create(span, _block_px(settings))
        matcher.setMinDisparity(least)
    found = np.asarray(matcher.compute(*padded)[:, pad:], dtype=np.float64) / _SIXTEENTHS
    # Pixels whose match would lie outside the other image have been matched with the padding.
    outside = np.arange(found.shape[1]) - found < 0
    found[(found < least) | (found <= 0) | outside] = np.nan
    return found


def _least_disparity(reference: Bytes, other: Bytes, span: int) -> int:
    """Return the smallest disparity of the range that covers most of the image, at a lower resolution if possible."""
    import cv2

    factor = next((factor for factor in (4, 2) if reference.shape[1] // factor >= _LEAST_WIDTH), 1)
    size = (reference.shape[1] // factor, reference.shape[0] // factor)
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (reference, other)]
    # The matcher needs some columns in addition to the range.
    most = max(16, (size[0] - 32) // 16 * 16)
    matcher = cv2.StereoSGBM.create(0, most, 7, P1=8 * 49, P2=32 * 49, uniquenessRatio=10)
    padded = [cv2.copyMakeBorder(image, 0, 0, most, 0, cv2.BORDER_REPLICATE) for image in small]
    found = np.asarray(matcher.compute(*padded)[:, most:], dtype=np.float64) / _SIXTEENTHS
    found[np.arange(size[0]) - found < 0] = 0
    known = found[found > 0] * factor
    if known.size == 0:
        return 0
    low, high = np.percentile(known, (5, 95))
    return max(0, round(float(low + high - span) / 2))


def flow_between(first: Bytes, second: Bytes, settings: FlowSettings) -> Map:
    """Return the optical flow (dx, dy) from one image to another at the pixels of the first, in px, shape (2, y, x)."""
    import cv2

    if settings.flow == "farneback":
        found = cv2.calcOpticalFlowFarneback(
            first,
            second,
            None,  # type: ignore[call-overload]
            0.5,
            settings.flow_levels,
            settings.flow_window_px,
            settings.flow_iterations,
            7,
            settings.flow_polynomial_sigma_px,
            cv2.OPTFLOW_FARNEBACK_GAUSSIAN,
        )
    else:
        found = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None)  # type: ignore[call-overload]
    return np.ascontiguousarray(np.moveaxis(np.asarray(found, dtype=np.float64), -1, 0))
