"""Where the points of a body are before anything moves them, and the coordinates along its surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.jets import Field, Jet
from scenetruth.scene.jets.slots import AA, AB, ACROSS, ALONG, BB, TA, TB, TT, VALUE, A, B, T
from scenetruth.scene.mesh.base import TriangleMesh
from scenetruth.scene.motion import Points
from scenetruth.scene.surface.osculation import Osculation, osculate

__all__ = ["RestStart", "SheetStart", "SmoothStart", "Start", "osculating_jet", "start_of"]


class Start(Protocol):
    """The points of a body at the beginning of its chain of maps."""

    @property
    def corners(self) -> NDArray[np.int32]:
        """The surface point at every corner of every face, shape (m, 3)."""
        ...

    def at(self, t: Field) -> Points:
        """Return the coordinates of all vertices at times t: fields of the kind of t."""
        ...

    def surface(self, t: Jet) -> Points:
        """Return those of all surface points as jets in t, a and b."""
        ...


@dataclass(frozen=True, eq=False)
class SheetStart:
    """A flat sheet: its material coordinates a, b in mm are X and Y, and Z is zero.

    Parameters
    ----------
    material_mm
        Coordinates (a, b) of the vertices, shape (n, 2).
    faces
        Vertex indices, shape (m, 3).
    """

    material_mm: NDArray[np.float64]
    faces: NDArray[np.int32]

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices are surface points."""
        return self.faces

    def at(self, t: Field) -> Points:
        """Return the flat sheet."""
        a, b = self.material_mm.T
        return like(a, t), like(b, t), like(np.zeros_like(a), t)

    def surface(self, t: Jet) -> Points:
        """Return the flat sheet with its derivatives."""
        a, b = np.ascontiguousarray(self.material_mm.T)
        return Jet.variable(a, ALONG, 3), Jet.variable(b, ACROSS, 3), Jet.constant(np.zeros_like(a), 3)


@dataclass(frozen=True, eq=False)
class MeshAtRest:
    """Vertices that stay where they are in the own frame.

    Parameters
    ----------
    vertices_mm
        Positions in the own frame, shape (n, 3).
    faces
        Vertex indices, shape (m, 3).
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]

    def at(self, t: Field) -> Points:
        """Return the mesh."""
        x, y, z = self.vertices_mm.T
        return like(x, t), like(y, t), like(z, t)


@dataclass(frozen=True, eq=False)
class RestStart(MeshAtRest):
    """A mesh at rest, whose surface has no formula.

    Parameters
    ----------
    vertices_mm, faces
        Of `MeshAtRest`.
    crease_deg
        Faces that meet at a larger angle belong to different pieces of the surface; see `TriangleMesh`.
    """

    crease_deg: float | NDArray[np.float64]

    @cached_property
    def osculation(self) -> Osculation:
        """The derivatives along the surface."""
        return osculate(self.vertices_mm, self.faces, self.crease_deg)

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices on sharp edges are several surface points."""
        return self.osculation.corners

    def surface(self, t: Jet) -> Points:
        """Return the mesh with the derivatives of fits to it."""
        fields = [osculating_jet(self.osculation, column[None]) for column in self.vertices_mm.T]
        return fields[0], fields[1], fields[2]


@dataclass(frozen=True, eq=False)
class SmoothStart(MeshAtRest):
    """A mesh at rest on a smooth surface whose formula is known.

    Parameters
    ----------
    vertices_mm, faces
        Of `MeshAtRest`.
    along
        Derivatives (a, b, aa, ab, bb) of the positions along the surface, shape (5, n, 3).
    """

    along: NDArray[np.float64]

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices are surface points."""
        return self.faces

    def surface(self, t: Jet) -> Points:
        """Return the mesh with its derivatives."""
        coefficients = np.zeros((3, 10, len(self.vertices_mm)))
        coefficients[:, VALUE] = self.vertices_mm.T
        coefficients[:, [A, B, AA, AB, BB]] = np.moveaxis(self.along, 2, 0)
        x, y, z = map(Jet, coefficients)
        return x, y, z


def start_of(mesh: TriangleMesh) -> Start:
    """Return where the points of a mesh are at rest, with the best derivatives along its surface that it allows."""
    if mesh.material_mm is not None:
        return SheetStart(mesh.material_mm, mesh.faces)
    if mesh.along is not None:
        return SmoothStart(mesh.vertices_mm, mesh.faces, mesh.along)
    return RestStart(mesh.vertices_mm, mesh.faces, mesh.crease_deg)


def like(values: NDArray[np.float64], t: Field) -> Any:
    """Return values that do not change as a field of the kind of t."""
    if isinstance(t, Jet):
        return Jet.constant(np.ascontiguousarray(values, dtype=t.coefficients.dtype), t.variables)
    return np.asarray(values, dtype=t.dtype)


def osculating_jet(osculation: Osculation, orders: NDArray[np.float64]) -> Jet:
    """Return a field on the vertices as a jet in t, a and b at the surface points.

    Parameters
    ----------
    osculation
        The fits.
    orders
        The field and, as far as it moves, its first and second derivative in time, shape (1 to 3, n).
    """
    coefficients = np.zeros((10, len(osculation.vertices)))
    coefficients[VALUE] = orders[0][osculation.vertices]
    coefficients[[A, B, AA, AB, BB]] = osculation.derivatives(orders[0])
    if len(orders) > 1:
        coefficients[T] = orders[1][osculation.vertices]
        coefficients[[TA, TB]] = osculation.derivatives(orders[1])[:2]
    if len(orders) > 2:
        coefficients[TT] = orders[2][osculation.vertices]
    return Jet(coefficients)
