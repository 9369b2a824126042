"""Lens and shutter effects: averaging of sharp images over aperture and exposure, blur and vignetting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Optics, Shutter, Viewpoint
from scenetruth.camera.lens import Psf
from scenetruth.compilation import thread_count
from scenetruth.render.renderer import Renderer

__all__ = [
    "DepthBand",
    "LensRenderer",
    "MovingVertices",
    "fine_parts",
    "is_sharp",
    "margin_px",
    "open_behind_lens",
    "split_into_bands",
]

# Subpixels along x and y before the blur. Edges within a subpixel cause aliasing of about (w / parts)² of the spectrum
# at w cycles per px, so a sharper lens needs more subpixels.
_PARTS, _MORE_PARTS, _NARROW_PX = 4, 8, 0.3
_SAMPLES_PER_PX, _FEWEST, _MOST = 4, 4, 256
_GOLDEN = (np.sqrt(5) - 1) / 2


class _Vertices(Protocol):
    @property
    def vertices_mm(self) -> NDArray[np.float64]:
        """Vertices in the world, shape (n, 3)."""
        ...


class MovingVertices(Protocol):
    """Vertices at any time, from which the motion in an image follows."""

    def at(self, t: float) -> _Vertices:
        """Return the vertices at time t in frames."""
        ...


@dataclass(frozen=True)
class DepthBand:
    """Renderer of a band of rows of the subsampled image (first, last + 1), with a margin of rows that is cropped."""

    rows: tuple[int, int]
    margin: int
    renderer: Renderer


def is_sharp(optics: Optics, shutter: Shutter) -> bool:
    """Return whether lens and shutter have no effect on images."""
    return optics == Optics() and shutter.exposure_time_s == 0 and shutter.readout_time_s == 0


def fine_parts(psf: Psf | None) -> int:
    """Return the number of subpixels per axis for the convolution with the point spread function."""
    if psf is None:
        return 1
    return _PARTS if psf.finest_px >= _NARROW_PX else _MORE_PARTS


def margin_px(psf: Psf | None) -> int:
    """Return the margin in px on every side that contributes light through the point spread function."""
    return 0 if psf is None else int(np.ceil(psf.reach_px))


def motion_px(
    world: MovingVertices, camera: Camera, viewpoint: Viewpoint, times: tuple[float, float], travel_mm: float
) -> float:
    """Return the largest image displacement of a vertex in front of the camera, in px; 0 without such vertices."""
    ends = []
    for time, share in zip(times, (-0.5, 0.5), strict=True):
        place = viewpoint.moved((share * travel_mm, 0.0, 0.0))
        ends.append(place.to_camera(world.at(time).vertices_mm))
    front = (ends[0][:, 2] > 0) & (ends[1][:, 2] > 0)
    if not front.any():
        return 0.0
    pinhole = camera.without_distortion()
    step = pinhole.project(ends[1][front]) - pinhole.project(ends[0][front])
    return float(np.linalg.norm(step, axis=1).max())


def blurred(fine: NDArray[np.float64], psf: Psf, parts: int) -> NDArray[np.float64]:
    """Convolve an image of subpixels, shape (y, x[, band]), with a point spread function (periodic, needs a margin)."""
    from scipy import fft

    if fine.ndim == 3:
        return np.stack([blurred(band, psf, parts) for band in np.moveaxis(fine, -1, 0)], axis=-1)
    rows, columns = (fft.next_fast_len(size, real=True) for size in fine.shape)
    # Edge padding to a fast FFT length avoids steps at the periodic border.
    padded = np.pad(fine, ((0, rows - fine.shape[0]), (0, columns - fine.shape[1])), mode="edge")
    frequency = np.hypot(fft.fftfreq(rows, 1 / parts)[:, None], fft.rfftfreq(columns, 1 / parts)[None, :])
    spectrum = fft.rfft2(padded, workers=thread_count()) * psf.transfer(frequency)
    spread = fft.irfft2(spectrum, (rows, columns), workers=thread_count())
    return np.asarray(spread[: fine.shape[0], : fine.shape[1]])


class LensRenderer(Renderer):
    """Renderer with lens and shutter effects: average of sharp images, blurred and vignetted.

    ``bands``: Renderers that together cover the subsampled image: one, or one per row for a rolling shutter.
    """

    def __init__(
        self,
        name: str,
        bands: Sequence[DepthBand],
        world: MovingVertices,
        camera: Camera,
        optics: Optics,
        shutter: Shutter,
        frame_interval_s: float,
        parts: int | None = None,
    ) -> None:
        self.name = name
        self._bands = tuple(bands)
        self._world = world
        self._camera = camera
        self._optics = optics
        self._shutter = shutter
        self._frame_interval_s = frame_interval_s
        self._parts, self._margin = parts or fine_parts(optics.psf), margin_px(optics.psf)
        self._shade = None if optics.vignetting is None else optics.vignetting.factor(camera)

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image at mid-exposure time t and viewpoint, see `Renderer.render`."""
        fine = self._mean(t, viewpoint)
        psf, parts, margin = self._optics.psf, self._parts, self._margin
        if psf is not None:
            fine = blurred(fine, psf, parts)
        height, width = self._camera.height, self._camera.width
        bands = fine.shape[2:]
        image = fine.reshape(height + 2 * margin, parts, width + 2 * margin, parts, *bands).mean(axis=(1, 3))
        image = image[margin : margin + height, margin : margin + width]
        if self._shade is not None:
            image = image * self._shade.reshape(*self._shade.shape, *(1 for _ in bands))
        return np.asarray(image, dtype=np.float32)

    def _mean(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float64]:
        shutter = self._shutter
        offsets_s, points_mm = self._samples(t, viewpoint)
        focus = np.inf if self._optics.defocus is None else self._optics.defocus.focus_distance_mm
        size = (self._camera.height + 2 * self._margin, self._camera.width + 2 * self._margin)
        total: NDArray[np.float64] | None = None
        for offset_s, point in zip(offsets_s, points_mm, strict=True):
            partial = viewpoint.directions_to_world(np.array([point[0], point[1], 0.0]))
            shear = (-float(point[0]) / focus, -float(point[1]) / focus)
            for band in self._bands:
                first, last = band.rows
                middle = (first + last - 1) / 2 / self._parts - self._margin - (0.5 - 0.5 / self._parts)
                later_s = float(offset_s + shutter.row_offsets_s(np.array(middle), self._camera.height))
                travel = np.array([shutter.stage_speed_mm_per_s * later_s, 0.0, 0.0])
                image = band.renderer.render(
                    t + later_s / self._frame_interval_s, viewpoint.moved(partial + travel, shear)
                )
                if total is None:
                    total = np.zeros((*(side * self._parts for side in size), *image.shape[2:]))
                total[first:last] += image[band.margin : band.margin + last - first]
        assert total is not None
        return total / len(offsets_s)

    def _samples(self, t: float, viewpoint: Viewpoint) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return exposure times in s and aperture points in mm, one of each per sharp image."""
        shutter, defocus = self._shutter, self._optics.defocus
        count = 1
        if shutter.exposure_time_s > 0:
            count = self._moments(t, viewpoint) if shutter.samples == "auto" else shutter.samples
        if defocus is None:
            return shutter.exposure_offsets_s(count), np.zeros((count, 2))
        moving, count = count > 1, max(count, defocus.samples)
        points = defocus.points_mm(count)
        if not moving:
            return np.zeros(count), points
        # Neighbouring aperture points have distant times, so every part of the aperture samples the whole exposure.
        order = np.argsort(np.argsort((np.arange(count) * _GOLDEN) % 1.0))
        return shutter.exposure_offsets_s(count)[order], points

    def _moments(self, t: float, viewpoint: Viewpoint) -> int:
        half = self._shutter.exposure_time_s / 2 / self._frame_interval_s
        travel = self._shutter.stage_speed_mm_per_s * self._shutter.exposure_time_s
        way = motion_px(self._world, self._camera, viewpoint, (t - half, t + half), travel)
        return 1 if way == 0 else int(np.clip(np.ceil(_SAMPLES_PER_PX * way), _FEWEST, _MOST))

    def close(self) -> None:
        """Close the renderers of all bands."""
        for band in self._bands:
            band.renderer.close()


def split_into_bands(
    camera: Camera,
    optics: Optics,
    shutter: Shutter,
    open_renderer: Callable[[Camera], Renderer],
    parts: int | None = None,
) -> list[DepthBand]:
    """Open the renderers of the sharp images: one for the subsampled image, or one per pixel row."""
    parts, margin = parts or fine_parts(optics.psf), margin_px(optics.psf)
    fine = camera.refined(parts, margin) if optics.psf is not None else camera
    if shutter.readout_time_s == 0:
        return [DepthBand((0, fine.height), 0, open_renderer(fine))]
    return [
        # Include one row above and one below, because exact hits at the border need neighbouring rays.
        DepthBand((first, first + parts), 1, open_renderer(fine.rows(first - 1, first + parts + 1)))
        for first in range(0, fine.height, parts)
    ]


def open_behind_lens(
    camera: Camera,
    optics: Optics,
    shutter: Shutter,
    world: MovingVertices,
    frame_interval_s: float,
    samples: int,
    open_renderer: Callable[[Camera, int], Renderer],
    parts: int | None = None,
) -> Renderer:
    """Open the renderer of sharp images, a function of camera and supersampling, and apply lens and shutter to it.

    ``parts``: Subpixels per axis for the point spread function; default: `fine_parts`.
    """
    if is_sharp(optics, shutter):
        return open_renderer(camera, samples)
    parts = parts if parts and optics.psf is not None else fine_parts(optics.psf)
    share = max(1, -(-samples // parts))
    bands = split_into_bands(camera, optics, shutter, lambda fine: open_renderer(fine, share), parts)
    return LensRenderer(bands[0].renderer.name, bands, world, camera, optics, shutter, frame_interval_s, parts)
