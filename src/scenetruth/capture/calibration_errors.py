"""Errors of an estimate that a calibration causes: their part of the standard deviations, and their modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.calibration.measurement_covariance import point_modes
from scenetruth.capture.rectification import (
    ideal_principal_point,
    ideal_rotation,
    load_calibration,
    step_factor,
)
from scenetruth.errors import ArgumentError, Problem
from scenetruth.schema import COMPONENTS, COORDINATES, describe_variable, estimate_hash, read_intrinsics

__all__ = ["QUANTITIES", "CommonField", "MeasuredPoints", "add_calibration_errors", "common_variance"]

Floats = NDArray[np.float64]

_NODES = (6, 5, 3)  # nodes along x, y and Z: polynomials of degree 5, 4 and 2
_LEAST_DEPTH_RANGE = 0.05  # smallest range of the depths of the nodes, relative to their mean
_SAME = 1e-9  # relative difference of intrinsic parameters by rounding
_LEAST_MODE = 1e-4  # modes of smaller displacements, relative to the largest, have no effect
_PIXELS = 4096  # pixels that are evaluated together

QUANTITIES = ("depth", "velocity", "slope", "growth_rate")
"""Quantities of an estimate with errors by a calibration."""


def add_calibration_errors(estimate: xr.Dataset, calibration: RigCalibration | str | Path) -> xr.Dataset:
    """Add the uncertainty of a calibration to the standard deviations of an estimate from rectified images.

    Parameters
    ----------
    estimate
        Estimate from a recording of `scenetruth.capture.import_capture` with this calibration.
    calibration
        The calibration, or its file.

    Returns
    -------
    xarray.Dataset
        The estimate. ``depth_std``, ``velocity_std``, ``slope_std`` and ``growth_rate_std`` contain the errors that the
        calibration causes, and ``depth_std_common``, ``velocity_std_common``, ``slope_std_common`` and
        ``growth_rate_std_common`` state the part that pixels have in common. ``calibration_modes`` holds the
        independent errors of points, from which `scenetruth.capture.region_mean` computes the uncertainty of means and
        differences.

    Raises
    ------
    ArgumentError
        If the estimate contains the errors of a calibration already, has no depth or no standard deviation, or its
        intrinsic parameters are not those of the ideal rig of the calibration.

    See Also
    --------
    scenetruth.capture.region_mean : Mean over a region, or difference of two regions.
    scenetruth.capture.calibration.RigCalibration.point_errors : The same for single points.

    Notes
    -----
    A calibration with errors displaces every point P by a smooth field δ(P): a sum of independent modes. Depth changes
    by its component along Z. A velocity U changes by (U·∇) δ, a slope by the derivatives of δ along the surface, and a
    growth rate by the change of these derivatives along U. Disparity and flow are those of the rectified images.

    Examples
    --------
    >>> import scenetruth as st
    >>> from scenetruth.camera import Camera
    >>> camera = Camera(width=60, height=40, focal_length_px=1000)
    >>> rig = RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 1.0})
    >>> recording = st.make_recording(np.zeros((3, 1, 40, 60)), focal_length_px=1000, baseline_mm=5)
    >>> depth, std = np.full((40, 60), 500.0), np.full((40, 60), 0.3)
    >>> estimate = st.make_estimate(depth=depth, depth_std=std, recording=recording)
    >>> found = add_calibration_errors(estimate, rig)

    A relative error of the focal length of 0.001 is one of the depth:

    >>> print(np.round(found.depth_std_common[0, 20, 30].item(), 3), np.round(found.depth_std[0, 20, 30].item(), 3))
    0.5 0.583
    """
    rig = load_calibration(calibration)
    problems = list(_problems(estimate, rig))
    if problems:
        raise ArgumentError(problems, source="add_calibration_errors")
    field = CommonField.from_calibration(rig, estimate)
    found: dict[str, Any] = {"calibration_modes": field.to_variable()}
    for name in QUANTITIES:
        if not has_common_part(estimate, name) or f"{name}_std" not in estimate:
            continue
        added = common_variance(estimate, field, name)
        for ending in ("_std", "_std_common"):
            variable = name + ending
            before = estimate[variable].values.astype(np.float64) if variable in estimate else np.zeros(added.shape)
            total = np.sqrt(before**2 + added).astype(np.float32)
            found[variable] = (estimate[name].dims, total, describe_variable("estimate", variable))
    done = estimate.assign(found).assign_coords(field.coordinates())
    if "estimate_hash" in done.attrs:
        done.attrs["estimate_hash"] = estimate_hash(done)
    return done


def _problems(estimate: xr.Dataset, rig: RigCalibration) -> Iterator[Problem]:
    """Yield why the errors of a calibration cannot be added to an estimate."""
    lacking = [name for name in ("depth", "depth_std") if name not in estimate]
    if lacking:
        yield Problem("estimate", f"must have {' and '.join(lacking)}", sorted(map(str, estimate.data_vars)))
        return
    if "calibration_modes" in estimate:
        yield Problem("estimate", "contains the errors of a calibration already")
    given, remedy = read_intrinsics(estimate), "use the calibration that has rectified the images"
    step, offset = _pixels_of(estimate, rig)
    focal = rig.value("f") / step
    if step not in (1, 2) or abs(given.focal_length_px / focal - 1) > _SAME:
        message = f"is {given.focal_length_px:.9g} px, but {focal:.9g} px in the calibration"
        yield Problem("focal_length_px", f"{message}: {remedy}")
        return
    if (np.abs(offset - np.rint(offset)) > _SAME * focal).any() or not np.isin(np.rint(offset), range(step)).all():
        point = (np.array(ideal_principal_point(rig)) / step).tolist()
        message = f"is {list(given.principal_point_px)} px, but {point} px in the calibration"
        yield Problem("principal_point_px", f"{message}: {remedy}")
    steps = step_factor(rig) * np.diff(rig.positions_mm)
    low, high = (float(end) for end in (steps.min(), steps.max()))
    if not low - _SAME * abs(low) <= given.baseline_mm <= high + _SAME * abs(high):
        message = f"is {given.baseline_mm:.9g} mm, but the steps of the calibration are {low:.9g} to {high:.9g} mm"
        yield Problem("baseline_mm", f"{message}: {remedy}")


def _pixels_of(estimate: xr.Dataset, rig: RigCalibration) -> tuple[int, Floats]:
    """Return the spacing in px of the camera of the pixels to which the intrinsics refer, and the first of them."""
    given = read_intrinsics(estimate)
    step = round(rig.value("f") / given.focal_length_px)
    return step, np.array(ideal_principal_point(rig)) - step * np.array(given.principal_point_px)


@dataclass(frozen=True, eq=False)
class MeasuredPoints:
    """Points of a surface and their motion, in the frame of the camera.

    ``rays``: X / Z and Y / Z, shape (2, n). ``depth``: Z in mm, shape (n,).
    ``velocity``: Displacement per frame in mm, shape (3, n); None if it is not estimated.
    ``normal``: Unit normal, and its change per frame, shape (2, 3, n); None if they are not estimated.
    """

    rays: Floats
    depth: Floats
    velocity: Floats | None = None
    normal: Floats | None = None

    @classmethod
    def from_estimate(cls, estimate: xr.Dataset, t: int, where: NDArray[np.bool_]) -> MeasuredPoints:
        """Return the points of a frame at pixels with a finite depth; ``t`` is the index of the frame."""
        now, given = estimate.isel(t=t), read_intrinsics(estimate)
        rows, columns = np.nonzero(where)
        x, y = estimate["x"].values[columns], estimate["y"].values[rows]
        c_x, c_y = given.principal_point_px
        rays = np.stack([x - c_x, y - c_y]) / given.focal_length_px

        def at(name: str) -> Floats:
            return np.asarray(now[name].values[..., rows, columns], dtype=np.float64)

        velocity = at("velocity") if "velocity" in now else None
        normal = None
        if "slope" in now:
            slope = at("slope")
            own = np.concatenate([slope, np.full((1, len(rows)), -1.0)])
            own /= np.linalg.norm(own, axis=0)
            turned = np.cross(at("rotation_rate"), own, axis=0) if "rotation_rate" in now else np.zeros_like(own)
            normal = np.stack([own, turned])
        return cls(rays, at("depth"), velocity, normal)

    def slices(self) -> Iterator[slice]:
        """Yield parts of the points that are evaluated together."""
        for first in range(0, len(self.depth), _PIXELS):
            yield slice(first, first + _PIXELS)

    def part(self, some: slice) -> MeasuredPoints:
        """Return some of the points."""
        velocity = None if self.velocity is None else self.velocity[:, some]
        normal = None if self.normal is None else self.normal[..., some]
        return MeasuredPoints(self.rays[:, some], self.depth[some], velocity, normal)

    def moved(self) -> MeasuredPoints:
        """Return the points one frame later."""
        assert self.velocity is not None  # asked by the callers
        points = np.concatenate([self.rays * self.depth, self.depth[None]]) + self.velocity
        return MeasuredPoints(points[:2] / points[2], points[2])


@dataclass(frozen=True, eq=False)
class CommonField:
    """Displacements of points that a calibration causes, as polynomials of X / Z, Y / Z and Z.

    ``modes``: Displacements at the nodes in mm, each by one standard deviation, shape (m, 3, z, y, x).
    ``nodes``: X / Z, Y / Z and Z of the nodes.
    ``pixels``: Columns and rows of the nodes.
    """

    modes: Floats
    nodes: tuple[Floats, Floats, Floats]
    pixels: tuple[Floats, Floats]

    @classmethod
    def from_calibration(cls, rig: RigCalibration, estimate: xr.Dataset) -> CommonField:
        """Return the field of a calibration over the pixels and depths of an estimate."""
        given = read_intrinsics(estimate)
        c_x, c_y = given.principal_point_px
        x, y = (
            _chebyshev(float(estimate[dim][0]), float(estimate[dim][-1]), n)
            for dim, n in zip("xy", _NODES, strict=False)
        )
        depth = estimate["depth"].values
        middle = float(np.median(depth[np.isfinite(depth)])) if np.isfinite(depth).any() else 1.0
        usual = depth[np.isfinite(depth) & (depth > middle / 2) & (depth < 2 * middle)]
        low, high = (float(usual.min()), float(usual.max())) if usual.size else (middle, middle)
        least = _LEAST_DEPTH_RANGE * middle
        if high - low < least:
            low, high = (low + high - least) / 2, (low + high + least) / 2
        nodes = (x - c_x) / given.focal_length_px, (y - c_y) / given.focal_length_px, _chebyshev(low, high, _NODES[2])
        depths, down, across = np.meshgrid(*nodes[::-1], indexing="ij")
        points = np.stack([across * depths, down * depths, depths], axis=-1).reshape(-1, 3)
        turn = ideal_rotation(rig)
        modes = point_modes(
            rig.values, rig.covariance, rig.layout, rig.positions_mm, rig.reference, points @ turn.T
        )  # fmt: skip
        # From the frame of the reference camera to that of the ideal rig.
        modes = modes @ turn
        sizes = np.sqrt(np.mean(modes**2, axis=(1, 2)))
        modes = modes[sizes > _LEAST_MODE * sizes.max(initial=0.0)]
        return cls(modes.reshape(len(modes), *depths.shape, 3).transpose(0, 4, 1, 2, 3), nodes, (x, y))

    @classmethod
    def from_estimate(cls, estimate: xr.Dataset) -> CommonField | None:
        """Return the field that an estimate states; None if it states none."""
        if "calibration_modes" not in estimate:
            return None
        given = read_intrinsics(estimate)
        x, y, z = (estimate[f"node_{axis}"].values for axis in "xyz")
        c_x, c_y = given.principal_point_px
        nodes = (x - c_x) / given.focal_length_px, (y - c_y) / given.focal_length_px, z
        return cls(estimate["calibration_modes"].values, nodes, (x, y))

    def to_variable(self) -> xr.Variable:
        """Return the modes as a variable of an estimate."""
        attrs = describe_variable("estimate", "calibration_modes")
        return xr.Variable(("mode", "component", "node_z", "node_y", "node_x"), self.modes, attrs)

    def coordinates(self) -> Mapping[str, xr.Variable]:
        """Return the coordinates of the nodes."""
        found = {"component": xr.Variable("component", COMPONENTS["component"])}
        for name, values in zip(("node_x", "node_y", "node_z"), (*self.pixels, self.nodes[2]), strict=True):
            units, text = COORDINATES[name]
            found[name] = xr.Variable(name, values, {"units": units, "long_name": text})
        return found

    @cached_property
    def _coefficients(self) -> Floats:
        """Coefficients of the Legendre polynomials, shape (z y x, m, 3)."""
        inverse = [np.linalg.inv(_legendre(_scaled(nodes, nodes), len(nodes))) for nodes in self.nodes]
        found = np.einsum("mczyx,ix,jy,kz->kjimc", self.modes, *inverse, optimize=True)
        return np.asarray(found.reshape(int(np.prod(found.shape[:3])), *found.shape[3:]))

    def displacements(self, points: MeasuredPoints) -> Floats:
        """Return the displacements of points by every mode, shape (m, 3, n)."""
        return self._evaluate(points, (0, 0, 0))

    def gradients(self, points: MeasuredPoints) -> Floats:
        """Return the derivatives of the displacements by X, Y and Z, the last of three, shape (m, 3, 3, n)."""
        x, y, z = (self._evaluate(points, order) for order in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
        # At constant X and Y, a point that is farther by dZ is seen at a smaller X / Z.
        ahead = z - (x * points.rays[0] + y * points.rays[1]) / points.depth
        return np.stack([x / points.depth, y / points.depth, ahead], axis=2)

    def _evaluate(self, points: MeasuredPoints, order: tuple[int, int, int]) -> Floats:
        bases = []
        for values, nodes, derivative in zip((*points.rays, points.depth), self.nodes, order, strict=True):
            basis = _legendre(_scaled(values, nodes), len(nodes), derivative)
            bases.append(basis * (2 / (nodes[-1] - nodes[0])) ** derivative)
        across, down, deep = bases
        design = np.einsum("nk,nj,ni->nkji", deep, down, across).reshape(len(points.depth), -1)
        return np.asarray(np.tensordot(design, self._coefficients, axes=1).transpose(1, 2, 0))

    def errors(self, name: str, points: MeasuredPoints) -> Floats:
        """Return the errors of a quantity by every mode, shape (m, components, n).

        ``name``: ``depth``, ``velocity``, ``slope`` or ``growth_rate``.
        """
        if name == "depth":
            return self.displacements(points)[:, 2:]
        gradients = self.gradients(points)
        if name == "velocity":
            assert points.velocity is not None  # asked by the callers
            return np.asarray(np.einsum("mckn,kn->mcn", gradients, points.velocity))
        assert points.normal is not None  # asked by the callers
        normal, turned = points.normal
        if name == "slope":
            # The normal n changes by -Eᵀ n, with the derivatives E; slopes are -n_X / n_Z and -n_Y / n_Z.
            change = -np.einsum("mckn,cn->mkn", gradients, normal)
            slope = -normal[:2] / normal[2]
            return np.asarray(-(change[:, :2] + slope * change[:, 2:]) / normal[2])
        # An area with the normal n changes by tr E - n E n; the rate of this is the change of the growth rate.
        later = self.gradients(points.moved()) - gradients
        area = np.einsum("mkkn->mn", later) - np.einsum("cn,mckn,kn->mn", normal, later, normal)
        area -= np.einsum("cn,mckn,kn->mn", turned, gradients, normal)
        area -= np.einsum("cn,mckn,kn->mn", normal, gradients, turned)
        return np.asarray(area[:, None])


def _chebyshev(low: float, high: float, count: int) -> Floats:
    """Return the extrema of a Chebyshev polynomial, with the ends of the range."""
    places = -np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray((low + high + places * (high - low)) / 2)


def _scaled(values: Floats, nodes: Floats) -> Floats:
    return np.asarray((2 * values - nodes[0] - nodes[-1]) / (nodes[-1] - nodes[0]))


def _legendre(values: Floats, count: int, derivative: int = 0) -> Floats:
    """Return Legendre polynomials, or their derivatives, shape (n, count)."""
    from numpy.polynomial.legendre import legder, legval

    each = [legval(values, legder(unit, derivative)) for unit in np.eye(count)]
    return np.stack([np.broadcast_to(column, values.shape) for column in each], axis=-1)


def has_common_part(estimate: xr.Dataset, name: str) -> bool:
    """Return whether the errors of a quantity by a calibration follow from an estimate."""
    needs = {"velocity": ("velocity",), "slope": ("slope",), "growth_rate": ("slope", "velocity")}
    return all(each in estimate for each in ("depth", name, *needs.get(name, ())))


def common_variance(estimate: xr.Dataset, field: CommonField, name: str) -> Floats:
    """Return the variance of a quantity by the modes of a calibration, of the shape of its map; NaN where invalid."""
    shape = estimate[name].shape
    found = np.full(shape, np.nan)
    for t in range(estimate.sizes["t"]):
        where = np.isfinite(estimate["depth"].isel(t=t).values)
        if name != "depth":
            values = estimate[name].isel(t=t).values
            where &= np.isfinite(values if values.ndim == 2 else values.all(axis=0))
        points = MeasuredPoints.from_estimate(estimate, t, where)
        variance = np.empty((*shape[:-3], len(points.depth)))
        for some in points.slices():
            variance[..., some] = np.square(field.errors(name, points.part(some))).sum(axis=0).reshape(*shape[:-3], -1)
        rows, columns = np.nonzero(where)
        found[..., t, rows, columns] = variance
    return found
