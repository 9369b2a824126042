"""Optical flow by phase correlation of blocks (Kuglin and Hines 1975), as particle image velocimetry does it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import Field

import scenetruth as st
from scenetruth.errors import Problem
from scenetruth.estimators import Method, MethodSettings, Needs
from scenetruth.progress import Progress
from scenetruth.schema import compute_pixel_grid

__all__ = ["PhaseCorrelation"]


# Shifts at which the windows of two blocks overlap by less than this share are not tried.
_LEAST_OVERLAP = 0.2


class Settings(MethodSettings):
    """How blocks are compared."""

    block_px: Annotated[int, Field(ge=8)] = 32
    """Side of the blocks in px; every block has one flow."""


class PhaseCorrelation(Method):
    """The peak of the normalised cross-power spectrum of a block before and after a frame, to parts of a pixel."""

    name = "phase_correlation"
    settings = Settings
    gives = frozenset({"flow"})
    needs = Needs(frames=3, channels=1)

    def requirements(self, recording: xr.Dataset, settings: Settings) -> list[Problem]:
        """Ask for images of at least one block."""
        smallest = min(recording.sizes["x"], recording.sizes["y"])
        if settings.block_px <= smallest:
            return []
        return [
            Problem("estimate.block_px", f"must be at most {smallest}, the images' shorter side", settings.block_px)
        ]

    def estimate(self, recording: xr.Dataset, settings: Settings, progress: Progress | None) -> xr.Dataset:
        """Compare the frames before and after every frame that has both; half their shift is its flow."""
        images = recording["image"].sel(s=0).values.astype(np.float64)
        inner, flow = recording["t"].values[1:-1], []
        for done, (before, after) in enumerate(zip(images[:-2], images[2:], strict=True), start=1):
            flow.append(_shift_of_blocks(before, after, settings.block_px) / 2)
            if progress is not None:
                progress("correlate", done, len(inner))
        found = np.stack(flow, axis=1) * compute_pixel_grid(recording).step_px
        return st.make_estimate(recording=recording, flow=found, t=inner)


def _shift_of_blocks(before: np.ndarray, after: np.ndarray, side: int) -> np.ndarray:
    """Return the shift of every whole block, shape (2, y, x); NaN on what is left over at the right and below."""
    rows, columns = (size // side for size in before.shape)
    window = np.outer(np.hanning(side), np.hanning(side))
    one, two = (_blocks(image, side) for image in (before, after))
    one, two = ((part - part.mean(axis=(-2, -1), keepdims=True)) * window for part in (one, two))
    spectrum = np.fft.fft2(two) * np.conj(np.fft.fft2(one))
    # The root keeps what is left of the texture's own spectrum: frequencies without texture are noise.
    spectrum /= np.sqrt(np.abs(spectrum)) + 1e-12
    peak = np.fft.fftshift(np.fft.ifft2(spectrum).real, axes=(-2, -1))
    # The further the shift, the less of the two windows overlaps, which draws the peak towards zero.
    overlap = np.fft.fftshift(np.fft.ifft2(np.abs(np.fft.fft2(window)) ** 2).real)
    overlap /= overlap.max()
    peak = np.where(overlap > _LEAST_OVERLAP, peak / overlap, 0.0)
    shift = np.stack([_sub_pixel(peak, axis=-1), _sub_pixel(peak, axis=-2)])
    found = np.full((2, *before.shape), np.nan)
    found[:, : rows * side, : columns * side] = shift.repeat(side, axis=1).repeat(side, axis=2)
    return found


def _blocks(image: np.ndarray, side: int) -> np.ndarray:
    rows, columns = (size // side for size in image.shape)
    whole = image[: rows * side, : columns * side]
    return whole.reshape(rows, side, columns, side).swapaxes(1, 2)


def _sub_pixel(peak: np.ndarray, axis: int) -> np.ndarray:
    """Return where along an axis each correlation is highest, by a parabola through the logarithms of three values."""
    side = peak.shape[-1]
    flat = peak.reshape(*peak.shape[:2], -1).argmax(axis=-1)
    row, column = flat // side, flat % side
    block_row, block_column = np.indices(flat.shape)
    down, right = int(axis == -2), int(axis == -1)
    values = []
    for n in (-1, 0, 1):
        beside = peak[block_row, block_column, (row + n * down) % side, (column + n * right) % side]
        values.append(np.log(np.maximum(beside, 1e-12)))
    curvature = 2 * values[1] - values[0] - values[2]
    part = 0.5 * (values[2] - values[0]) / np.where(curvature > 0, curvature, np.inf)
    found: np.ndarray = np.where(axis == -1, column, row) + part - side // 2
    return found
