"""Surface points that pixels see, followed to other cameras and frames: displacements and occlusions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.provenance import schedule_of
from scenetruth.raycast import Topology
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import build_world
from scenetruth.truth.maps import Geometries, GeometryPass, TruthMaps
from scenetruth.truth.visibility import SurfacePoints, points_seen

__all__ = ["Follower", "PixelPoints", "compile_visibility"]

Place = tuple[float, Viewpoint]
"""Time in frames and pose of an image."""


class PixelPoints:
    """The surface points that the pixels of one image see.

    Parameters
    ----------
    maps
        The truth of the image (`truth_maps`).
    geometry
        The world at the time of the image.
    viewpoint
        Pose of its camera.
    """

    def __init__(self, maps: Mapping[str, NDArray[Any]], geometry: GeometryPass, viewpoint: Viewpoint) -> None:
        world = geometry.world
        body = maps["object_id"].ravel()
        self.pixels = np.flatnonzero(body >= 0)
        face = (world.face_offsets[body[self.pixels]] + maps["face_id"].ravel()[self.pixels]).astype(np.int32)
        weights = np.ascontiguousarray(maps["barycentric"].reshape(2, -1)[:, self.pixels].T)
        self.points = SurfacePoints.seen_from(viewpoint, geometry, face, weights)
        self.geometry, self.viewpoint = geometry, viewpoint


class Follower:
    """Follows the points of pixels to the other cameras, and to the frames before and after.

    Parameters
    ----------
    geometries
        The world at any time.
    camera
        The camera.
    places
        Time and pose of every image, [camera][frame].
    maps
        Whether displacements and finite flow are wanted (``"complete"``).
    """

    def __init__(
        self,
        geometries: Geometries,
        camera: Camera,
        places: Sequence[Sequence[Place]],
        maps: TruthMaps = "complete",
    ) -> None:
        self._geometries, self._camera, self._places = geometries, camera, places
        self._complete = maps == "complete"
        self._size = (camera.height, camera.width)

    def shown(self, points: PixelPoints, index: int, frame: int) -> NDArray[np.bool_]:
        """Tell which pixels' points an image shows.

        Parameters
        ----------
        points
            What the pixels of some image see.
        index, frame
            The image: camera and frame.

        Returns
        -------
        numpy.ndarray
            Shape (y, x); False where a pixel sees nothing.
        """
        return self._map(points, self._seen(points, index, frame))

    def maps(self, own: PixelPoints, index: int, frame: int) -> dict[str, NDArray[Any]]:
        """Return the maps of one image that tell where else its points are.

        Parameters
        ----------
        own
            What its pixels see.
        index, frame
            Its camera and its frame.

        Returns
        -------
        dict
            - ``view_count`` and ``occluded_in_s`` (y, x): how many cameras see the pixel's point at this frame, and
              whether some do not,
            - ``occluded_in_t`` (y, x): whether this camera does not see it at the recorded frame before or after,
            - ``displacement_next``, ``displacement_previous`` (component, y, x) in mm, in the frame of the camera, one
              frame later and earlier,
            - ``flow_next``, ``flow_previous`` (image component, y, x) in px: where the point is in the image that the
              same camera takes one frame later or earlier, minus the pixel. Beyond the first and the last frame the
              camera stays where it is.
        """
        count = np.ones(len(own.pixels), dtype=np.int16)
        for other in range(len(self._places)):
            if other != index:
                count += self._seen(own, other, frame)
        hidden = np.zeros(len(own.pixels), dtype=np.bool_)
        moved: dict[str, NDArray[np.float64]] = {}
        for step, way in ((1, "next"), (-1, "previous")):
            recorded = 0 <= frame + step < len(self._places[index])
            if not recorded and not self._complete:
                continue
            time, viewpoint = self._places[index][frame + step if recorded else frame]
            geometry = self._geometries.at(time if recorded else time + step)
            shown, pixels = points_seen(own.points, geometry, self._camera, viewpoint)
            if recorded:
                hidden |= ~shown
            if self._complete:
                moved |= self._moved(own, geometry, pixels, way)
        found: dict[str, NDArray[Any]] = {
            "view_count": self._map(own, count),
            "occluded_in_s": self._map(own, count < len(self._places)),
            "occluded_in_t": self._map(own, hidden),
        }
        return found | moved

    def _seen(self, points: PixelPoints, index: int, frame: int) -> NDArray[np.bool_]:
        time, viewpoint = self._places[index][frame]
        return points_seen(points.points, self._geometries.at(time), self._camera, viewpoint)[0]

    def _moved(
        self, own: PixelPoints, geometry: GeometryPass, pixels: NDArray[np.float64], way: str
    ) -> dict[str, NDArray[np.float64]]:
        step = own.points.positions_mm(geometry) - own.points.positions_mm(own.geometry)
        displacement, flow = np.full((3, *self._size), np.nan), np.full((2, *self._size), np.nan)
        displacement.reshape(3, -1)[:, own.pixels] = own.viewpoint.directions_to_camera(step).T
        row, column = np.divmod(own.pixels, self._size[1])
        flow.reshape(2, -1)[:, own.pixels] = pixels.T - (column, row)
        return {f"displacement_{way}": displacement, f"flow_{way}": flow}

    def _map(self, points: PixelPoints, values: NDArray[Any]) -> NDArray[Any]:
        """Return a map with values at the pixels that see something, and 0 or False elsewhere."""
        found = np.zeros(self._size, dtype=values.dtype)
        found.ravel()[points.pixels] = values
        return found


def compile_visibility(scene: Scene) -> None:
    """Let numba compile the kernels that tell which points a camera sees, by asking for a few.

    Parameters
    ----------
    scene
        Any scene, best a small one.
    """
    world = build_world(scene)
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg), 0.0)
    viewpoint = schedule_of(scene).moment(0, 0).viewpoint
    first = np.zeros((2, 2), dtype=np.int64)
    maps = {"object_id": first, "face_id": first, "barycentric": np.full((2, 2, 2), 0.25)}
    points_seen(PixelPoints(maps, geometry, viewpoint).points, geometry, scene.camera, viewpoint)
