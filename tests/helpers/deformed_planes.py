"""Tilted planes in front of a camera, deformed by a matrix, as estimates; and the strains that follow from it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import Intrinsics, label
from scenetruth.scoring.error_pairs import compute_surface_points

__all__ = ["CAMERA", "SHAPE", "estimate_of", "expected_strain", "plane_points", "tangent_axes"]

Map = NDArray[np.float64]

CAMERA = Intrinsics(500.0, (39.5, 29.5), 5.0, 60.0)
SHAPE = (60, 80)


def plane_points(tilt_deg: float, azimuth_deg: float = 37.0, distance_mm: float = 600.0) -> Map:
    """Return the points of a plane, tilted about an axis in the image, shape (3, y, x)."""
    rays = compute_surface_points(np.ones(SHAPE), CAMERA)
    slope, azimuth = math.tan(math.radians(tilt_deg)), math.radians(azimuth_deg)
    depth = distance_mm / (1.0 - slope * (math.cos(azimuth) * rays[0] + math.sin(azimuth) * rays[1]))
    return np.asarray(rays * depth)


def tangent_axes(points: Map) -> Map:
    """Return the x and y axes of the plane of points as columns, from three of its corners."""
    first, second, third = points[:, 0, 0], points[:, 0, -1], points[:, -1, 0]
    away = np.cross(second - first, third - first)
    away /= np.linalg.norm(away)
    along = np.array([1.0, 0.0, 0.0]) - away[0] * away
    along /= np.linalg.norm(along)
    return np.stack([along, np.cross(away, along)], axis=1)


def expected_strain(gradient: Map, axes: Map, measure: str) -> Map:
    """Return the tensor (2, 2) of a homogeneous deformation F = 1 + H in a plane, by eigenvalues."""
    if measure in ("engineering", "rate"):
        return np.asarray(axes.T @ (0.5 * (gradient + gradient.T)) @ axes)
    moved = (np.eye(3) + gradient) @ axes
    squares, vectors = np.linalg.eigh(moved.T @ moved)
    principal = 0.5 * (squares - 1) if measure == "green_lagrange" else 0.5 * np.log(squares)
    return np.asarray((vectors * principal) @ vectors.T)


def estimate_of(
    depth: Map, velocity: Map, std: tuple[float, float] | None = None, attrs: dict[str, Any] | None = None
) -> xr.Dataset:
    """Return an estimate of one frame; ``std``: standard deviations of velocity and depth."""
    maps = {"depth": depth[None], "velocity": velocity[:, None]}
    if std is not None:
        maps |= {"velocity_std": np.full((3, 1, *SHAPE), std[0]), "depth_std": np.full((1, *SHAPE), std[1])}
    return label("estimate", maps, CAMERA, t=[0], attrs=attrs)
