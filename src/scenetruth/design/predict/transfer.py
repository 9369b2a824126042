"""What pixels, lens, focus and motion leave of the contrast of waves in the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene import Scene

__all__ = ["blur_px", "derivative_response", "transfer_of"]

Array = NDArray[np.float64]

# Highest frequency that pixels can show, in periods per px.
_NYQUIST = 0.5


def transfer_of(frequency: Array, scene: Scene, depth_mm: Array, motion_px: Array) -> Array:
    """Return which share of the contrast of waves images have.

    The pixel is a mean over its n x n samples, along x and along y sin(π f) / (n sin(π f / n)); the lens is its point
    spread function; the aperture is a disc; motion is a mean over a line. Waves finer than two pixels are lost: images
    show them as other waves, which do not move as the surface does.

    Parameters
    ----------
    frequency
        Frequencies along x and y in periods per px, shape (points, waves, 2).
    scene
        Optics and sampling.
    depth_mm
        Depth of the points, shape (points,).
    motion_px
        How far they move in the image while it is taken, shape (points, 2).

    Returns
    -------
    numpy.ndarray
        Shape (points, waves).
    """
    found = _pixel(frequency, scene.render.supersampling)
    optics, focal = scene.optics, scene.camera.focal_px
    if optics.psf is not None:
        found = found * optics.psf.transfer(np.hypot(frequency[..., 0], frequency[..., 1]))
    if optics.defocus is not None:
        diameter = optics.defocus.blur_diameter_px(depth_mm, focal)
        found = found * _disc(np.pi * diameter[:, None] * np.hypot(frequency[..., 0], frequency[..., 1]))
    if motion_px.any():
        found = found * np.sinc(np.einsum("pwk,pk->pw", frequency, motion_px))
    return np.asarray(found * (np.abs(frequency) < _NYQUIST).all(axis=-1))


def blur_px(scene: Scene, depth_mm: Array, flow_px: Array) -> Array:
    """Return how far points move in the image while it is taken: by their own motion, and by that of the stage.

    Parameters
    ----------
    scene
        Shutter, frames and camera.
    depth_mm
        Depth of the points, shape (points,).
    flow_px
        Optical flow in px per frame, shape (points, 2).
    """
    shutter = scene.shutter
    found = flow_px * (shutter.exposure_time_s / scene.frames.frame_interval_s)
    travel_mm = shutter.stage_speed_mm_per_s * shutter.exposure_time_s
    found[:, 0] -= scene.camera.focal_px * travel_mm / depth_mm
    return found


def derivative_response(frequency: Array) -> Array:
    """Return the derivative along one axis of the quintic spline through a wave of amplitude 1, at the pixels.

    Parameters
    ----------
    frequency
        Periods per px.

    Returns
    -------
    numpy.ndarray
        Radian per px: 2π f of long waves, 0 at two pixels per period.
    """
    turn = 2 * np.pi * frequency
    return np.asarray(5 * (10 * np.sin(turn) + np.sin(2 * turn)) / (33 + 26 * np.cos(turn) + np.cos(2 * turn)))


def _pixel(frequency: Array, samples: int) -> Array:
    if samples == 1:
        return np.ones(frequency.shape[:-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.sin(np.pi * frequency) / (samples * np.sin(np.pi * frequency / samples))
    # Beyond what the samples of a pixel can tell, all is lost anyhow.
    return np.asarray(np.prod(np.where(np.abs(frequency) < 1e-9, 1.0, along), axis=-1))


def _disc(argument: Array) -> Array:
    """Return 2 J1(z) / z, the transform of an even disc, as the mean of a wave over its chords."""
    nodes, shares = np.polynomial.chebyshev.chebgauss(24)
    # 2 J1(z) / z = 2/π ∫ √(1 - u²) cos(z u) du over [-1, 1]; Chebyshev's weight is 1 / √(1 - u²).
    weights = 2 / np.pi * shares * (1 - nodes**2)
    return np.asarray(sum(weight * np.cos(argument * node) for node, weight in zip(nodes, weights, strict=True)))
