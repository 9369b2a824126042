"""Interface of estimation methods and access to the images of a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.progress import Progress
from scenetruth.schema import IncrementalDataset, Put, read_acquisition
from scenetruth.validated_model import FrozenModel

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["RESERVED_SETTINGS", "Estimator", "FrameReader", "Method", "MethodSettings", "Needs", "StreamingMethod"]


RESERVED_SETTINGS = frozenset({"method", "recording", "settings", "progress", "overrides", "kind"})
"""Names that settings of a method must not have, because calls and scene files use them otherwise."""


class MethodSettings(FrozenModel):
    """Base model for the settings of a method, without fields; derive from it and add fields.

    See Also
    --------
    scenetruth.estimators.validate_settings : Create the settings of a method from plain values.
    scenetruth.estimators.Method : Its class attribute ``settings`` is the settings model.

    Examples
    --------
    A field has a type, optionally a default, and a description, which is included in the JSON Schema of scene files:

    >>> class WallSettings(MethodSettings):
    ...     depth_mm: float
    ...     "Distance of the wall, in mm."
    ...     window_px: int = 9
    ...     "Width of the window in which it is looked for, in px."
    >>> WallSettings(depth_mm=800)
    WallSettings(depth_mm=800.0, window_px=9)

    Values are validated against the type of their field; other fields are rejected:

    >>> from pydantic import ValidationError
    >>> try:
    ...     WallSettings(depth_mm="deep", depth_m=0.8)
    ... except ValidationError as error:
    ...     print([".".join(found["loc"]) for found in error.errors()])
    ['depth_mm', 'depth_m']
    """


@dataclass(frozen=True)
class Needs:
    """Requirements of a method on a recording.

    Parameters
    ----------
    cameras, frames
        Smallest number of camera positions s and of frames t.
    images
        Smallest number of images, ``cameras * frames``; 2 if either two cameras or two frames suffice.
    channels
        Number of colour channels that the method supports; None for any, 1 for grey images only.
    grid
        Whether the method processes the cameras of a grid (several rows ``s_y``) together.
    exclusion_mask
        Whether the method excludes the pixels that the ``exclusion_mask`` of a recording marks. All other methods
        reject recordings with an exclusion mask, because they would use these pixels.
    distortion
        Whether the method takes account of the lens distortion that a recording states. All other methods assume a
        pinhole camera, and an `EstimateWarning` says so.
    schedule
        Whether the method takes account of positions that are visited one after the other, and of rolling shutters.
        All other methods assume simultaneous images, and an `EstimateWarning` says so.

    See Also
    --------
    scenetruth.estimators.Estimator : Its ``requirements`` return all further requirements that are not met.

    Examples
    --------
    Two cameras and grey images; a colour recording of one camera is rejected for both reasons:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> needs = Needs(cameras=2, channels=1)
    >>> print(needs)
    2 cameras, grey images
    >>> recording = st.make_recording(np.zeros((1, 5, 30, 40, 3)), focal_length_px=500, baseline_mm=5)
    >>> for problem in needs.problems(recording, "mine"):
    ...     print(problem)
    stage.positions: 'mine' needs 2 camera positions (got 1)
    channel: 'mine' takes images of 1 channel; average them: recording.mean('channel', keep_attrs=True) (got 3)
    """

    cameras: int = 1
    frames: int = 1
    images: int = 1
    channels: int | None = None
    grid: bool = False
    exclusion_mask: bool = False
    distortion: bool = False
    schedule: bool = False

    def __str__(self) -> str:
        parts = [f"{self.cameras} cameras"] if self.cameras > 1 else []
        parts += [f"{self.frames} frames"] if self.frames > 1 else []
        parts += [f"{self.images} images"] if self.images > max(1, self.cameras * self.frames) else []
        parts += [] if self.channels is None else ["grey images" if self.channels == 1 else f"{self.channels} channels"]
        return ", ".join(parts) or "any images"

    def describe_ignored(self, recording: xr.Dataset, name: str) -> list[str]:
        """Return what a recording states of its acquisition, and a method ignores."""
        acquisition = read_acquisition(recording)
        found = []
        if acquisition.distortion.size and not self.distortion:
            found.append(
                f"attrs.distortion: '{name}' assumes a pinhole camera, but the images are distorted; undistort them "
                "first and omit distortion, or use method 'refined'"
            )
        delay = np.abs(acquisition.time_s - acquisition.time_s[:1, :1]).max(initial=0.0)
        if not self.schedule and (delay > 0 or acquisition.line_time_s > 0):
            what = f"are up to {delay:g} s apart" if delay > 0 else "have a rolling shutter"
            found.append(
                f"planned_time_s: '{name}' takes the images of a frame as simultaneous, but they {what}: motion is "
                "taken for depth; use method 'refined'"
            )
        return found

    def problems(self, recording: xr.Dataset, name: str) -> list[Problem]:
        """Return the requirements that a recording does not meet; ``name`` is the name of the method."""
        sizes = recording["image"].sizes
        cameras, frames, channels = sizes["s"], sizes["t"], sizes.get("channel", 1)
        problems = []
        if sizes.get("s_y", 1) > 1 and not self.grid:
            message = f"a grid is not supported by '{name}'; render it, then estimate each row, "
            problems.append(Problem("stage.rows", message + "recording.sel(s_y=0)", sizes["s_y"]))
        if cameras < self.cameras:
            message = f"'{name}' needs {self.cameras} camera positions"
            problems.append(Problem("stage.positions", message, cameras))
        if frames < self.frames:
            problems.append(Problem("frames.count", f"'{name}' needs {self.frames} frames", frames))
        if not problems and cameras * frames < self.images:
            message = "one image determines neither depth nor motion; 2 camera positions or 2 frames are required"
            problems.append(Problem("stage.positions", message, cameras))
        if self.channels is not None and channels != self.channels:
            message = f"'{name}' takes images of {self.channels} channel{'s' if self.channels > 1 else ''}"
            if self.channels == 1:
                message += "; average them: recording.mean('channel', keep_attrs=True)"
            problems.append(Problem("channel", message, channels))
        if "exclusion_mask" in recording and not self.exclusion_mask:
            message = f"is not supported by '{name}'; use method 'refined', or include all pixels: "
            problems.append(Problem("exclusion_mask", message + "recording.drop_vars('exclusion_mask')"))
        return problems


@runtime_checkable
class Estimator(Protocol):
    """Protocol of an estimation method, built-in or user-defined.

    Attributes
    ----------
    name
        Lower-case letters, digits and underscores, beginning with a letter.
    settings
        Frozen settings model; fields without a default must be specified.
    gives
        Output quantities among depth, disparity, flow and velocity; empty if only the estimate itself determines them.
        Scores follow from it: motion is not evaluated for a method without motion output.
    needs
        Requirements on the recording.

    See Also
    --------
    scenetruth.estimators.Method : Base class with defaults for everything but `estimate`.
    scenetruth.estimators.StreamingMethod : Base class for methods that estimate a few frames at a time.
    scenetruth.testing.check_estimator : Check whether a method complies with this protocol.

    Examples
    --------
    No base class is required; this method returns a wall at a specified distance:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> from scenetruth.estimators import Estimator, MethodSettings, Needs
    >>> class WallSettings(MethodSettings):
    ...     depth_mm: float = 1000.0
    >>> class Wall:
    ...     name = "wall"
    ...     settings = WallSettings
    ...     gives = frozenset({"depth", "disparity"})
    ...     needs = Needs()
    ...
    ...     def requirements(self, recording, settings):
    ...         return []
    ...
    ...     def estimate(self, recording, settings, progress):
    ...         depth = np.full(recording["image"].shape[-2:], settings.depth_mm)
    ...         return st.make_estimate(recording=recording, depth=depth)
    >>> isinstance(Wall(), Estimator)
    True
    >>> recording = st.make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> found = st.estimate(recording, Wall(), depth_mm=500)
    >>> found.attrs["method"], found.disparity.sel(t=0)[15, 20].item()
    ('wall', 5.0)
    """

    name: str
    settings: type[FrozenModel]
    gives: frozenset[str]
    needs: Needs

    def requirements(self, recording: xr.Dataset, settings: Any) -> list[Problem]:
        """Return the violated requirements beyond `needs`.

        It is also called before images exist: coordinates, sizes and attributes are final then, all grey values zero.
        """
        ...

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Progress | None) -> xr.Dataset:
        """Return the estimate for a recording.

        Parameters
        ----------
        recording
            A validated recording that meets the requirements; its arrays are read-only.
        settings
            An instance of the settings model.
        progress
            Called with (task, done, total); it may raise an exception to interrupt the estimation.

        Returns
        -------
        xarray.Dataset
            An estimate in the form of `scenetruth.make_estimate`.
        """
        ...


class Method:
    """Base class for user-defined methods: derive from it and implement `estimate`.

    See Also
    --------
    scenetruth.estimators.StreamingMethod : Base class for methods that estimate a few frames at a time.
    scenetruth.estimators.Estimator : Protocol of a method, with or without a base class.
    scenetruth.testing.check_estimator : Check whether a method complies with the protocol.

    Examples
    --------
    >>> import scenetruth as st
    >>> class FarAway(Method):
    ...     name = "far_away"
    ...     gives = frozenset({"depth"})
    ...
    ...     def estimate(self, recording, settings, progress):
    ...         return st.make_estimate(recording=recording, depth=np.full(recording.image.shape[1:], 1e3))
    >>> import numpy as np
    >>> recording = st.make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> float(st.estimate(recording, FarAway()).disparity[0, 0, 0])
    2.5
    """

    name: str
    settings: type[FrozenModel] = MethodSettings
    gives: frozenset[str] = frozenset()
    needs: Needs = Needs()
    reads_frames: bool = False
    """Whether the method reads the recording frame by frame; other methods get it loaded into memory."""

    def requirements(self, recording: xr.Dataset, settings: Any) -> list[Problem]:
        """Return an empty list: `needs` are the only requirements."""
        return []

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Progress | None) -> xr.Dataset:
        """Return the estimate for a recording; see `Estimator.estimate`."""
        raise NotImplementedError


class StreamingMethod(Method):
    """Base class for methods that estimate a few frames at a time, so that memory does not grow with the recording.

    Derive from it and implement `blank` and `fill`. The recording may be lazy: its images are read when they are
    selected (`scenetruth.estimators.protocol` reads windows of frames).

    See Also
    --------
    scenetruth.estimators.Method : Base class for methods that process the whole recording in memory.
    scenetruth.estimators.EstimationTask : Fill an estimate frame by frame.

    Examples
    --------
    Depth from the light of a lamp at the camera, which decreases with the square of the distance, frame by frame:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> from scenetruth.schema import blank_estimate, put_each
    >>> class Lamp(StreamingMethod):
    ...     name = "lamp"
    ...     gives = frozenset({"depth", "disparity"})
    ...
    ...     def blank(self, recording, settings):
    ...         return blank_estimate(["depth"], recording=recording, t=recording["t"])
    ...
    ...     def fill(self, recording, settings, put, progress):
    ...         depths = (100 / np.sqrt(recording["image"].sel(s=0, t=t).values) for t in recording["t"])
    ...         put_each("depth", depths, put, recording=recording)
    ...         return {"depth_at_full_scale_mm": 100}
    >>> images = np.full((2, 3, 30, 40), 0.25)
    >>> images[:, 2] = 0.0625
    >>> recording = st.make_recording(images, focal_length_px=500, baseline_mm=5)
    >>> found = st.estimate(recording, Lamp())
    >>> found.t.values.tolist(), found.depth[:, 15, 20].values.tolist(), found.attrs["depth_at_full_scale_mm"]
    ([-1, 0, 1], [200.0, 200.0, 400.0], 100)
    """

    bytes_per_pixel: float = 195.0
    """Memory per pixel of the frames that are estimated together, as measured for the structure tensor."""
    pixels_at_once: float = 2.3e6
    """Number of pixels of all frames that are estimated together, unless a single frame has more."""
    whole_pixels: float = math.inf
    """Largest number of pixels of an image that is not processed in tiles."""
    tile_pixels: float = math.inf
    """Largest number of pixels of a tile."""
    bytes_per_tiled_pixel: float = 0.0
    """Memory per pixel of an image that is processed in tiles, in addition to that of a tile."""
    seconds_per_sample: float = 1.6e-6
    """Time per pixel of an image of an estimated frame, on two processors, as measured."""

    def blank(self, recording: xr.Dataset, settings: Any) -> xr.Dataset:
        """Return the estimate that `fill` completes, with all frames and blank maps (`schema.blank_map`)."""
        raise NotImplementedError

    def fill(self, recording: xr.Dataset, settings: Any, put: Put, progress: Progress | None) -> Mapping[str, Any]:
        """Estimate, and write every map of every frame.

        Parameters
        ----------
        recording, settings, progress
            As in `Estimator.estimate`.
        put
            Receives one map or several; see `scenetruth.schema.Put`.

        Returns
        -------
        mapping
            Attributes of the estimate that are available only after the estimation.
        """
        raise NotImplementedError

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Progress | None) -> xr.Dataset:
        """Estimate all frames in memory."""
        filling = IncrementalDataset(self.blank(recording, settings))
        entries = self.fill(recording, settings, filling.put, progress)
        return filling.dataset().assign_attrs(entries)


class FrameReader:
    """Reader of windows of frames from a recording; the overlap of consecutive windows is read only once.

    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 9, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> reader = FrameReader(recording)
    >>> reader.shape, reader.frames(2, 5).shape, reader.missing()
    ((1, 2, 9, 30, 40), (1, 2, 3, 30, 40), 0)
    """

    def __init__(self, recording: xr.Dataset) -> None:
        self._image = image = recording["image"]
        sizes = image.sizes
        native = image.dtype.newbyteorder("=")
        self.dtype = native if native in (np.uint8, np.uint16) else np.dtype(np.float32)
        """Type of the images returned: uint8 and uint16 as recorded, all other types as float32."""
        cameras = sizes.get("s_y", 1) * sizes["s"]
        self.shape = (sizes.get("channel", 1), cameras, sizes["t"], sizes["y"], sizes["x"])
        """Numbers of channels, cameras (of a grid row by row), frames, rows and columns."""
        self._first = 0
        self._held: NDArray[Any] = np.empty((*self.shape[:2], 0, *self.shape[3:]), dtype=self.dtype)

    def frames(self, first: int, last: int) -> NDArray[Any]:
        """Return the images of successive frames."""
        held = self._first, self._first + self._held.shape[2]
        if held == (first, last):
            return self._held
        if first >= held[0] and first < held[1] < last:
            # The overlap is copied first, which limits the memory needed for the new images.
            window = np.empty((*self.shape[:2], last - first, *self.shape[3:]), dtype=self.dtype)
            window[:, :, : held[1] - first] = self._held[:, :, first - held[0] :]
            window[:, :, held[1] - first :] = self._read(held[1], last)
        else:
            window = np.ascontiguousarray(self._read(first, last))
        self._first, self._held = first, window
        return window

    def part(self, first: int, last: int) -> NDArray[Any]:
        """Return the images of successive frames, as a view if they are within the latest window."""
        if self._first <= first < last <= self._first + self._held.shape[2]:
            return self._held[:, :, first - self._first : last - self._first]
        return self.frames(first, last)

    def missing(self) -> int:
        """Return the number of values that are not finite in the type of the images returned; they are read as NaN."""
        return int(self._missing_by_image().sum())

    def _missing_by_image(self) -> NDArray[np.int64]:
        """Return the number of values that are not finite, of every image, shape (s, t)."""
        found = np.zeros(self.shape[1:3], dtype=np.int64)
        if self._image.dtype.kind != "f":
            return found
        for frame in range(self.shape[2]):
            images = self._read(frame, frame + 1)[:, :, 0]
            for camera in range(self.shape[1]):
                if not _all_finite(images[:, camera]):
                    found[camera, frame] = (~np.isfinite(images[:, camera])).sum()
        return found

    def empty_images(self) -> list[Problem]:
        """Return the images without a single finite value, which methods that compare all images cannot use."""
        missing = self._missing_by_image()
        empty = np.argwhere(missing == self.shape[0] * self.shape[3] * self.shape[4])
        if len(empty) == 0:
            return []
        camera, frame = empty[0].tolist()
        place = {"t": frame, "s": camera % self._image.sizes["s"]}
        if "s_y" in self._image.dims:
            place["s_y"] = camera // self._image.sizes["s"]
        named = ", ".join(f"{dim} = {self._image[dim].values[at]}" for dim, at in place.items())
        message = f"{len(empty)} of {missing.size} images have no valid pixel (the first at {named})"
        return [Problem("image", f"{message}: omit these frames or positions, or use method 'refined'")]

    def _read(self, first: int, last: int) -> NDArray[Any]:
        values = self._image.isel(t=slice(first, last)).values
        values = np.moveaxis(values, -1, 0) if "channel" in self._image.dims else values[None]
        values = values.reshape(self.shape[0], self.shape[1], last - first, *self.shape[3:])
        with np.errstate(over="ignore"):
            values = values.astype(self.dtype, copy=False)
        # Values that overflow, or are infinite, are invalid like NaN.
        if self.dtype.kind == "f" and not _all_finite(values) and np.isinf(values).any():
            values = np.where(np.isinf(values), np.float32(np.nan), values)
        return values


def _all_finite(values: NDArray[Any]) -> bool:
    """Return whether the sum of all values is finite, which is fast; it may also overflow."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(values.sum()))
