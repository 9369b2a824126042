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
    from scenetruth.truth.visibility_kernels import hide_points, look_at_points, sort_into_cells

    faces = geometry.world.faces
    vertices = np.ascontiguousarray(viewpoint.to_camera(geometry.snapshot.vertices_mm))
    place, pixels, seen = look_at_points(
        vertices, faces, points.face, points.weights, points.towards, camera.focal_px, *camera.principal_point
    )
    if camera.distortion is not None:
        ahead = place[:, 2] > 0
        pixels = camera.project(place)
        pixels[~ahead] = np.nan
    x, y = pixels.T
    seen &= (x >= -0.5) & (x <= camera.width - 0.5) & (y >= -0.5) & (y <= camera.height - 0.5)
    cells = sort_into_cells(place, seen, 1 / camera.focal_px)
    hidden = hide_points(vertices, faces, points.face[cells.order], cells)
    seen[cells.order] = ~hidden
    return seen, pixels
