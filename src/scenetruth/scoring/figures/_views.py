"""The arrays of the one frame that the figures show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import KIND_NONE, Intrinsics, intrinsics_of
from scenetruth.scoring.alignment import align, check_alignable, check_estimate, check_recording, select_pixels
from scenetruth.scoring.pixel_coordinates import PixelCoordinates, coordinates_of, surface_points
from scenetruth.scoring.quantities import QUANTITIES, full_pixels, quantities_of, read_quantity, read_std

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
    grid
        The pixels of all maps.
    intrinsics
        Of the estimate.
    estimate, truth
        Maps by the names of `QUANTITIES`: those that the estimate has. The estimate is NaN wherever its kind is not
        full (see `full_pixels`). Without truth, that is empty.
    mixed
        The truth's mixed pixels; none without truth.
    stds
        Standard deviations that the estimate states, by the names of `QUANTITIES`, in the units of the quantity, NaN
        where its kind is not full.
    confidence, model_violation
        Of the estimate, or None.
    kinds
        Those of ``kind``, ``kind_disparity`` and ``kind_motion`` that the estimate has, by their names.
    """

    frame: int
    image: Map
    image_frame: int
    image_is_digital: bool
    grid: PixelCoordinates
    intrinsics: Intrinsics
    estimate: dict[str, Map]
    truth: dict[str, Map]
    mixed: Mask
    stds: dict[str, Map]
    confidence: Map | None
    model_violation: Mask | None
    kinds: dict[str, NDArray[np.int64]]

    def knows(self, name: str) -> bool:
        """Return whether the estimate of a quantity, a key of `QUANTITIES`, has any value."""
        return name in self.estimate and bool(np.isfinite(self.estimate[name]).any())

    def panels(self, name: str) -> dict[str, Map]:
        """Return the estimate of a quantity and its truth, if there is one, by what they are."""
        return {"estimate": self.estimate[name]} | ({"truth": self.truth[name]} if name in self.truth else {})

    @property
    def map_focal_length_px(self) -> float:
        """The focal length, counted in the distances between pixels of the maps."""
        return self.intrinsics.focal_length_px / max(self.grid.step_px)

    def surface_points(self) -> Map:
        """Return the estimated surface (X, Y, Z) in mm, shape (y, x, 3), NaN where there is none."""
        return np.moveaxis(surface_points(self.estimate["depth"], self.intrinsics, self.grid), 0, -1)

    def velocities(self) -> Map:
        """Return the estimated velocity in mm per frame, shape (y, x, 3), NaN where there is none."""
        return np.stack([self.estimate[name] for name in ("velocity_x", "velocity_y", "velocity_z")], axis=-1)


def views_of(recording: xr.Dataset, estimate: xr.Dataset, truth: xr.Dataset | None = None) -> Views:
    """Pick the frame t = 0 of an estimate, or its middle one, and what belongs to it.

    Parameters
    ----------
    recording, estimate
        What was estimated from, and the estimate.
    truth
        What the estimate is compared with, if there is a truth.

    Raises
    ------
    ScoreError
        If estimate and truth cannot be compared, or the recording does not belong to them.
    """
    check_estimate(estimate)
    check_recording(recording, estimate)
    if truth is not None:
        check_alignable(estimate, truth)
    frames = estimate["t"].values.tolist()
    at = frames.index(0) if 0 in frames else len(frames) // 2
    # One frame is read, not all.
    estimate = estimate.isel(t=[at])
    if truth is not None:
        estimate, truth = align(estimate, truth)
    image_frame = frames[at] if frames[at] in recording["t"].values else 0
    image = select_pixels(recording, estimate)["image"].sel(
        {dim: 0 for dim in ("s_y", "s") if dim in recording["image"].dims} | {"t": image_frame}
    )
    grey = image.mean("channel") if "channel" in image.dims else image
    names = quantities_of(estimate)
    full = {name: full_pixels(estimate, QUANTITIES[name].variable)[0] for name in names}
    stds = {name: read_std(estimate, name) for name in names}
    return Views(
        frame=frames[at],
        image=grey.values.astype(np.float64),
        image_frame=image_frame,
        image_is_digital=image.dtype.kind in "ui",
        grid=coordinates_of(estimate),
        intrinsics=intrinsics_of(estimate),
        estimate={name: np.where(full[name], read_quantity(estimate, name)[0], np.nan) for name in names},
        truth={} if truth is None else {name: read_quantity(truth, name)[0] for name in names},
        mixed=np.zeros(grey.shape, dtype=bool) if truth is None else truth["mixed"].values[0].astype(bool),
        stds={name: np.where(full[name], std[0], np.nan) for name, std in stds.items() if std is not None},
        confidence=estimate["confidence"].values[0].astype(np.float64) if "confidence" in estimate else None,
        model_violation=_flags(estimate["model_violation"].values[0]) if "model_violation" in estimate else None,
        kinds={
            name: np.nan_to_num(estimate[name].values[0], nan=KIND_NONE).astype(np.int64)
            for name in ("kind", "kind_disparity", "kind_motion")
            if name in estimate
        },
    )


def _flags(values: NDArray[Any]) -> Mask:
    """Return flags that may have been read as numbers, NaN where there is none."""
    return np.asarray(np.nan_to_num(values).astype(bool))
