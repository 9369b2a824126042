"""What the methods made of OpenCV share: the library itself, grey images in 8 bits, and stereo matching."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scenetruth.errors import Problem
from scenetruth.estimators.protocol import MethodSettings
from scenetruth.progress import Progress
from scenetruth.schema import pixel_grid_of

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
]

Map = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_SIXTEENTHS = 16
# Columns that are enough to find the range of disparities.
_LEAST_WIDTH = 160


class StereoSettings(MethodSettings):
    """How OpenCV matches two images of a rectified pair."""

    stereo: Literal["sgbm", "bm"] = "sgbm"
    """``sgbm``: semi-global matching of blocks; ``bm``: block matching."""
    camera: Annotated[int, Field(ge=-1001, le=1001)] | None = None
    """The position s that is matched with the reference s = 0; null: the nearest, the right one of two."""
    min_disparity_px: Annotated[int, Field(ge=0, le=32768)] | Literal["auto"] = "auto"
    """Least disparity between the two images in px; ``auto`` finds the range from the images."""
    disparity_range_px: Annotated[int, Field(ge=16, le=32768, multiple_of=16)] = 32
    """How many disparities are tried from there on: a multiple of 16."""
    stereo_block_px: Annotated[int, Field(ge=1, le=255)] | None = None
    """Side of the blocks that are compared, odd; null: 7 for ``sgbm``, 21 for ``bm``."""

    @model_validator(mode="after")
    def _block(self) -> StereoSettings:
        block = self.stereo_block_px
        least = 5 if self.stereo == "bm" else 1
        if block is not None and (block % 2 == 0 or block < least):
            msg = f"stereo_block_px must be odd and at least {least} for '{self.stereo}' (got {block})"
            raise ValueError(msg)
        return self


class FlowSettings(MethodSettings):
    """How OpenCV finds the optical flow from a frame to the next."""

    flow: Literal["farneback", "dis"] = "farneback"
    """``farneback``: polynomial expansion; ``dis``: dense inverse search (medium preset)."""
    flow_window_px: Annotated[int, Field(ge=3, le=1001)] = 25
    """Side of Farnebäck's window in px."""
    flow_levels: Annotated[int, Field(ge=1, le=10)] = 3
    """Levels of Farnebäck's pyramid."""
    flow_iterations: Annotated[int, Field(ge=1, le=1000)] = 3
    """Iterations of Farnebäck's method at each level."""
    flow_polynomial_sigma_px: Annotated[float, Field(ge=0.1, le=100, allow_inf_nan=False)] = 1.5
    """Standard deviation of the Gaussian in which Farnebäck's polynomials are fitted to 7 x 7 pixels, in px."""


def cv2_problems() -> list[Problem]:
    """Return why OpenCV cannot be used here, if so."""
    try:
        import cv2  # noqa: F401
    except ImportError as error:
        remedy = "install it: pip install 'scenetruth[opencv]' (or opencv-python-headless)"
        return [Problem("method", f"needs OpenCV, which cannot be imported ({error}); {remedy}")]
    return []


def eight_bit_images(recording: xr.Dataset) -> Bytes:
    """Return grey images as OpenCV takes them, uint8 of shape (s, t, y, x).

    What does not fit into 8 bits is scaled by its 0.1th and 99.9th percentile over the whole recording, alike for all
    images, so that brightness stays comparable.
    """
    images = recording["image"].values
    if images.dtype == np.uint8:
        return np.ascontiguousarray(images)
    values = images.astype(np.float64)
    low, high = np.nanpercentile(values[..., ::4, ::4], (0.1, 99.9))
    scaled = (values - low) * (255 / max(high - low, 1e-12))
    eight_bit: Bytes = np.rint(np.clip(np.nan_to_num(scaled), 0, 255)).astype(np.uint8)
    return eight_bit


def camera_problems(recording: xr.Dataset, settings: StereoSettings) -> list[Problem]:
    """Return what is wrong with the position that is to be matched with the reference."""
    others = [s for s in recording["s"].values.tolist() if s != 0]
    if settings.camera is not None and settings.camera not in others:
        return [Problem("estimate.camera", f"must be one of the positions {others}", settings.camera)]
    return []


def disparities(
    recording: xr.Dataset, images: Bytes, settings: StereoSettings, frames: list[int], progress: Progress | None
) -> list[Map]:
    """Return the disparity of the reference camera in some frames, px per step of s, each of shape (y, x).

    Parameters
    ----------
    recording
        The recording.
    images
        Its images as of `eight_bit_images`.
    settings
        How they are matched.
    frames
        Positions of the frames along t.
    progress
        Called with (what, done, total).
    """
    positions = recording["s"].values.tolist()
    other = settings.camera or min((s for s in positions if s != 0), key=lambda s: (abs(s), -s))
    reference, index = positions.index(0), positions.index(other)
    stage = recording["stage_x_mm"].values
    apart_mm = float(stage[index] - stage[reference])
    # Per step of s, and in pixels of the camera where only every n-th is there.
    scale = np.sign(apart_mm) * pixel_grid_of(recording).step_px / (apart_mm / float(recording.attrs["baseline_mm"]))
    found = []
    for done, frame in enumerate(frames):
        if progress is not None:
            progress("stereo", done, len(frames))
        pair = images[reference, frame], images[index, frame]
        # Matching gives the shift to the left of a camera that stands to the right.
        found.append(disparity_between(*pair, settings, to_the_right=apart_mm > 0) * scale)
    if progress is not None:
        progress("stereo", len(frames), len(frames))
    return found


def flows(
    recording: xr.Dataset, images: Bytes, settings: FlowSettings, frames: list[int], progress: Progress | None
) -> list[Map]:
    """Return the flow of the reference camera from some frames to the next, px per frame, each of shape (2, y, x).

    Parameters
    ----------
    recording, images, frames, progress
        As of `disparities`.
    settings
        How the flow is found.
    """
    reference, step_px = recording["s"].values.tolist().index(0), pixel_grid_of(recording).step_px
    found = []
    for done, frame in enumerate(frames):
        if progress is not None:
            progress("flow", done, len(frames))
        found.append(step_px * flow_between(images[reference, frame], images[reference, frame + 1], settings))
    if progress is not None:
        progress("flow", len(frames), len(frames))
    return found


def disparity_between(reference: Bytes, other: Bytes, settings: StereoSettings, *, to_the_right: bool) -> Map:
    """Return the disparity of every pixel of the reference image in px, positive; NaN where nothing fits.

    Parameters
    ----------
    reference, other
        Images of a rectified pair, shape (y, x).
    settings
        How they are matched.
    to_the_right
        Whether the other camera stands to the right of the reference.
    """
    if not to_the_right:
        # Seen in a mirror, the camera on the left stands on the right.
        mirrored = disparity_between(
            np.ascontiguousarray(reference[:, ::-1]), np.ascontiguousarray(other[:, ::-1]), settings, to_the_right=True
        )
        return np.ascontiguousarray(mirrored[:, ::-1])
    import cv2

    span = settings.disparity_range_px
    least = (
        _least_disparity(reference, other, span) if settings.min_disparity_px == "auto" else settings.min_disparity_px
    )
    # What lies left of the range's end in the other image would have no disparity: room is added there.
    pad = least + span
    padded = [cv2.copyMakeBorder(image, 0, 0, pad, 0, cv2.BORDER_REPLICATE) for image in (reference, other)]
    matcher: Any
    if settings.stereo == "sgbm":
        block = settings.stereo_block_px or 7
        penalties = {"P1": 8 * block**2, "P2": 32 * block**2}
        matcher = cv2.StereoSGBM.create(least, span, block, **penalties, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    else:
        matcher = cv2.StereoBM.create(span, settings.stereo_block_px or 21)
        matcher.setMinDisparity(least)
    found = np.asarray(matcher.compute(*padded)[:, pad:], dtype=np.float64) / _SIXTEENTHS
    # Pixels whose match would lie outside the other image have been matched with the added room.
    outside = np.arange(found.shape[1]) - found < 0
    found[(found < least) | (found <= 0) | outside] = np.nan
    return found


def _least_disparity(reference: Bytes, other: Bytes, span: int) -> int:
    """Return the least disparity of the range in which most of the image is found, at a lower resolution if it can."""
    import cv2

    factor = next((factor for factor in (4, 2) if reference.shape[1] // factor >= _LEAST_WIDTH), 1)
    size = (reference.shape[1] // factor, reference.shape[0] // factor)
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (reference, other)]
    # Matching needs some columns beside the range.
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
    """Return the optical flow from one image to another in px, (dx, dy), shape (2, y, x).

    Parameters
    ----------
    first, second
        The images, shape (y, x); the flow belongs to the pixels of the first.
    settings
        How it is found.
    """
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
