"""Analytic planes with their truth, and the Cramér-Rao bound from Fisher matrices that are written out in full."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.indexing import centred_indices
from scenetruth.schema import Intrinsics, label
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
PER_FIELD = 3


def plane_of(**changes: Any) -> MovingPlane:
    """A small plane whose waves are long enough for splines to be exact to 1e-4."""
    return MovingPlane(**{"size": (30, 36), "wavelengths_px": (8.0, 16.0), "baseline_mm": 2.0, **changes})


def truth_of(plane: MovingPlane, **maps: Array) -> xr.Dataset:
    """The truth of the reference image."""
    told = plane.truth()
    arrays: dict[str, Any] = {name: told[name][None] for name in ("depth", "disparity")}
    arrays |= {name: told[name][:, None] for name in ("velocity", "flow")}
    arrays["normal"] = np.broadcast_to(
        told["normal"].reshape(3, 1, *told["normal"].shape[-2:]), told["velocity"][:, None].shape
    )
    arrays["mixed"] = np.zeros(plane.size, dtype=bool)[None]
    height, width = plane.size
    intrinsics = Intrinsics(plane.focal_px, ((width - 1) / 2, (height - 1) / 2), plane.baseline_mm)
    return label("truth", arrays | maps, intrinsics, t=[0])


@dataclass(frozen=True, eq=False)
class Sampled(MovingPlane):
    """The same plane, seen at any places: columns and rows from the principal point."""

    places: Array = field(default_factory=lambda: np.zeros((2, 1, 1)))

    def _rays(self, moved: Array | None = None) -> Array:
        x, y = self.places
        return np.stack([x / self.focal_px, y / self.focal_px, np.ones_like(x)], axis=-1)


def sampled(plane: MovingPlane, places: Array, s: float, t: float) -> Array:
    """Return what an image shows at some places."""
    values = {item.name: getattr(plane, item.name) for item in fields(MovingPlane)}
    return Sampled(**values, places=places).image((s * plane.baseline_mm, 0.0), t)


def directions(plane: MovingPlane, surface: str, motion: str, at: tuple[int, int]) -> Array:
    """What is unknown, as columns among d, d_x, d_y, q_X, its slopes along x and y, q_Y and q_Z alike."""
    found = [np.eye(12)[k] for k in ((0, 1, 2) if surface == "plane" else (0,))]
    found += [np.eye(12)[3 + PER_FIELD * k] for k in range(3)]
    matrices = []
    if motion in ("rigid", "growing"):
        matrices += [np.cross(axis, np.eye(3)).T for axis in np.eye(3)]
    if motion == "growing":
        matrices.append(np.eye(3))
    depth = plane.truth()["depth"]
    height, width = plane.size
    # Points in baselines beside the pixel: the surface's tangents by differences.
    points = {}
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        y, x = at[0] + down, at[1] + right
        ray = np.array([(x - (width - 1) / 2) / plane.focal_px, (y - (height - 1) / 2) / plane.focal_px, 1.0])
        points[right, down] = ray * depth[y, x] / plane.baseline_mm
    tangents = ((points[1, 0] - points[-1, 0]) / 2, (points[0, 1] - points[0, -1]) / 2)
    for matrix in matrices:
        column = np.zeros(12)
        for side, tangent in enumerate(tangents):
            column[[4 + side, 7 + side, 10 + side]] = matrix @ tangent
        found.append(column)
    if motion == "affine":
        found += [np.eye(12)[k] for k in (4, 5, 7, 8, 10, 11)]
    return np.array(found).T


def full_covariance(
    plane: MovingPlane,
    at: tuple[int, int],
    weights: Array,
    columns: Array,
    counts: tuple[int, int] = (3, 3),
    brightness: bool = False,
) -> Array:
    """Return the covariance of the 12 parameters at unit noise, from every sample of every image.

    One unknown texture value for each pixel of the window, and with ``brightness`` a gain and an offset for every image
    but the first. Derivatives are differences of exact images at places that are projected with changed parameters.
    ``weights`` has the shape of the window. A least squares fit of all that.
    """
    reach = weights.shape[0] // 2
    eta, xi = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
    start = plane.start()[:, at[0] - reach : at[0] + reach + 1, at[1] - reach : at[1] + reach + 1]
    height, width = plane.size
    x, y = xi + at[1] - (width - 1) / 2, eta + at[0] - (height - 1) / 2
    shapes = np.stack([np.ones_like(xi), xi, eta])

    def places(change: Array, s: float, t: float) -> Array:
        d, q_x, q_y, q_z = start + np.einsum("kj,jyx->kyx", change.reshape(4, 3), shapes)
        nearer = 1 + t * d * q_z / plane.focal_px
        return np.stack([(x + d * (t * q_x - s)) / nearer, (y + d * t * q_y) / nearer])

    images = [(float(s), float(t)) for s in centred_indices(counts[0]) for t in centred_indices(counts[1])]
    pixels = xi.size
    extra = 2 * (len(images) - 1) if brightness else 0
    unknown = columns.shape[1]
    design = np.zeros((len(images), pixels, unknown + pixels + extra))
    texture = sampled(plane, np.stack([x, y]), 0.0, 0.0)
    still = places(np.zeros(12), 1.0, 1.0)
    rates = [np.abs(places(1e-6 * each, 1.0, 1.0) - still).max() / 1e-6 for each in columns.T]
    for i, (s, t) in enumerate(images):
        for k in range(unknown):
            # Steps that move places by some 1e-4 px.
            step = 1e-4 / rates[k]
            one, other = (sampled(plane, places(sign * step * columns[:, k], s, t), s, t) for sign in (1.0, -1.0))
            design[i, :, k] = ((one - other) / (2 * step)).ravel()
        design[i, :, unknown : unknown + pixels] = np.eye(pixels)
        if brightness and i > 0:
            at_image = unknown + pixels + 2 * (i - 1)
            design[i, :, at_image], design[i, :, at_image + 1] = 1.0, texture.ravel() - texture.mean()
    rows = design.reshape(-1, design.shape[-1])
    own = np.tile(weights.ravel(), len(images))
    inverse = np.linalg.inv(rows.T @ (own[:, None] * rows))
    covariance = inverse @ (rows.T @ ((own**2)[:, None] * rows)) @ inverse
    return np.asarray(columns @ covariance[:unknown, :unknown] @ columns.T)
