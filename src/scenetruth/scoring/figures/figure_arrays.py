"""The arrays of the frame that the figures show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import REASONS, STATUS_INVALID, Intrinsics, read_intrinsics
from scenetruth.scoring.alignment import align, check_alignable, check_estimate, check_recording, select_pixels
from scenetruth.scoring.error_pairs import (
    PixelCoordinates,
    compute_pixel_coordinates,
    compute_surface_points,
    find_valid_pixels,
    has_common_std,
    has_quantity,
    has_std,
    list_quantities,
    read_common_std,
    read_quantity,
    read_std,
)
from scenetruth.scoring.quantities import QUANTITIES

__all__ = ["FigureArrays", "collect_figure_arrays"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


class _ReadWhenNeeded(Mapping[str, Map]):
    """Maps by name, read at every access, because all maps of large images do not fit in memory together."""

    def __init__(self, names: Iterable[str], read: Callable[[str], Map]) -> None:
        self._names, self._read = tuple(names), read

    def __getitem__(self, name: str) -> Map:
        if name not in self._names:
            raise KeyError(name)
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass(frozen=True)
class FigureArrays:
    """The data of the figures for one frame; every map has the shape (y, x).

    ``image``, ``image_is_digital``: Image of the reference camera, and whether it holds digital numbers.
    ``estimate``, ``truth``: Maps of the scalar `QUANTITIES` of the estimate by name, NaN where invalid, and their truth
      (empty without truth).
    ``stds``: Stated standard deviations by the names of `QUANTITIES`, in the units of the quantity; NaN where invalid.
    ``common``: Part of the standard deviations that pixels have in common, where it is stated.
    ``fallback``: Fallback pixels that the maps of disparity and depth show; None if they show valid pixels only.
    ``statuses``: The available maps of ``status``, ``status_disparity`` and ``status_motion``.
    """

    frame: int
    image: Map
    image_frame: int
    image_is_digital: bool
    grid: PixelCoordinates
    intrinsics: Intrinsics
    estimate: Mapping[str, Map]
    truth: Mapping[str, Map]
    mixed: Mask
    stds: Mapping[str, Map]
    coherence: Map | None
    reasons: NDArray[np.int64] | None
    statuses: dict[str, NDArray[np.int64]]
    fallback: Mask | None = None
    common: Mapping[str, Map] = field(default_factory=dict)

    def knows(self, name: str) -> bool:
        """Return whether the estimate has any valid value of a quantity, a key of `QUANTITIES`."""
        return name in self.estimate and bool(np.isfinite(self.estimate[name]).any())

    def panels(self, name: str) -> dict[str, Map]:
        """Return the estimate of a quantity and its truth, if available, by panel title."""
        return {"estimate": self.estimate[name]} | ({"truth": self.truth[name]} if name in self.truth else {})

    @property
    def map_focal_length_px(self) -> float:
        """The focal length in units of the pixel distance of the maps."""
        return self.intrinsics.focal_length_px / max(self.grid.step_px)

    def surface_points(self) -> Map:
        """Return the estimated surface points (X, Y, Z) in mm, shape (y, x, 3), NaN where undefined."""
        return np.moveaxis(compute_surface_points(self.estimate["depth"], self.intrinsics, self.grid), 0, -1)

    def velocities(self) -> Map:
        """Return the estimated velocity in mm/frame, shape (y, x, 3), NaN where undefined."""
        return np.stack([self.estimate[name] for name in ("velocity_x", "velocity_y", "velocity_z")], axis=-1)


def _read_fallback(estimate: xr.Dataset) -> Mask | None:
    """Return where a single frame has fallback values of disparity and depth; None without either."""
    name = next((name for name in ("depth", "disparity") if name in estimate), None)
    if name is None:
        return None
    either = find_valid_pixels(estimate, name, include_fallback=True)
    return np.asarray((either & ~find_valid_pixels(estimate, name))[0])


def collect_figure_arrays(
    recording: xr.Dataset, estimate: xr.Dataset, truth: xr.Dataset | None = None, *, include_fallback: bool = False
) -> FigureArrays:
    """Return the data of the frame t = 0 of an estimate, or of its middle frame."""
    check_estimate(estimate)
    check_recording(recording, estimate)
    if truth is not None:
        check_alignable(estimate, truth)
    frames = estimate["t"].values.tolist()
    at = frames.index(0) if 0 in frames else len(frames) // 2
    # Only this frame is read.
    estimate = estimate.isel(t=[at])
    if truth is not None:
        estimate, truth = align(estimate, truth)
    image_frame = frames[at] if frames[at] in recording["t"].values else 0
    image = select_pixels(recording, estimate)["image"].sel(
        {dim: 0 for dim in ("s_y", "s") if dim in recording["image"].dims} | {"t": image_frame}
    )
    grey = image.mean("channel") if "channel" in image.dims else image
    names = list_quantities(estimate)

    def known(name: str, values: Map) -> Map:
        full = find_valid_pixels(estimate, QUANTITIES[name].variable, include_fallback=include_fallback)
        return np.where(full[0], values[0], np.nan)

    def std(name: str) -> Map:
        values = read_std(estimate, name)
        return np.full(grey.shape, np.nan) if values is None else known(name, values)

    def common(name: str) -> Map:
        values = read_common_std(estimate, name)
        return np.full(grey.shape, np.nan) if values is None else known(name, values)

    exact = estimate if truth is None else truth
    return FigureArrays(
        frame=frames[at],
        image=grey.values.astype(np.float64),
        image_frame=image_frame,
        # Images that are corrected are digital numbers with decimals.
        image_is_digital=image.dtype.kind in "ui" or float(recording.attrs.get("full_scale", 1.0)) > 1.0,
        grid=compute_pixel_coordinates(estimate),
        intrinsics=read_intrinsics(estimate),
        estimate=_ReadWhenNeeded(names, lambda name: known(name, read_quantity(estimate, name))),
        truth=_ReadWhenNeeded(
            () if truth is None else [name for name in names if has_quantity(truth, name)],
            lambda name: read_quantity(exact, name)[0],
        ),
        mixed=np.zeros(grey.shape, dtype=bool) if truth is None else truth["mixed"].values[0].astype(bool),
        stds=_ReadWhenNeeded([name for name in names if has_std(estimate, name)], std),
        common=_ReadWhenNeeded([name for name in names if has_common_std(estimate, name)], common),
        coherence=estimate["coherence"].values[0].astype(np.float64) if "coherence" in estimate else None,
        reasons=_codes(estimate, "invalid_reason", REASONS.index("not_determined"))
        if "invalid_reason" in estimate
        else None,
        statuses={
            name: _codes(estimate, name, STATUS_INVALID)
            for name in ("status", "status_disparity", "status_motion")
            if name in estimate
        },
        fallback=_read_fallback(estimate) if include_fallback else None,
    )


def _codes(estimate: xr.Dataset, name: str, otherwise: int) -> NDArray[np.int64]:
    """Return integer codes; codes read as floats are NaN where undefined."""
    return np.asarray(np.nan_to_num(estimate[name].values[0], nan=otherwise).astype(np.int64))
