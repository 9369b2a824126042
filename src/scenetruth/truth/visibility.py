"""Which surface points a camera sees, and at which pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.truth.maps import GeometryPass

__all__ = ["SurfacePoints", "points_seen"]


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points on the faces of the world, which move with the surface.

    Parameters
    ----------
    face
        Index in the world's list of faces, shape (n,).
    weights
        Barycentric coordinates of the face's second and third corner, shape (n, 2).
    towards
        Whether the point is on the front of its face, to which the normal (p1 - p0) x (p2 - p0) points, shape (n,). The
        two sides of a thin sheet are different surfaces.
    """

    face: NDArray[np.int32]
    weights: NDArray[np.float64]
    towards: NDArray[np.bool_]

    @classmethod
    def seen_from(
        cls, viewpoint: Viewpoint, geometry: GeometryPass, face: NDArray[np.int32], weights: NDArray[np.float64]
    ) -> Self:
        """Return points on the sides of their faces that a camera sees.

        Parameters
        ----------
        viewpoint
            Pose of the camera.
        geometry
            The world at the time of the image.
        face, weights
            The points, as of the class.
        """
        from scenetruth.truth.visibility_kernels import place_points

        vertices = np.ascontiguousarray(viewpoint.to_camera(geometry.snapshot.vertices_mm))
        _, towards = place_points(vertices, geometry.world.faces, face, weights)
        return cls(face, weights, towards)

    def positions_mm(self, geometry: GeometryPass) -> NDArray[np.float64]:
        """Return the positions of the points in the world.

        Parameters
        ----------
        geometry
            The world at the time that is asked for.

        Returns
        -------
        numpy.ndarray
            Positions in mm, shape (n, 3).
        """
        from scenetruth.truth.visibility_kernels import place_points

        points, _ = place_points(geometry.snapshot.vertices_mm, geometry.world.faces, self.face, self.weights)
        return np.asarray(points)


def points_seen(
    points: SurfacePoints, geometry: GeometryPass, camera: Camera, viewpoint: Viewpoint
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Tell which surface points a camera sees, and compute their positions in the image.

    A point is seen if it lies in the image, if its side of the face is turned towards the camera, and if no other face
    lies between (every face near the line of sight is tested in float64).

    Parameters
    ----------
    points
        The points.
    geometry
        The world at the time of the image.
    camera, viewpoint
        The camera, and its pose.

    Returns
    -------
    tuple
        Whether each point is seen, bool, shape (n,); and positions in the image in px, shape (n, 2), NaN behind the
        camera.
    """
    from scenetruth.truth.visibility_kernels import hide_points, place_points, sort_into_cells

    faces = geometry.world.faces
    vertices = np.ascontiguousarray(viewpoint.to_camera(geometry.snapshot.vertices_mm))
    place, towards = place_points(vertices, faces, points.face, points.weights)
    pixels = camera.project(place)
    ahead = place[:, 2] > 0
    if not ahead.all():
        pixels[~ahead] = np.nan
    x, y = pixels.T
    seen = ahead & (towards == points.towards)
    seen &= (x >= -0.5) & (x <= camera.width - 0.5) & (y >= -0.5) & (y <= camera.height - 0.5)
    chosen = np.flatnonzero(seen)
    if not len(chosen):
        return seen, pixels
    rest = np.ascontiguousarray(place[chosen])
    u, v = rest[:, 0] / rest[:, 2], rest[:, 1] / rest[:, 2]
    low = np.array([u.min(), v.min()])
    # About one point to a cell, and never many more cells than points.
    extent = (float(np.ptp(u)), float(np.ptp(v)))
    cell = max(1 / camera.focal_px, float(np.sqrt(extent[0] * extent[1] / len(rest) / 4)), max(extent) / 1e5, 1e-12)
    columns, rows = (int(length / cell) + 1 for length in extent)
    order, starts = sort_into_cells(u, v, low, cell, columns, rows)
    hidden = hide_points(vertices, faces, rest, points.face[chosen], starts, order, low, cell, columns, rows)
    seen[chosen] = ~hidden
    return seen, pixels
