"""Strain of the surfaces of an estimate or a truth, from points and displacements in moving windows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import label
from scenetruth.scoring.common_errors import CommonField, MeasuredPoints
from scenetruth.scoring.error_pairs import PixelCoordinates, find_valid_pixels
from scenetruth.scoring.growth_rate import label_depth_segments
from scenetruth.strain.camera_rays import CameraRays
from scenetruth.strain.gauge import (
    StrainGauge,
    StrainSettings,
    read_correlation_px,
    read_subset_px,
    strain_settings,
)
from scenetruth.strain.strain_tensors import (
    COMPONENTS_OF_STRAIN,
    PRINCIPAL,
    SurfaceStrain,
    principal_stds,
    principal_strain,
)
from scenetruth.strain.tracking import track_displacements
from scenetruth.strain.window_fit import FitWindow, fit_derivatives

__all__ = [
    "STRAIN_NONE",
    "STRAIN_NO_ESTIMATE",
    "STRAIN_WINDOW",
    "compute_strain",
    "describe_missing_strain",
    "reference_view",
]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

STRAIN_NONE, STRAIN_NO_ESTIMATE, STRAIN_WINDOW = range(3)
"""Values of ``invalid_reason`` of strain maps: valid; the point has no valid depth and motion; too few valid points of
the same surface in the window.
"""

_LINEAGE = ("method", "scene_hash", "recording_hash", "estimate_hash", "scene", "seed", "truth_poses")


def compute_strain(
    dataset: xr.Dataset,
    *,
    settings: StrainSettings | Mapping[str, Any] | None = None,
    displacement: ArrayLike | xr.DataArray | None = None,
    displacement_std: ArrayLike | xr.DataArray | None = None,
    since: int | None = None,
) -> xr.Dataset:
    """Return the strain of the surfaces of an estimate or a truth, with a stated gauge and standard deviations.

    Surface points P and their displacements U are fitted in windows as polynomials of the pixel's x and y, by weighted
    least squares. From the derivatives of both fits follow the deformation gradient of the tangent plane, F = 1 + H,
    and the strain of the reference configuration:

    - ``green_lagrange``: (FᵀF - 1) / 2, and ``hencky``: ln(FᵀF) / 2; both are zero for rigid motion
    - ``engineering``: (H + Hᵀ) / 2, which contains rotations by more than a few degrees as strain
    - ``rate``: (H + Hᵀ) / 2 of the velocity, per frame; its trace is `compute_growth_rate`

    All are exact where U is an affine function of P, on curved surfaces too. Windows contain points of one surface.
    Without displacements, the velocity gradient L is taken as steady for one frame: F = exp(L), in which rotations are
    no strain.

    Parameters
    ----------
    dataset
        An estimate with depth and velocity, or a truth; of all cameras, the reference camera is used.
    settings
        Measure, window, step, order, weights and limits: `scenetruth.strain.StrainSettings`, or a mapping of its
        fields.
    displacement
        Displacements of the points of all pixels in mm, axes of the camera, shape (3, t, y, x) or, with one frame,
        (3, y, x); for example a difference of `track_points`. Default: ``displacement_next`` of a complete truth,
        otherwise the velocity over one frame. Not used by ``rate``.
    displacement_std
        Standard deviations of given displacements, mm, of the same shape; independent unless the settings state a
        correlation.
    since
        Frame of the reference configuration for all frames: its points are tracked by the velocities, and the maps of
        every frame are those of its pixels. Default: the reference configuration of every frame is the frame itself.

    Returns
    -------
    xarray.Dataset
        Maps at every ``step``-th pixel, (t, y, x): ``exx``, ``eyy``, ``exy`` (the tensor's shear, half of γ) in the
        tangent plane, x along the projection of the camera's X axis; principal strains ``e1`` ≥ ``e2``, and ``angle``
        of the first from x towards y, rad; each with ``_std`` where the dataset states standard deviations and their
        correlation; ``valid`` and ``invalid_reason``; ``point`` and ``displacement``. Attributes state the
        settings and the gauge.

    Raises
    ------
    ScoreError
        If the dataset lacks depth or motion, or if settings or displacements are invalid; lists every problem.

    See Also
    --------
    score_strain : Statistics of the errors of strain.
    compute_growth_rate : Growth rate of the area.

    Examples
    --------
    A plane at a depth of 500 mm that is stretched by 1 % per frame along X:

    >>> import scenetruth as st
    >>> from scenetruth.schema import Intrinsics, label
    >>> y, x = np.mgrid[:48, :64] - 20.0
    >>> camera = Intrinsics(focal_length_px=500.0, principal_point_px=(20.0, 20.0), baseline_mm=5.0)
    >>> velocity = np.stack([1e-2 * x, 0 * x, 0 * x])[:, np.newaxis]
    >>> maps = label("estimate", {"depth": 0 * x[np.newaxis] + 500.0, "velocity": velocity}, camera, t=[0])
    >>> strain = st.compute_strain(maps, settings={"window": 5, "step": 2, "subset_px": 15})
    >>> print(strain.exx.dims, f"{float(strain.exx.sel(t=0, y=21, x=31)):.6f}", strain.attrs["gauge_length_px"])
    ('t', 'y', 'x') 0.010101 23.0
    """
    chosen = strain_settings(settings)
    motion = _Motion.of(dataset, chosen, displacement, displacement_std, since)
    view = reference_view(dataset)
    camera = CameraRays.of(view)
    intrinsics, grid = camera.intrinsics, camera.grid
    lattice = slice(min(chosen.step, *grid_sizes(view)) // 2, None, chosen.step)
    spacing = chosen.step * grid.step_px[0], chosen.step * grid.step_px[1]
    correlation = read_correlation_px(view) if chosen.correlation_sigma_px is None else chosen.correlation_sigma_px
    if motion.is_given and chosen.correlation_sigma_px is None:
        correlation = 0.0
    window = FitWindow(chosen.axis_weights(), chosen.order, chosen.min_coverage, spacing)
    points = PixelCoordinates(grid.y[lattice], grid.x[lattice])
    common = None if motion.is_given or since is not None else CommonField.from_estimate(dataset)
    homes = range(view.sizes["t"]) if since is None else [_index(view, since)] * view.sizes["t"]
    frames = [
        _Frame(view.isel(t=home), motion, n, chosen, camera, lattice).strain(
            window, correlation, common, view.isel(t=[home])
        )
        for n, home in enumerate(homes)
    ]
    arrays = {name: np.stack([frame[name] for frame in frames], axis=-3) for name in frames[0]}
    depth = arrays["point"][2][arrays["valid"]]
    scale = float(np.median(depth)) / intrinsics.focal_length_px if depth.size else math.nan
    subset = read_subset_px(view) if chosen.subset_px is None else chosen.subset_px
    gauge = StrainGauge(chosen.window, math.sqrt(spacing[0] * spacing[1]), subset, scale)
    attrs = {
        **{name: view.attrs[name] for name in _LINEAGE if name in view.attrs},
        **_stated(chosen),
        **gauge.to_attrs(),
        "displacement_source": motion.source,
        "std_parts": _std_parts(arrays),
    }
    found = label("strain", arrays, intrinsics, t=view["t"].values, x=points.x, y=points.y, attrs=attrs)
    for name in (*COMPONENTS_OF_STRAIN, "e1", "e2"):
        for each in (name, f"{name}_std", f"{name}_std_common"):
            if each in found:
                found[each].attrs["units"] = chosen.units
    return found


def describe_missing_strain(reasons: NDArray[np.integer[Any]], settings: StrainSettings) -> str:
    """Return why no point has strain, with a remedy, from ``invalid_reason``; empty if a point has strain."""
    if (reasons == STRAIN_NONE).any():
        return ""
    without = int((reasons == STRAIN_NO_ESTIMATE).sum())
    found = f"no strain: {without} of {reasons.size} points have no valid depth and motion"
    if without == reasons.size:
        return f"{found}; `invalid_reason` of the estimate states the reasons"
    width = (settings.window - 1) * settings.step + 1
    return (
        f"{found}, {reasons.size - without} have too few valid points in their window of {settings.window} points "
        f"every {settings.step} pixels, {width} pixels wide; reduce `window` or `step`"
    )


_STEADY = "velocity over one frame, with a steady velocity gradient"


def grid_sizes(dataset: xr.Dataset) -> tuple[int, int]:
    """Return the numbers of rows and columns."""
    return dataset.sizes["y"], dataset.sizes["x"]


def reference_view(dataset: xr.Dataset) -> xr.Dataset:
    """Return the maps of the reference camera."""
    maps = dataset[[name for name, item in dataset.data_vars.items() if {"t", "y", "x"} <= set(item.dims)]]
    return maps.sel({dim: 0 for dim in ("s_y", "s") if dim in maps["depth"].dims}).assign_attrs(dataset.attrs)


def _stated(chosen: StrainSettings) -> dict[str, Any]:
    names = ("measure", "window", "step", "order", "weights", "min_coverage", "max_slope_deg")
    found = {name: getattr(chosen, name) for name in names}
    return found | ({"edge_weight": chosen.edge_weight} if chosen.weights == "gaussian" else {})


def _std_parts(arrays: Mapping[str, Any]) -> str:
    """Return what the standard deviations contain."""
    if "exx_std" not in arrays:
        return "none: standard deviations of the motion, or the correlation of their errors, are not stated"
    return "image noise and calibration" if "exx_std_common" in arrays else "errors that differ between pixels"


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motion of all pixels: displacements in mm or velocities, shape (3, t, y, x), and their variances."""

    values: Map
    variances: Map | None
    source: str
    is_given: bool

    @classmethod
    def of(
        cls,
        dataset: xr.Dataset,
        chosen: StrainSettings,
        displacement: ArrayLike | xr.DataArray | None,
        displacement_std: ArrayLike | xr.DataArray | None,
        since: int | None,
    ) -> _Motion:
        """Return the motion, or raise with every problem."""
        problems = list(_dataset_problems(dataset, chosen, given=displacement is not None))
        if since is not None and not problems:
            problems += _since_problems(dataset, chosen, since, given=displacement is not None)
        if chosen.measure == "rate" and displacement is not None:
            problems.append(Problem("displacement", "must not be given for the rate, which follows from the velocity"))
        if displacement_std is not None and displacement is None:
            problems.append(Problem("displacement_std", "needs `displacement`"))
        if problems:
            raise ScoreError(problems)
        view = reference_view(dataset)
        shape = (3, *(view.sizes[dim] for dim in ("t", "y", "x")))
        if displacement is not None:
            values = _shaped("displacement", displacement, shape)
            std = None if displacement_std is None else _shaped("displacement_std", displacement_std, shape)
            if std is not None and (std < 0).any():
                raise ScoreError([Problem("displacement_std", "must not be negative", float(np.nanmin(std)))])
            return cls(values, None if std is None else std**2, "given", is_given=True)
        if since is not None:
            tracked = track_displacements(view, _index(view, since), math.tan(math.radians(chosen.max_slope_deg)))
            variances = None if tracked.stds is None else tracked.stds**2
            return cls(tracked.values, variances, f"velocity, integrated from frame {since}", is_given=False)
        if chosen.measure != "rate" and "displacement_next" in view:
            return cls(_array(view["displacement_next"]), None, "displacement_next", is_given=False)
        source = "velocity" if chosen.measure == "rate" else _STEADY
        return cls(_array(view["velocity"]), _pixel_variances(view, "velocity"), source, is_given=False)


def _dataset_problems(dataset: xr.Dataset, chosen: StrainSettings, *, given: bool) -> Iterator[Problem]:
    if not isinstance(dataset, xr.Dataset):
        yield Problem("", "must be an xarray.Dataset", type(dataset).__name__)
        return
    names = sorted(map(str, dataset.data_vars))
    missing = [dim for dim in ("t", "y", "x") if dim not in dataset.dims]
    if missing:
        yield Problem("dims", f"lack {', '.join(missing)}; strain needs maps (t, y, x)", list(map(str, dataset.dims)))
    if "depth" not in dataset:
        yield Problem("depth", "is missing; strain is computed from depth and motion", names)
    displaced = chosen.measure != "rate" and "displacement_next" in dataset
    if "velocity" not in dataset and not given and not displaced:
        yield Problem("velocity", "is missing; give it, or `displacement`", names)


def _since_problems(dataset: xr.Dataset, chosen: StrainSettings, since: int, *, given: bool) -> Iterator[Problem]:
    frames = dataset["t"].values.tolist()
    if isinstance(since, bool) or since not in frames:
        yield Problem("since", f"must be one of the frames {frames}", since)
    elif len(frames) < 2:
        yield Problem("since", "needs two or more frames with maps; estimate further frames, or omit it", since)
    if given or chosen.measure == "rate":
        yield Problem("since", "does not apply to given displacements or to the rate", since)
    if "velocity" not in dataset:
        yield Problem("velocity", "is missing; `since` integrates it")


def _index(view: xr.Dataset, t: int) -> int:
    return int(np.flatnonzero(view["t"].values == t)[0])


def _shaped(name: str, given: ArrayLike | xr.DataArray, shape: tuple[int, ...]) -> Map:
    """Return a given array with the shape (3, t, y, x)."""
    array = np.asarray(given)
    if array.dtype.kind not in "biuf":
        raise ScoreError([Problem(name, "must be an array of real numbers", str(array.dtype))])
    values = array.astype(np.float64)
    if values.ndim == 3 and shape[1] == 1:
        values = values[:, None]
    if values.shape != shape:
        raise ScoreError([Problem(name, f"must have the shape {shape}", values.shape)])
    return values


def _array(values: xr.DataArray) -> Map:
    return np.asarray(values.values, dtype=np.float64)


def _pixel_variances(view: xr.Dataset, name: str) -> Map | None:
    """Return the variances of the errors that differ between pixels; None if they are not stated."""
    if f"{name}_std" not in view:
        return None
    found = _array(view[f"{name}_std"]) ** 2
    if f"{name}_std_common" in view:
        found = np.maximum(found - _array(view[f"{name}_std_common"]) ** 2, 0.0)
    return found


class _Frame:
    """The points of one frame."""

    def __init__(
        self,
        maps: xr.Dataset,
        motion: _Motion,
        number: int,
        chosen: StrainSettings,
        camera: CameraRays,
        lattice: slice,
    ) -> None:
        self._chosen, self._lattice = chosen, (..., lattice, lattice)
        depth = _array(maps["depth"])
        self._moved, self._steady = motion.values[:, number], motion.source == _STEADY
        full = maps.expand_dims("t")
        valid = find_valid_pixels(full, "depth" if motion.is_given else "velocity")[0]
        self._points = camera.points(depth)
        self._known = valid & (depth > 0) & np.isfinite(self._points).all(axis=0) & np.isfinite(self._moved).all(axis=0)
        joined = np.where(self._known | ("mixed" in maps), depth, np.nan)
        segments = label_depth_segments(
            joined,
            camera.intrinsics.focal_length_px,
            chosen.max_slope_deg,
            objects=maps["object_id"].values if "object_id" in maps else None,
            step_px=camera.grid.step_px,
        )
        segments = np.where(self._known, segments, np.int32(-1)).astype(np.int32)
        self._segments = np.ascontiguousarray(segments[self._lattice])
        self._variances = self._stated_variances(maps, motion, number)

    def _stated_variances(self, maps: xr.Dataset, motion: _Motion, number: int) -> Map | None:
        """Return the variances of displacements and depth at the points, and where they are not stated, (5, y, x)."""
        if motion.variances is None:
            return None
        depth = None if motion.is_given else _pixel_variances(maps, "depth")
        of_depth = np.zeros(self._known.shape) if depth is None else depth
        found = np.concatenate([motion.variances[:, number], of_depth[None]])
        missing = ~np.isfinite(found)
        return np.concatenate([np.where(missing, 0.0, found), missing.any(axis=0)[None]])[self._lattice]

    def strain(
        self, window: FitWindow, correlation_px: float, common: CommonField | None, now: xr.Dataset
    ) -> dict[str, Any]:
        """Return the maps of the frame."""
        points, moved = self._points[self._lattice], self._moved[self._lattice]
        variances = self._variances if math.isfinite(correlation_px) else None
        modes = None if variances is None or common is None else self._modes(common, now)
        fields = [points, moved] + ([] if modes is None else [modes.reshape(-1, *moved.shape[1:])])
        known = self._segments >= 0
        filled = np.where(known, np.concatenate(fields), 0.0)
        fit = fit_derivatives(filled, self._segments, window, variances, correlation_px)
        valid = fit.fitted
        some = SurfaceStrain(fit.values[:, :3, valid], fit.values[:, 3:6, valid], self._chosen.measure, self._steady)
        strain = some.values()
        principal = principal_strain(strain)
        columns = dict(zip(COMPONENTS_OF_STRAIN, strain, strict=True))
        columns |= dict(zip(PRINCIPAL, (principal.larger, principal.smaller, principal.angle), strict=True))
        if variances is not None:
            covariance = self._covariance(some, fit.covariances[..., valid], valid)
            if modes is not None:
                shared = self._common(some, fit.values[:, 6:, valid], len(modes))
                columns |= _stds(strain, shared, "_std_common")
                covariance = covariance + shared
            columns |= _stds(strain, covariance, "_std")
        maps: dict[str, Any] = {}
        for name, values in columns.items():
            maps[name] = np.full(valid.shape, np.nan)
            maps[name][valid] = values
        reason = np.where(valid, STRAIN_NONE, np.where(known, STRAIN_WINDOW, STRAIN_NO_ESTIMATE))
        return {
            **maps,
            "valid": valid,
            "invalid_reason": reason.astype(np.uint8),
            "point": points,
            "displacement": np.where(known, moved, np.nan),
        }

    def _rays(self, valid: Mask) -> Map:
        """Return the rays with Z = 1 at the valid points, shape (3, n)."""
        points = self._points[self._lattice][:, valid]
        return np.asarray(points / points[2])

    def _covariance(self, some: SurfaceStrain, spread: Map, valid: Mask) -> Map:
        """Return the covariance of strain (xx, yy, xy) by the errors of all points, shape (3, 3, n)."""
        by_moved, by_depth = some.sensitivities(), some.slope_sensitivities(self._rays(valid))
        found = np.einsum("micn,ijcn,kjcn->mkn", by_moved, spread[:, :, :3], by_moved, optimize=True)
        found = found + np.einsum("min,ijn,kjn->mkn", by_depth, spread[:, :, 3], by_depth, optimize=True)
        # Windows with points whose standard deviation is not stated have none.
        return np.where(np.einsum("iin->n", spread[:, :, 4]) > 0, np.nan, found)

    def _modes(self, common: CommonField, now: xr.Dataset) -> Map:
        """Return the errors of displacements and points by every mode of a calibration, shape (mode, 2, 3, y, x)."""
        known = np.zeros(self._known.shape, dtype=np.bool_)
        known[self._lattice] = self._segments >= 0
        points = MeasuredPoints.from_estimate(now, 0, known)
        found = np.zeros((len(common.modes), 2, 3, *self._segments.shape))
        inside = self._segments >= 0
        place = 0
        values = np.zeros((len(common.modes), 2, 3, int(inside.sum())))
        for part in points.slices():
            each = points.part(part)
            size = len(each.depth)
            values[:, 0, :, place : place + size] = common.errors("velocity", each)
            values[:, 1, :, place : place + size] = common.displacements(each)
            place += size
        found[..., inside] = values
        return found

    @staticmethod
    def _common(some: SurfaceStrain, derivatives: Map, count: int) -> Map:
        """Return the covariance of strain by the modes of a calibration, shape (3, 3, n)."""
        each = derivatives.reshape(2, count, 2, 3, -1)
        errors = np.stack([some.changes(each[:, n, 1], each[:, n, 0]) for n in range(count)])
        return np.asarray(np.einsum("bmn,bkn->mkn", errors, errors))


def _stds(strain: Map, covariance: Map, ending: str) -> dict[str, Map]:
    """Return the standard deviations of all components."""
    found = {f"{name}{ending}": np.sqrt(covariance[k, k]) for k, name in enumerate(COMPONENTS_OF_STRAIN)}
    principal = principal_stds(strain, covariance)
    return found | {f"{name}{ending}": values for name, values in zip(PRINCIPAL, principal, strict=True)}
