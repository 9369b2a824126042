"""Defective pixels: masked by the user, not finite, saturated, or dead; detection and interpolation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.estimators.protocol import FrameReader
from scenetruth.threads import in_threads

__all__ = ["DefectFilteredFrames", "fill_defects", "find_dead_pixels", "find_saturated_runs", "spread_defects"]

CAUSES = ("user", "not_finite", "saturated", "dead")
"""Causes of defects; of several, the first is counted."""

# Smallest number of pixels at full scale in a square of 3 x 3 px.
_RUN = 3
_SWEEPS = 20
# Largest number of frames, and smallest number of images, in which dead pixels are searched.
_FRAMES, _LEAST_IMAGES = 9, 3
# Smallest deviation of a dead pixel from its neighbours in the mean image, in local standard deviations, and as a
# fraction of the image range; and largest deviation of its neighbours, as a fraction of its own.
_STRONG, _LEAST_CONTRAST, _ALONE = 8.0, 0.05, 0.25
_BLOCK_PX = 16
# Fraction of the images in which the deviation has the same sign, and its smallest size relative to the median.
_MOSTLY, _LIKE_MEDIAN = 0.75, 0.3
_MOST_DEAD = 0.01  # with a larger fraction of dead pixels, it is a static pattern

Flags = NDArray[np.bool_]


class DefectFilteredFrames:
    """Images of a recording with defective pixels detected and interpolated."""

    def __init__(self, recording: xr.Dataset) -> None:
        self._recording = recording
        self._reader = FrameReader(recording)
        self.shape = self._reader.shape
        """Numbers of channels, cameras, frames, rows and columns."""
        # Floats are linear radiance, which has no saturation level.
        digital = recording["image"].dtype.kind in "iu"
        self._white = float(recording.attrs["full_scale"]) if digital else None
        self._bad: dict[int, NDArray[np.uint8] | None] = {}
        self._saturated: dict[int, Flags] = {}
        self._counts = np.zeros(len(CAUSES), dtype=np.int64)
        self._dead: Flags | None = None
        self._dead = self._find_dead()

    @property
    def counts(self) -> Mapping[str, int]:
        """Number of defective pixels in the images read, by cause."""
        return dict(zip(CAUSES, self._counts.tolist(), strict=True))

    def frames(self, first: int, last: int) -> NDArray[Any]:
        """Return the filled images of consecutive frames: float32, or of the recorded type if without defects."""
        images = self._reader.part(first, last)
        causes = [self._causes(frame, images[:, :, frame - first]) for frame in range(first, last)]
        for frame, found in zip(range(first, last), causes, strict=True):
            self._note(frame, found)
        if all(found is None for found in causes):
            return images
        images = images.astype(np.float32)
        jobs: list[tuple[int, int, Flags]] = []
        for place, found in enumerate(causes):
            if found is not None:
                # Saturated pixels already continue their surroundings.
                wrong = np.asarray(found[[0, 1, 3]].any(axis=0))
                jobs += [(camera, place, flags) for camera, flags in enumerate(wrong) if flags.any()]

        def fill(job: tuple[int, int, Flags]) -> None:
            camera, place, flags = job
            for channel in images:
                channel[camera, place] = fill_defects(channel[camera, place], flags)

        in_threads(fill, jobs)
        return images

    def hold(self, first: int, last: int) -> None:
        """Read consecutive frames, which `crop` and `frames` take from memory until others are read."""
        images = self._reader.frames(first, last)
        for frame in range(first, last):
            if frame not in self._bad:
                self._note(frame, self._causes(frame, images[:, :, frame - first]))

    def recorded(self, frame: int) -> NDArray[Any]:
        """Return the images of a frame in memory, as they are recorded, shape (channel, s, y, x)."""
        return self._reader.part(frame, frame + 1)[:, :, 0]

    def crop(self, frame: int, camera: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return a part of an image of the frames in memory, filled, shape (channel, y, x)."""
        images = self._reader.part(frame, frame + 1)[:, camera, 0, rows, columns]
        if self._bad[frame] is None:
            return images
        wrong = ~np.isfinite(images).all(axis=0)
        user = self._masked(frame)
        if user is not None:
            wrong |= user[camera, rows, columns]
        if self._dead is not None:
            wrong |= self._dead[rows, columns]
        if not wrong.any():
            return images
        return np.stack([fill_defects(image.astype(np.float32), wrong) for image in images])

    def bad_crop(self, frame: int, camera: int, rows: slice, columns: slice) -> NDArray[np.uint8] | None:
        """Return where a part of an image must not be sampled; None if its frame has no defects."""
        flags = self._bad[frame]
        return None if flags is None else flags[camera, rows, columns]

    def bad(self, first: int, last: int) -> list[NDArray[np.uint8]]:
        """Return where consecutive frames must not be sampled, shape (s, y, x) each, or an empty list if nowhere."""
        found = [self._bad[frame] for frame in range(first, last)]
        if all(flags is None for flags in found):
            return []
        _, cameras, _, height, width = self.shape
        nothing = np.broadcast_to(np.zeros((), dtype=np.uint8), (cameras, height, width))
        return [nothing if flags is None else flags for flags in found]

    def saturated(self, frame: int, camera: int) -> Flags | None:
        """Return the saturated pixels of one image, shape (y, x), or None if its frame has none."""
        found = self._saturated.get(frame)
        return None if found is None else found[camera]

    def part(self, first: int, last: int) -> xr.Dataset:
        """Return the recording of consecutive frames with filled images, without a mask."""
        part = self._recording.isel(t=slice(first, last)).drop_vars("exclusion_mask", errors="ignore")
        images = self.frames(first, last)
        if not self.bad(first, last):
            return part
        image = part["image"]
        values = np.moveaxis(images, 0, -1) if "channel" in image.dims else images[0]
        return part.assign(image=(image.dims, values.reshape(image.shape), image.attrs))

    def _note(self, frame: int, found: Flags | None) -> None:
        """Store the defects of a frame, once."""
        if frame in self._bad:
            return
        if found is None:
            self._bad[frame] = None
            return
        earlier = np.zeros(found.shape[1:], dtype=np.bool_)
        for cause, flags in enumerate(found):
            self._counts[cause] += np.count_nonzero(flags & ~earlier)
            earlier |= flags
        self._bad[frame] = spread_defects(earlier)
        if found[2].any():
            self._saturated[frame] = found[2]

    def _causes(self, frame: int, images: NDArray[Any]) -> Flags | None:
        """Return the defective pixels of a frame by cause, shape (4, s, y, x), or None without defects."""
        found = np.zeros((len(CAUSES), *images.shape[1:]), dtype=np.bool_)
        user = self._masked(frame)
        if user is not None:
            found[0] = user
        if images.dtype.kind == "f":
            found[1] = ~np.isfinite(images).all(axis=0)
        if self._white is not None and (images >= self._white).any():
            for channel in images:
                for camera, image in enumerate(channel):
                    found[2, camera] |= find_saturated_runs(image, self._white)
        if self._dead is not None:
            found[3] = self._dead
        return found if found.any() else None

    def _masked(self, frame: int) -> Flags | None:
        """Return the exclusion mask of a frame, shape (s, y, x), for a grid row by row."""
        if "exclusion_mask" not in self._recording:
            return None
        mask = self._recording["exclusion_mask"]
        mask = mask.isel(t=frame) if "t" in mask.dims else mask
        sizes = self._recording["image"].sizes
        grid = [sizes.get(dim, 1) for dim in ("s_y", "s", "y", "x")]
        values = mask.values.reshape([mask.sizes.get(dim, 1) for dim in ("s_y", "s", "y", "x")])
        return np.asarray(np.broadcast_to(values, grid).reshape(-1, *grid[2:]))

    def _find_dead(self) -> Flags | None:
        """Return the dead pixels of the sensor, None if there are none."""
        count = self.shape[2]
        frames = np.unique(np.linspace(0, count - 1, min(count, _FRAMES)).round().astype(np.intp))
        if self.shape[1] * len(frames) < _LEAST_IMAGES:
            return None

        def images() -> Any:
            for frame in frames:
                values = self._reader.frames(frame, frame + 1)[:, :, 0].mean(axis=0, dtype=np.float32)
                wrong = self._masked(frame)
                wrong = ~np.isfinite(values) if wrong is None else ~np.isfinite(values) | wrong
                yield from zip(values, wrong, strict=True)

        dead = find_dead_pixels(images)
        return dead if dead.any() else None


def spread_defects(bad: Flags) -> NDArray[np.uint8]:
    """Return 1 for samples (n, y, x) whose spline interpolation is affected by a defective pixel, else 0.

    Those are the samples whose nearest pixel is defective or at most two steps from a defective one, along rows and
    columns. For all others, at most 3 % of the error of the filled values remains (RMS over subpixel positions).
    """
    from scipy.ndimage import binary_dilation, generate_binary_structure

    out = bad.astype(np.uint8)
    cross = generate_binary_structure(2, 1)
    for image, flags in zip(out, bad, strict=True):
        if flags.any() and not flags.all():
            image[:] = binary_dilation(flags, cross, iterations=2)
    return out


def find_saturated_runs(image: NDArray[Any], white: float) -> Flags:
    """Return adjacent pixels (y, x) at full scale; a single one may be noise, or the maximum of a scaled image."""
    from scipy.ndimage import uniform_filter

    full = image >= white
    if not full.any():
        return np.asarray(full)
    around = uniform_filter(full.astype(np.float32), 3, mode="constant")
    return np.asarray(full & (around > (_RUN - 0.5) / 9))


def fill_defects(image: NDArray[np.float32], bad: Flags) -> NDArray[np.float32]:
    """Return an image, shape (y, x), with defective pixels interpolated; zero if all pixels are defective."""
    from scipy.ndimage import distance_transform_edt

    from scenetruth.estimators.refined.kernels.warp import smooth_over

    if bad.all():
        return np.zeros_like(image)
    nearest = distance_transform_edt(bad, return_distances=False, return_indices=True)
    whole = image[nearest[0], nearest[1]].astype(np.float64)
    smooth_over(whole, np.argwhere(bad), _SWEEPS)
    return np.asarray(whole, dtype=np.float32)


def find_dead_pixels(images: Any) -> Flags:
    """Return single pixels (y, x) that deviate consistently from their neighbours in almost all images.

    In the mean image of a moving scene, texture averages out and such a pixel remains.

    ``images``: Each call yields the grey values of all images, shape (y, x), and their invalid pixels.
    """
    total: Any = 0.0
    count, low, high = 0, np.inf, -np.inf
    for image, wrong in images():
        whole = fill_defects(image, wrong) if wrong.any() else image
        ends = np.percentile(whole[::4, ::4], (1, 99))
        low, high = min(low, float(ends[0])), max(high, float(ends[1]))
        total = total + whole.astype(np.float64)
        count += 1
    own = _subtract_neighbour_median(total / count)
    scale = 1.4826 * _local_medians(np.abs(own))
    strong = np.abs(own) > np.maximum(_STRONG * scale, _LEAST_CONTRAST * (high - low))
    strong &= _neighbour_maximum(np.abs(own)) < _ALONE * np.abs(own) + 3.0 * scale
    pixels = np.argwhere(strong)
    if len(pixels) == 0 or len(pixels) > _MOST_DEAD * strong.size:
        return np.zeros_like(strong)
    rows, columns = pixels.T
    each = []
    for image, wrong in images():
        whole = fill_defects(image, wrong) if wrong.any() else image
        each.append(np.where(wrong[rows, columns], np.nan, _subtract_neighbour_median(whole)[rows, columns]))
    median = np.nanmedian(each, axis=0)
    with np.errstate(invalid="ignore"):
        alike = np.array(each) * np.sign(median) > _LIKE_MEDIAN * np.abs(median)
    known = np.isfinite(each).sum(axis=0)
    dead = np.zeros_like(strong)
    dead[rows, columns] = (alike.sum(axis=0) >= _MOSTLY * known) & (known >= _LEAST_IMAGES)
    return dead


def _subtract_neighbour_median(image: NDArray[Any]) -> NDArray[np.float64]:
    """Return pixels minus the median of the eight around them."""
    from scipy.ndimage import median_filter

    ring = np.ones((3, 3), dtype=np.bool_)
    ring[1, 1] = False
    whole = image.astype(np.float64)
    return np.asarray(whole - median_filter(whole, footprint=ring, mode="mirror"))


def _neighbour_maximum(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest of the eight values around each pixel."""
    from scipy.ndimage import maximum_filter

    ring = np.ones((3, 3), dtype=np.bool_)
    ring[1, 1] = False
    return np.asarray(maximum_filter(values, footprint=ring, mode="mirror"))


def _local_medians(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, at every pixel, the largest median of its block and the adjacent blocks."""
    from scipy.ndimage import maximum_filter

    height, width = values.shape
    down, across = max(1, height // _BLOCK_PX), max(1, width // _BLOCK_PX)
    rows, columns = (np.minimum(np.arange(size) // _BLOCK_PX, n - 1) for size, n in ((height, down), (width, across)))
    medians = [
        [np.median(values[np.ix_(rows == row, columns == column)]) for column in range(across)] for row in range(down)
    ]
    return np.asarray(maximum_filter(np.array(medians), 3)[np.ix_(rows, columns)])
