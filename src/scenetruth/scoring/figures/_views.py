"""The arrays of the one frame that the figures show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import KIND_NONE, Intrinsics, intrinsics_of
from scenetruth.scoring.alignment import align, check_recording
from scenetruth.scoring.quantities import QUANTITIES, full_pixels, read_quantity, read_std

__all__ = ["Views", "views_of"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Views:
    """What the figures of one frame draw; every map has the shape (y, x).

    Parameters
    ----------
    frame
        The estimate's frame t.
    image, image_frame, image_is_digital
        The reference camera's image, of colours the mean; its frame, and whether it holds digital numbers (else
        linear radiance).
    intrinsics
        Of the estimate.
    estimate, truth
        Maps by the names of `QUANTITIES`; the estimate is NaN wherever its kind is not full (see `full_pixels`).
    mixed
        The truth's mixed pixels.
    depth_std
        Standard deviation that the estimate states for its depth, in mm, NaN as the depth; or None.
    confidence, model_violation
        Of the estimate, or None.
    kinds
        Those of ``kind``, ``kind_disparity`` and ``kind_motion`` that the estimate has, by their names.
    """

    frame: int
    image: Map
    image_frame: int
    image_is_digital: bool
    intrinsics: Intrinsics
    estimate: dict[str, Map]
    truth: dict[str, Map]
    mixed: Mask
    depth_std: Map | None
    confidence: Map | None
    model_violation: Mask | None
    kinds: dict[str, NDArray[np.int64]]

    def knows(self, name: str) -> bool:
        """Return whether the estimate of a quantity, a key of `QUANTITIES`, has any value."""
        return bool(np.isfinite(self.estimate[name]).any())

    def surface_points(self) -> Map:
        """Return the estimated surface (X, Y, Z) in mm, shape (y, x, 3), NaN where there is none."""
        depth = self.estimate["depth"]
        c_x, c_y = self.intrinsics.principal_point_px
        y, x = np.indices(depth.shape, dtype=np.float64)
        scale = depth / self.intrinsics.focal_length_px
        return np.stack([(x - c_x) * scale, (y - c_y) * scale, depth], axis=-1)

    def velocities(self) -> Map:
        """Return the estimated velocity in mm per frame, shape (y, x, 3), NaN where there is none."""
        return np.stack([self.estimate[name] for name in ("velocity_x", "velocity_y", "velocity_z")], axis=-1)


def views_of(recording: xr.Dataset, estimate: xr.Dataset, truth: xr.Dataset) -> Views:
    """Pick the frame t = 0 of an estimate, or its middle one, and what belongs to it.

    Raises
    ------
    ScoreError
        If estimate and truth cannot be compared, or the recording does not belong to them.
    """
    check_recording(recording, estimate)
    estimate, truth = align(estimate, truth)
    frames = estimate["t"].values.tolist()
    at = frames.index(0) if 0 in frames else len(frames) // 2
    image_frame = frames[at] if frames[at] in recording["t"].values else 0
    image = recording["image"].sel(s=0, t=image_frame)
    grey = image.mean("channel") if "channel" in image.dims else image
    full = {entry.variable: full_pixels(estimate, entry.variable)[at] for entry in QUANTITIES.values()}
    depth_std = read_std(estimate, "depth")
    return Views(
        frame=frames[at],
        image=grey.values.astype(np.float64),
        image_frame=image_frame,
        image_is_digital=image.dtype.kind in "ui",
        intrinsics=intrinsics_of(estimate),
        estimate={
            name: np.where(full[entry.variable], read_quantity(estimate, name)[at], np.nan)
            for name, entry in QUANTITIES.items()
        },
        truth={name: read_quantity(truth, name)[at] for name in QUANTITIES},
        mixed=truth["mixed"].values[at].astype(bool),
        depth_std=None if depth_std is None else np.where(full["depth"], depth_std[at], np.nan),
        confidence=estimate["confidence"].values[at].astype(np.float64) if "confidence" in estimate else None,
        model_violation=_flags(estimate["model_violation"].values[at]) if "model_violation" in estimate else None,
        kinds={
            name: np.nan_to_num(estimate[name].values[at], nan=KIND_NONE).astype(np.int64)
            for name in ("kind", "kind_disparity", "kind_motion")
            if name in estimate
        },
    )


def _flags(values: NDArray[Any]) -> Mask:
    """Return flags that may have been read as numbers, NaN where there is none."""
    return np.asarray(np.nan_to_num(values).astype(bool))
