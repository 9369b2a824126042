"""Strain of a surface element from the derivatives of its points and displacements, with first-order covariances."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenetruth.strain.gauge import StrainMeasure

__all__ = ["COMPONENTS_OF_STRAIN", "PRINCIPAL", "PrincipalStrain", "SurfaceStrain", "principal_strain"]

Values = NDArray[np.float64]

COMPONENTS_OF_STRAIN = ("exx", "eyy", "exy")
PRINCIPAL = ("e1", "e2", "angle")

_PAIRS = ((0, 0), (1, 1), (0, 1))
_RANDOM_ANGLE = math.pi / math.sqrt(12)
"""Standard deviation of an undirected angle that is not determined, rad."""


@dataclass(frozen=True, eq=False)
class PrincipalStrain:
    """Larger and smaller principal strain, and the angle of the first from the x axis towards the y axis, rad."""

    larger: Values
    smaller: Values
    angle: Values

    def axes(self) -> Values:
        """Return the principal directions in the frame of the surface, shape (2 axes, 2 components, ...)."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return np.stack([np.stack([cos, sin]), np.stack([-sin, cos])])


def principal_strain(strain: Values) -> PrincipalStrain:
    """Return the principal values and angle, in (-π/2, π/2], of strain (xx, yy, xy), shape (3, ...)."""
    xx, yy, xy = strain
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    angle = np.where(angle <= -0.5 * math.pi, 0.5 * math.pi, angle)
    return PrincipalStrain(middle + half, middle - half, angle)


@dataclass(frozen=True, eq=False)
class SurfaceStrain:
    """Strain in the tangent plane of the reference configuration.

    The x axis of the plane is the projection of the X axis of the camera, z points away from the camera, and y = z × x.

    ``points``: Derivatives of the points by two parameters, shape (2, 3, n).
    ``moved``: Derivatives of their displacements (or velocities), shape (2, 3, n).
    ``steady``: Whether they are velocities whose gradient L is constant over the frame; then the deformation gradient
      is exp(L), without strain for rotations, instead of 1 + L. The normal turns with the surface.
    """

    points: Values
    moved: Values
    measure: StrainMeasure
    steady: bool = False

    @cached_property
    def axes(self) -> Values:
        """Axes x and y of the tangent plane, shape (2, 3, n)."""
        normal = np.cross(self.points[0], self.points[1], axis=0)
        normal = normal / np.linalg.norm(normal, axis=0)
        along = np.array([1.0, 0.0, 0.0])[:, None] - normal[0] * normal
        with np.errstate(invalid="ignore"):
            along = along / np.linalg.norm(along, axis=0)
        return np.asarray(np.stack([along, np.cross(normal, along, axis=0)]))

    @cached_property
    def parameters(self) -> Values:
        """Changes of the parameters per mm along the axes, shape (parameter, axis, n)."""
        metric = np.einsum("icn,jcn->nij", self.points, self.points)
        along = np.einsum("icn,acn->nia", self.points, self.axes)
        return np.asarray(np.linalg.solve(metric, along).transpose(1, 2, 0))

    @cached_property
    def gradient(self) -> Values:
        """Derivatives of the displacements along the axes, shape (axis, 3, n)."""
        found = np.asarray(np.einsum("ian,icn->acn", self.parameters, self.moved))
        return self._integrated(found) if self.steady and self.measure != "rate" else found

    def _integrated(self, rates: Values) -> Values:
        """Return the derivatives of the displacements over one frame from those of a steady velocity."""
        axes = self.axes
        normal = np.cross(axes[0], axes[1], axis=0)
        tilt = np.einsum("acn,cn->an", rates, normal)
        whole = np.einsum("acn,adn->ncd", rates, axes) - np.einsum("an,acn,dn->ncd", tilt, axes, normal)
        # Taylor series of the exponential of a sixteenth, squared four times.
        small, term = whole / 2**_SQUARINGS, np.eye(3)
        change = np.zeros_like(whole)
        with np.errstate(over="ignore", invalid="ignore"):
            for n in range(1, _TERMS + 1):
                term = term @ small / n
                change = change + term
            for _ in range(_SQUARINGS):
                # exp(2 A) - 1 from exp(A) - 1, without cancellation.
                change = 2 * change + change @ change
            return np.asarray(np.einsum("ncd,adn->acn", change, axes))

    def values(self) -> Values:
        """Return the strain (xx, yy, xy), with the shear of the tensor, shape (3, n)."""
        axes, gradient = self.axes, self.gradient
        linear = np.stack(
            [0.5 * ((axes[a] * gradient[b]).sum(axis=0) + (axes[b] * gradient[a]).sum(axis=0)) for a, b in _PAIRS]
        )
        if self.measure in ("engineering", "rate"):
            return np.asarray(linear)
        green = linear + np.stack([0.5 * (gradient[a] * gradient[b]).sum(axis=0) for a, b in _PAIRS])
        if self.measure == "green_lagrange":
            return np.asarray(green)
        principal = principal_strain(green)
        with np.errstate(invalid="ignore", divide="ignore"):
            both = 0.5 * np.log1p(2 * np.stack([principal.larger, principal.smaller]))
        return _composed(both, principal.axes())

    def sensitivities(self) -> Values:
        """Return the derivatives of the strain by those of the displacements, shape (3, 2, 3, n)."""
        if self.steady and self.measure != "rate":
            return self._steady_sensitivities()
        parameters = self.parameters
        ends = self.axes + self.gradient if self.measure in ("green_lagrange", "hencky") else self.axes
        found = np.stack(
            [0.5 * (parameters[:, a, None] * ends[b][None] + parameters[:, b, None] * ends[a][None]) for a, b in _PAIRS]
        )
        return np.einsum("mkn,kicn->micn", self._hencky_slope(), found) if self.measure == "hencky" else found

    def _steady_sensitivities(self) -> Values:
        """Return the same of steady velocities, whose errors change exp(L), by differences."""
        before, step = self.values(), _STEP * np.linalg.norm(self.points, axis=1)
        found = np.empty((3, *self.moved.shape))
        for i in range(2):
            for c in range(3):
                moved = self.moved.copy()
                moved[i, c] += step[i]
                found[:, i, c] = (replace(self, moved=moved).values() - before) / step[i]
        return found

    def slope_sensitivities(self, rays: Values) -> Values:
        """Return the derivatives of the strain by those of depth, with points along rays (3, n), shape (3, 2, n)."""
        before, found = self.values(), []
        step = _STEP * np.linalg.norm(self.points, axis=1)
        for i in range(2):
            points = self.points.copy()
            points[i] += step[i] * rays
            found.append((replace(self, points=points).values() - before) / step[i])
        return np.stack(found, axis=1)

    def changes(self, points: Values, moved: Values) -> Values:
        """Return the changes of the strain by those of the derivatives of points and displacements, shape (3, n)."""
        other = replace(self, points=self.points + points, moved=self.moved + moved)
        return np.asarray(other.values() - self.values())

    def _hencky_slope(self) -> Values:
        """Return the derivatives of Hencky strain by Green-Lagrange strain, both (xx, yy, xy), shape (3, 3, n)."""
        green = principal_strain(SurfaceStrain(self.points, self.moved, "green_lagrange", self.steady).values())
        axes, squares = green.axes(), [1 + 2 * green.larger, 1 + 2 * green.smaller]
        with np.errstate(invalid="ignore", divide="ignore"):
            apart = 0.5 * (squares[0] - squares[1])
            mean = 1 / (0.5 * (squares[0] + squares[1]))
            mixed = np.where(
                apart > _EQUAL, 0.5 * np.log(squares[0] / squares[1]) / np.where(apart > _EQUAL, apart, 1), mean
            )
        found = []
        for unit in _UNITS:
            inner = np.einsum("pan,ab,qbn->pqn", axes, unit, axes)
            scaled = np.stack([inner[0, 0] / squares[0], inner[1, 1] / squares[1], inner[0, 1] * mixed])
            full = (
                np.einsum("n,an,bn->abn", scaled[0], axes[0], axes[0])
                + np.einsum("n,an,bn->abn", scaled[1], axes[1], axes[1])
                + np.einsum("n,an,bn->abn", scaled[2], axes[0], axes[1])
                + np.einsum("n,an,bn->abn", scaled[2], axes[1], axes[0])
            )
            found.append(np.stack([full[a, b] for a, b in _PAIRS]))
        return np.stack(found, axis=1)


_SQUARINGS, _TERMS = 4, 12
_STEP = 1e-7
_EQUAL = 1e-9
_UNITS = (np.array([[1.0, 0], [0, 0]]), np.array([[0, 0], [0, 1.0]]), np.array([[0, 1.0], [1.0, 0]]))
"""Tensors of which only xx, yy or xy is 1."""


def _composed(both: Values, axes: Values) -> Values:
    """Return the tensor (xx, yy, xy) with principal values and axes."""
    return np.stack([both[0] * axes[0, a] * axes[0, b] + both[1] * axes[1, a] * axes[1, b] for a, b in _PAIRS])


def principal_stds(strain: Values, covariance: Values) -> Values:
    """Return the standard deviations of principal strains and angle, shape (3, n).

    ``strain``: Strain (xx, yy, xy), shape (3, n). ``covariance``: Its covariance, shape (3, 3, n).

    Errors move principal strains apart: two equal values become different. The shift is included with three times its
    value of second order, since it is computed from the noisy difference, and with at most that of equal principal
    strains. The standard deviation of the angle is at most that of a random one.
    """
    principal = principal_strain(strain)
    axes = principal.axes()

    def row(one: Values, other: Values) -> Values:
        return np.stack([one[0] * other[0], one[1] * other[1], one[0] * other[1] + one[1] * other[0]])

    def variance(weights: Values) -> Values:
        return np.asarray(np.maximum(np.einsum("mn,mkn,kn->n", weights, covariance, weights), 0.0))

    first, second = variance(row(axes[0], axes[0])), variance(row(axes[1], axes[1]))
    mixed = variance(row(axes[0], axes[1]))
    apart = principal.larger - principal.smaller
    with np.errstate(invalid="ignore", divide="ignore"):
        push = np.minimum(np.sqrt(mixed), np.where(apart > 0, 3 * mixed / apart, np.inf))
        angle = np.minimum(np.where(apart > 0, np.sqrt(mixed) / apart, np.inf), _RANDOM_ANGLE)
    return np.stack([np.sqrt(first + push**2), np.sqrt(second + push**2), np.where(mixed == 0, 0.0, angle)])
