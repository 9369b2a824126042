"""Tracking of surface points over time and cameras: visibility, displacement, occlusion and tracks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.errors import Problem, RecordingError
from scenetruth.provenance import build_schedule
from scenetruth.raycast import scene_topology
from scenetruth.scene import SceneLike, load_scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.scene_models import Scene
from scenetruth.schema import check_dataset
from scenetruth.truth.geometry_maps import Geometries, GeometryPass, TruthMaps

if TYPE_CHECKING:
    import xarray as xr

    from scenetruth.truth.visibility_kernels import Runs

__all__ = ["PixelPoints", "PointTracker", "SurfacePoints", "compile_visibility", "find_visible_points", "track_points"]


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points on mesh faces that move with the surface.

    ``face``: Face index in the scene, shape (n,).
    ``weights``: Barycentric coordinates of the second and third corner, shape (n, 2).
    ``towards``: Whether the point is on the front of its face, the side of the normal (p1 - p0) x (p2 - p0), shape
      (n,). The two sides of a thin sheet are different surfaces.
    """

    face: NDArray[np.int32]
    weights: NDArray[np.float64]
    towards: NDArray[np.bool_]

    @cached_property
    def runs(self) -> Runs:
        """Runs of points on the same face."""
        from scenetruth.truth.visibility_kernels import find_runs

        found: Runs = find_runs(self.face, self.weights)
        return found

    @classmethod
    def seen_from(
        cls,
        camera: Camera,
        viewpoint: Viewpoint,
        geometry: GeometryPass,
        face: NDArray[np.int32],
        weights: NDArray[np.float64],
    ) -> Self:
        """Return points on the face sides visible from a viewpoint."""
        from scenetruth.truth.layer_kernels import FRONT

        vertices = np.ascontiguousarray(viewpoint.to_camera(geometry.snapshot.vertices_mm))
        fronts = (geometry.layers(camera, viewpoint, vertices).sides & FRONT).astype(np.bool_)
        return cls(face, weights, fronts[face])

    def positions_mm(self, geometry: GeometryPass) -> NDArray[np.float64]:
        """Return the world positions of the points in mm, shape (n, 3)."""
        from scenetruth.truth.visibility_kernels import place_points

        return place_points(geometry.snapshot.vertices_mm, geometry.world.faces, self.face, self.weights)


def find_visible_points(
    points: SurfacePoints, geometry: GeometryPass, camera: Camera, viewpoint: Viewpoint, *, with_pixels: bool = True
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Compute the visibility of surface points in a camera and their image positions in px, NaN behind the camera.

    A point is visible if it lies in the image, if its side of the face is towards the camera, and if no other face lies
    in between. Where the image shows a single layer of surface, there is none; elsewhere every face near the viewing
    ray is tested in float64. Without ``with_pixels``, there may be no positions.
    """
    from scenetruth.truth.visibility_kernels import hide_points, look_at_points, sort_into_cells

    faces = geometry.world.faces
    vertices = np.ascontiguousarray(viewpoint.to_camera(geometry.snapshot.vertices_mm))
    layers = geometry.layers(camera, viewpoint, vertices)
    pinhole = (camera.focal_px, *camera.principal_point)
    distorted = camera.distortion is not None
    places, pixels, seen, unsure = look_at_points(
        vertices,
        faces,
        points.face,
        points.weights,
        points.towards,
        geometry.world.face_body,
        points.runs,
        layers,
        pinhole,
        (np.inf, np.inf) if distorted else (float(camera.width), float(camera.height)),
        with_pixels=with_pixels and not distorted,
        with_places=distorted,
    )
    if distorted:
        ahead = places[:, 2] > 0
        pixels = camera.project(places)
        pixels[~ahead] = np.nan
        x, y = pixels.T
        seen &= (x >= -0.5) & (x <= camera.width - 0.5) & (y >= -0.5) & (y <= camera.height - 0.5)
        unsure &= seen
    cells = sort_into_cells(np.flatnonzero(unsure), vertices, faces, points.face, points.weights, *pinhole)
    if len(cells.order):
        seen[cells.order[hide_points(vertices, faces, cells)]] = False
    return seen, pixels


TimedViewpoint = tuple[float, Viewpoint]
"""Time in frames and pose of an image."""


class PixelPoints:
    """Surface points visible at the pixels of one image, from its ground truth, geometry and viewpoint.

    ``seen``: Visibility in other images by camera and frame, kept for `PointTracker.shown` if ``reused``; else None.
    """

    def __init__(
        self,
        maps: Mapping[str, NDArray[Any]],
        geometry: GeometryPass,
        camera: Camera,
        viewpoint: Viewpoint,
        *,
        reused: bool = False,
    ) -> None:
        world = geometry.world
        body = maps["object_id"].ravel()
        self.pixels = np.flatnonzero(body >= 0)
        face = (world.face_offsets[body[self.pixels]] + maps["face_id"].ravel()[self.pixels]).astype(np.int32)
        weights = np.ascontiguousarray(maps["barycentric"].reshape(2, -1)[:, self.pixels].T)
        self.points = SurfacePoints.seen_from(camera, viewpoint, geometry, face, weights)
        self.geometry, self.viewpoint = geometry, viewpoint
        self.seen: dict[tuple[int, int], NDArray[np.bool_]] | None = {} if reused else None


class PointTracker:
    """Tracks the surface points of pixels to other images; ``places`` holds time and pose by [camera][frame]."""

    def __init__(
        self,
        geometries: Geometries,
        camera: Camera,
        places: Sequence[Sequence[TimedViewpoint]],
        maps: TruthMaps = "complete",
    ) -> None:
        self._geometries, self._camera, self._places = geometries, camera, places
        self._complete = maps != "standard"
        self._size = (camera.height, camera.width)

    def shown(self, points: PixelPoints, index: int, frame: int) -> NDArray[np.bool_]:
        """Return whether the surface point of each pixel is visible in an image."""
        seen = None if points.seen is None else points.seen.pop((index, frame), None)
        return self._map(points, self._seen(points, index, frame) if seen is None else seen)

    def maps(self, own: PixelPoints, index: int, frame: int) -> dict[str, NDArray[Any]]:
        """Return the visibility and displacement maps of one image, see `scenetruth.schema.VARIABLES`.

        Beyond the first and last frame the camera pose is constant.
        """
        count = np.ones(len(own.pixels), dtype=np.int16)
        for other in range(len(self._places)):
            if other != index:
                seen = self._seen(own, other, frame)
                count += seen
                if own.seen is not None:
                    own.seen[other, frame] = seen
        hidden = np.zeros(len(own.pixels), dtype=np.bool_)
        moved: dict[str, NDArray[np.float64]] = {}
        for step, way in ((1, "next"), (-1, "previous")):
            recorded = 0 <= frame + step < len(self._places[index])
            if not recorded and not self._complete:
                continue
            time, viewpoint = self._places[index][frame + step if recorded else frame]
            geometry = self._geometries.at(time if recorded else time + step)
            shown, pixels = find_visible_points(
                own.points, geometry, self._camera, viewpoint, with_pixels=self._complete
            )
            if recorded:
                hidden |= ~shown
                if own.seen is not None:
                    own.seen[index, frame + step] = shown
            if self._complete:
                moved |= self._moved(own, geometry, pixels, way)
        found: dict[str, NDArray[Any]] = {
            "view_count": self._map(own, count),
            "occluded_across_cameras": self._map(own, count < len(self._places)),
            "occluded_in_time": self._map(own, hidden),
        }
        return found | moved

    def _seen(self, points: PixelPoints, index: int, frame: int) -> NDArray[np.bool_]:
        time, viewpoint = self._places[index][frame]
        geometry = self._geometries.at(time)
        return find_visible_points(points.points, geometry, self._camera, viewpoint, with_pixels=False)[0]

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
        """Return a map with values at pixels with a surface, and 0 or False elsewhere."""
        found = np.zeros(self._size, dtype=values.dtype)
        found.ravel()[points.pixels] = values
        return found


def compile_visibility(scene: Scene) -> None:
    """Compile the visibility kernels by a call with few points."""
    world = build_scene(scene)
    geometry = GeometryPass(world, scene_topology(world), 0.0)
    viewpoint = build_schedule(scene).moment(0, 0).viewpoint
    first = np.zeros((2, 2), dtype=np.int64)
    maps = {"object_id": first, "face_id": first, "barycentric": np.full((2, 2, 2), 0.25)}
    find_visible_points(PixelPoints(maps, geometry, scene.camera, viewpoint).points, geometry, scene.camera, viewpoint)


def track_points(scene: SceneLike, truth: xr.Dataset, times: Iterable[float], *, t: int = 0) -> NDArray[np.float64]:
    """Track the surface points visible at one frame to other times.

    The maps ``object_id``, ``face_id`` and ``barycentric`` of a ground truth identify the surface point of every pixel,
    which is constant as the surface moves.

    Parameters
    ----------
    scene
        The scene of the ground truth: a scene, its values, its file, or the name of a bundled scene.
    truth
        Ground truth of the reference camera (or of one camera selected from all).
    times
        Times in frames, any real numbers.
    t
        Frame whose pixels are tracked.

    Returns
    -------
    numpy.ndarray
        World positions (X, Y, Z) in mm, shape (times, 3, y, x); NaN at pixels without a surface.

    Raises
    ------
    SceneError
        If the scene is invalid.
    RecordingError
        If the ground truth is invalid or lacks required maps, or if times or frame are invalid.

    See Also
    --------
    make_truth : Compute the ground truth.

    Examples
    --------
    >>> import scenetruth as st
    >>> item = {"mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}, "name": "wall"}
    >>> item |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> item |= {"motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, 2]}]}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [item]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 3}, "render": {"backend": "raycast"}}
    >>> scene = st.Scene.from_dict(plain)
    >>> _, truth = st.simulate(scene)
    >>> track_points(scene, truth, [0, 1.5])[:, 2, 15, 20].round(9).tolist()
    [100.0, 103.0]
    """
    scene = load_scene(scene)
    check_dataset(truth, "truth")
    problems = [
        Problem(name, "is missing; required for tracking")
        for name in ("object_id", "face_id", "barycentric")
        if name not in truth
    ]
    if isinstance(t, bool) or not isinstance(t, int | np.integer) or t not in truth["t"].values:
        problems.append(Problem("t", f"must be one of the frames of the truth, {truth['t'].values.tolist()}", t))
    try:
        moments = np.array([float(time) for time in times])
    except (TypeError, ValueError, OverflowError):
        moments = np.full(1, np.nan)
    if not np.isfinite(moments).all():
        problems.append(Problem("times", "must be finite numbers", times))
    if problems:
        raise RecordingError(problems, source="truth")
    world = build_scene(scene)
    image = truth.sel(t=t)
    body = image["object_id"].values
    if body.ndim != 2:
        image = image.sel(s=0)
        body = image["object_id"].values
    here = body >= 0
    face = world.faces[world.face_offsets[body[here]] + image["face_id"].values[here]]
    b1, b2 = (image["barycentric"].values[k][here][:, None] for k in range(2))
    tracks = np.full((len(moments), 3, *body.shape), np.nan)
    for track, time in zip(tracks, moments, strict=True):
        vertices = world.at(float(time)).vertices_mm
        first, second, third = (vertices[face[:, k]] for k in range(3))
        track[:, here] = (first + b1 * (second - first) + b2 * (third - first)).T
    return tracks
