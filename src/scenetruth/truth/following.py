"""Surface points that pixels see, followed to other cameras and frames: displacements and occlusions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene.world import World
from scenetruth.truth.maps import GeometryPass, TruthMaps
from scenetruth.truth.visibility import SurfacePoints, points_seen

__all__ = ["PixelPoints", "follow_points"]

Place = tuple[float, Viewpoint]
"""Time in frames and pose of an image."""


class PixelPoints:
    """The surface points that the pixels of one image see.

    Parameters
    ----------
    world
        The scene's objects.
    maps
        The truth of the image (`truth_maps`).
    geometry
        The world at the time of the image.
    viewpoint
        Pose of its camera.
    """

    def __init__(
        self, world: World, maps: dict[str, NDArray[Any]], geometry: GeometryPass, viewpoint: Viewpoint
    ) -> None:
        body = maps["object_id"].ravel()
        self.pixels = np.flatnonzero(body >= 0)
        face = (world.face_offsets[body[self.pixels]] + maps["face_id"].ravel()[self.pixels]).astype(np.int32)
        weights = np.ascontiguousarray(maps["barycentric"].reshape(2, -1)[:, self.pixels].T)
        self.points = SurfacePoints.seen_from(viewpoint, geometry, face, weights)
        self.geometry, self.viewpoint = geometry, viewpoint


def follow_points(
    world: World,
    topology: Topology,
    camera: Camera,
    places: Sequence[Sequence[Place]],
    views: Sequence[int],
    seen: Sequence[Sequence[PixelPoints]],
    reference: tuple[int, int],
    maps: TruthMaps = "complete",
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, NDArray[Any]]:
    """Follow the points of all pixels to the other cameras, and to the frames before and after.

    Parameters
    ----------
    world, topology
        The scene's objects, and their faces and edges.
    camera
        The camera.
    places
        Time and pose of every image, [camera][frame].
    views
        The cameras whose truth is wanted.
    seen
        What their pixels see, [view][frame].
    reference
        The reference image: (index into ``views``, frame).
    maps
        Whether displacements and finite flow are wanted (``"complete"``).
    progress
        Called with (done, total) images.

    Returns
    -------
    dict
        - ``visible`` (camera, frame, y, x): which images show the points of the reference image,
        - ``view_count`` and ``occluded_in_s`` (view, frame, y, x): how many cameras see the pixel's point at its frame,
          and whether some do not,
        - ``occluded_in_t`` (view, frame, y, x): whether its own camera does not see it at the recorded frame before or
          after,
        - ``displacement_next``, ``displacement_previous`` (component, view, frame, y, x) in mm, in the frame of the
          camera, one frame later and earlier,
        - ``flow_next``, ``flow_previous`` (image component, view, frame, y, x) in px: where the point is in the image
          that the same camera takes one frame later or earlier, minus the pixel. Beyond the first and the last frame
          the camera stays where it is.
    """
    frames, size = len(places[0]), (camera.height, camera.width)
    lead = (len(views), frames)
    grid = camera.pixel_grid().reshape(-1, 2)
    visible = np.zeros((len(places), frames, *size), dtype=np.bool_)
    count = np.zeros((*lead, *size), dtype=np.int16)
    hidden_in_t = np.zeros((*lead, *size), dtype=np.bool_)
    moved: dict[str, NDArray[np.float64]] = {}
    if maps == "complete":
        for way in ("next", "previous"):
            moved[f"displacement_{way}"] = np.full((3, *lead, *size), np.nan)
            moved[f"flow_{way}"] = np.full((2, *lead, *size), np.nan)

    def meet(view: int, frame: int, geometry: GeometryPass, viewpoint: Viewpoint, way: str) -> NDArray[np.bool_]:
        """Find the points of a frame in the neighbouring frame, and tell which are visible there."""
        own = seen[view][frame]
        shown, pixels = points_seen(own.points, geometry, camera, viewpoint)
        if maps == "complete":
            step = own.points.positions_mm(geometry) - own.points.positions_mm(own.geometry)
            turned = own.viewpoint.directions_to_camera(step)
            moved[f"displacement_{way}"].reshape(3, *lead, -1)[:, view, frame, own.pixels] = turned.T
            flow = pixels - grid[own.pixels]
            moved[f"flow_{way}"].reshape(2, *lead, -1)[:, view, frame, own.pixels] = flow.T
        return shown

    geometry: GeometryPass | None = None
    start = seen[reference[0]][reference[1]]
    for frame in range(frames):
        for index, row in enumerate(places):
            if progress is not None:
                progress(frame * len(places) + index, frames * len(places))
            time, viewpoint = row[frame]
            if geometry is None or geometry.snapshot.t != time:
                geometry = GeometryPass(world, topology, time)
            shown, _ = points_seen(start.points, geometry, camera, viewpoint)
            visible[index, frame].ravel()[start.pixels] = shown
            of_start = shown
            for view, own_index in enumerate(views):
                own = seen[view][frame]
                shown = np.ones(len(own.pixels), dtype=np.bool_)
                if own is start and own_index != index:
                    shown = of_start
                elif own_index != index:
                    shown, _ = points_seen(own.points, geometry, camera, viewpoint)
                count[view, frame].ravel()[own.pixels] += shown
                if own_index != index:
                    continue
                for other, way in ((frame - 1, "next"), (frame + 1, "previous")):
                    if 0 <= other < frames:
                        shown = meet(view, other, geometry, viewpoint, way)
                        hidden_in_t[view, other].ravel()[seen[view][other].pixels[~shown]] = True
    if maps == "complete":
        for view, own_index in enumerate(views):
            for frame, step, way in ((0, -1, "previous"), (frames - 1, 1, "next")):
                time, viewpoint = places[own_index][frame]
                meet(view, frame, GeometryPass(world, topology, time + step), viewpoint, way)
    surface = np.zeros((*lead, *size), dtype=np.bool_)
    for view in range(len(views)):
        for frame in range(frames):
            surface[view, frame].ravel()[seen[view][frame].pixels] = True
    found: dict[str, NDArray[Any]] = {
        "visible": visible,
        "view_count": count,
        "occluded_in_s": surface & (count < len(places)),
        "occluded_in_t": hidden_in_t,
    }
    return found | moved
