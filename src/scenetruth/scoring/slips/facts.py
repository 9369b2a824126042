"""The numbers of the camera and of the maps that slips are made of."""

from __future__ import annotations

from dataclasses import dataclass

import xarray as xr

from scenetruth.schema import intrinsics_of
from scenetruth.scoring.pixel_coordinates import coordinates_of

__all__ = ["Facts", "facts_of"]


@dataclass(frozen=True)
class Facts:
    """What slips of scale and of meaning depend on.

    Parameters
    ----------
    focal_length_px, baseline_mm, frame_interval_s
        As of `scenetruth.schema.Intrinsics`.
    positions
        How many positions the camera has on its stage, or None if the truth does not tell.
    step_px
        Distance of neighbouring pixels of the map, in px of the camera: 2 if every other pixel was taken.
    width_px
        Width of the map, in px of the camera.
    """

    focal_length_px: float
    baseline_mm: float
    frame_interval_s: float
    positions: int | None
    step_px: float
    width_px: float


def facts_of(estimate: xr.Dataset, truth: xr.Dataset) -> Facts:
    """Read the facts of an estimate, and of the whole truth that belongs to it."""
    camera = intrinsics_of(truth)
    _, step_px = coordinates_of(estimate).step_px
    return Facts(
        focal_length_px=camera.focal_length_px,
        baseline_mm=camera.baseline_mm,
        frame_interval_s=camera.frame_interval_s,
        positions=truth.sizes.get("s"),
        step_px=step_px,
        width_px=step_px * estimate.sizes["x"],
    )
