"""Errors that the pixels of an estimate have in common: independent modes of a displacement of all points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import COMPONENTS, COORDINATES, describe_variable, read_intrinsics

__all__ = ["COMMON_QUANTITIES", "CommonField", "MeasuredPoints", "has_common_part"]

Floats = NDArray[np.float64]

_PIXELS = 4096  # pixels that are evaluated together

COMMON_QUANTITIES = ("depth", "velocity", "slope", "growth_rate")
"""Variables of an estimate with errors that pixels have in common."""


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
    ``rates``: Rates of the displacements in mm per frame, of the same modes, shape (m, 3, z, y, x); None if they are 0.
    """

    modes: Floats
    nodes: tuple[Floats, Floats, Floats]
    pixels: tuple[Floats, Floats]
    rates: Floats | None = None

    @classmethod
    def from_estimate(cls, estimate: xr.Dataset) -> CommonField | None:
        """Return the field that an estimate states; None if it states none."""
        if "calibration_modes" not in estimate:
            return None
        given = read_intrinsics(estimate)
        x, y, z = (estimate[f"node_{axis}"].values for axis in "xyz")
        c_x, c_y = given.principal_point_px
        nodes = (x - c_x) / given.focal_length_px, (y - c_y) / given.focal_length_px, z
        rates = estimate["calibration_rates"].values if "calibration_rates" in estimate else None
        return cls(estimate["calibration_modes"].values, nodes, (x, y), rates)

    def to_variables(self) -> dict[str, xr.Variable]:
        """Return the modes, and their rates, as variables of an estimate."""
        dims = ("mode", "component", "node_z", "node_y", "node_x")
        parts = {"calibration_modes": self.modes, "calibration_rates": self.rates}
        return {
            name: xr.Variable(dims, values, describe_variable("estimate", name))
            for name, values in parts.items()
            if values is not None
        }

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

    @cached_property
    def _drift(self) -> CommonField | None:
        """Field of the rates."""
        return None if self.rates is None else CommonField(self.rates, self.nodes, self.pixels)

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
            found = np.einsum("mckn,kn->mcn", gradients, points.velocity)
            return np.asarray(found if self._drift is None else found + self._drift.displacements(points))
        assert points.normal is not None  # asked by the callers
        normal, turned = points.normal
        if name == "slope":
            # The normal n changes by -Eᵀ n, with the derivatives E; slopes are -n_X / n_Z and -n_Y / n_Z.
            change = -np.einsum("mckn,cn->mkn", gradients, normal)
            slope = -normal[:2] / normal[2]
            return np.asarray(-(change[:, :2] + slope * change[:, 2:]) / normal[2])
        # An area with the normal n changes by tr E - n E n; the rate of this is the change of the growth rate.
        later = self.gradients(points.moved()) - gradients
        if self._drift is not None:
            later += self._drift.gradients(points)
        area = np.einsum("mkkn->mn", later) - np.einsum("cn,mckn,kn->mn", normal, later, normal)
        area -= np.einsum("cn,mckn,kn->mn", turned, gradients, normal)
        area -= np.einsum("cn,mckn,kn->mn", normal, gradients, turned)
        return np.asarray(area[:, None])


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
