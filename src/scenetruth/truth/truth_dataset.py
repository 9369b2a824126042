"""Ground truth of a recording as a data set, with warnings for objects without interior pixels."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import ImageAcquisition, Schedule, Stage
from scenetruth.compilation import thread_count
from scenetruth.errors import ArgumentError, Problem
from scenetruth.memory import release_memory, retained_memory
from scenetruth.plain_data import argument_problems
from scenetruth.progress import Progress
from scenetruth.provenance import build_schedule, intrinsics_from
from scenetruth.raycast import Topology, image_hits, scene_topology
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.mesh.mesh_file import FileMesh
from scenetruth.scene.scene_models import Scene
from scenetruth.schema import COMPONENTS, VARIABLES, DatasetOutline, IncrementalDataset, Put, blank_map, make_outline
from scenetruth.threads import in_order, with_one_blas_thread
from scenetruth.truth.geometry_maps import Geometries, LightProvider, TruthMaps, truth_by_rows, truth_maps
from scenetruth.truth.point_tracking import PixelPoints, PointTracker

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "TruthOptions",
    "TruthPoses",
    "TruthTasks",
    "TruthViews",
    "announce_truth",
    "count_tasks_at_once",
    "fill_truth",
    "interior_warnings",
    "memory_for",
    "outline_truth",
    "refuse_arguments",
    "truth_from_world",
]


STANDARD = (
    "depth",
    "velocity",
    "disparity",
    "flow",
    "normal",
    "object_id",
    "face_id",
    "barycentric",
    "growth_rate",
    "mixed",
    "boundary_distance",
)
"""Single-image maps of standard ground truth."""

FURTHER = (
    "acceleration",
    "slope",
    "curvature",
    "rotation_rate",
    "principal_growth_rates",
    "principal_growth_direction",
    "uv",
    "material_coordinates_mm",
)
"""Additional single-image maps of complete ground truth."""

LIGHT = (
    "surface_radiance",
    "diffuse_share",
    "specular_share",
    "transmitted_share",
    "ambient_share",
    "lit_fraction",
    "shadow_distance",
)
"""Maps of light."""

FOLLOWED = ("view_count", "occluded_across_cameras", "occluded_in_time")
"""Maps of standard ground truth that depend on other images."""

MOVED = ("displacement_next", "displacement_previous", "flow_next", "flow_previous")
"""Maps of complete ground truth that depend on the neighbouring frames."""

DTYPES: dict[str, type[np.generic[Any]]] = {
    "object_id": np.int32,
    "face_id": np.int32,
    "mixed": np.bool_,
    "view_count": np.int16,
    "occluded_across_cameras": np.bool_,
    "occluded_in_time": np.bool_,
}
"""Data types of the maps that are not float64."""


_MANY_EDGES = 0.25  # threshold on the fraction of mixed pixels, above that of a smooth body of more than a few pixels


def interior_warnings(
    world: BuiltScene, object_id: NDArray[np.integer[Any]], boundary_distance: NDArray[np.float64], margin_px: float
) -> list[str]:
    """Return a warning about visible objects without interior pixels, from the maps of one image, if any."""
    without, faceted = [], []
    for index, body in enumerate(world.bodies):
        distances = boundary_distance[object_id == index]
        if not distances.size or distances.max() >= margin_px:
            continue
        without.append(body.name)
        if isinstance(body.mesh.source, FileMesh) and np.mean(distances == 0) > _MANY_EDGES:
            faceted.append(body.name)
    if not without:
        return []
    message = (
        f"objects: {_listed(without)} without interior pixels: at the reference frame all their pixels are less than "
        f"{margin_px:g} px from a mixed pixel, so scores of the interior exclude them; use a shorter camera distance, "
        "a longer focal length or a smaller score.interior_margin_px"
    )
    if faceted:
        message += f"; many pixels of {_listed(faceted)} are mixed: use a larger crease_deg if the surface is smooth"
    return [message]


def _listed(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


TruthViews = Literal["reference", "all"]
TruthPoses = Literal["actual", "nominal"]

PlacedMap = tuple[str, dict[str, int], NDArray[Any]]
"""Variable, index along the leading dimensions, and values, see `scenetruth.schema.Put`."""

_CACHED_TIMES, _CACHED_SCAN_TIMES = 4, 8  # the current frame and its neighbours; for scans, times per camera


def refuse_arguments(scene: Any, truth_views: Any, truth_poses: Any, truth_content: Any, progress: Any) -> None:
    """Raise an ArgumentError for invalid arguments of `make_truth` and related functions."""
    problems = argument_problems(
        progress,
        truth_views=(truth_views, TruthViews),
        truth_poses=(truth_poses, TruthPoses),
        truth_content=(truth_content, TruthMaps),
    )
    if not isinstance(scene, Scene | Mapping | str | PathLike):
        message = "must be a scene, its values, its file, or the name of a bundled scene"
        problems.insert(0, Problem("scene", message, type(scene).__name__))
    if problems:
        raise ArgumentError(problems)


def truth_from_world(
    scene: Scene,
    world: BuiltScene,
    choice: TruthOptions,
    provenance: dict[str, Any],
    progress: Progress | None = None,
    light: LightProvider | None = None,
) -> xr.Dataset:
    """Compute the ground truth of a built and validated scene, see `make_truth`.

    ``light``: Light of the scene, for maps of light.
    """
    filling = IncrementalDataset(outline_truth(scene, choice, provenance).dataset())
    fill_truth(scene, world, choice, filling.put, progress, light)
    return filling.dataset()


@dataclass(frozen=True)
class TruthOptions:
    """Options of the ground truth, see `make_truth`."""

    views: TruthViews = "reference"
    poses: TruthPoses = "actual"
    content: TruthMaps = "standard"


def outline_truth(scene: Scene, choice: TruthOptions, provenance: dict[str, Any]) -> DatasetOutline:
    """Return the outline of the ground truth of a scene: blank maps, but complete poses, times and attributes."""
    stage, frames, camera = scene.stage, scene.frames, scene.camera
    images = (*((stage.rows,) if stage.rows > 1 else ()), stage.positions, frames.count)
    size, all_views = (camera.height, camera.width), choice.views == "all"
    names = list(STANDARD + FOLLOWED)
    if choice.content != "standard":
        names += [*FURTHER, *(MOVED if scene.shutter.readout_time_s == 0 else ())]
    if choice.content == "complete_with_light":
        names += LIGHT
    arrays: dict[str, NDArray[Any]] = {"visible": blank_map(np.bool_, (*images, *size))}
    for name in names:
        entry = VARIABLES["truth"][name]
        lead = [len(COMPONENTS[dim]) for dim in entry.dims if dim in COMPONENTS]
        lead = [len(camera.bands), *lead] if entry.by_band and camera.bands else lead
        shape = (*lead, *(images if all_views else images[-1:]), *size)
        arrays[name] = blank_map(DTYPES.get(name, np.float64), shape)
    arrays |= _poses(scene, build_schedule(scene))
    objects = json.dumps([item.name for _, item in scene.parts])
    return make_outline(
        "truth",
        {name: arrays[name] for name in VARIABLES["truth"] if name in arrays},
        intrinsics_from(scene),
        t=frames.t,
        s=stage.s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if stage.rows > 1 else None,
        channel=camera.bands or None,
        attrs={**provenance, "object_names": objects, "truth_poses": choice.poses},
    )


def announce_truth(scene: Scene, world: BuiltScene, choice: TruthOptions) -> None:
    """Announce what the ground truth of a scene will need: rates of deformation, and the hits of images."""
    if scene.shutter.readout_time_s > 0:
        return
    schedule, stage = build_schedule(scene), scene.stage
    moment_of = schedule.moment if choice.poses == "actual" else schedule.nominal
    cameras = [
        (s_y, s) for s_y in stage.s_y.tolist() for s in stage.s.tolist() if choice.views == "all" or s == s_y == 0
    ]
    moments = [moment_of(s, t, s_y) for s_y, s in cameras for t in scene.frames.t.tolist()]
    if choice.content == "standard":
        world.expect_rates(moment.t for moment in moments)
    image_hits(world).expect(scene.camera, ((moment.t, moment.viewpoint) for moment in moments))


class TruthTasks:
    """Ground truth of a scene, in tasks that several threads may perform at the same time.

    ``warnings``: Those about the reference image, once the first task is done.
    """

    def __init__(
        self, scene: Scene, world: BuiltScene, choice: TruthOptions, light: LightProvider | None = None
    ) -> None:
        self._scene, self._world, self._choice, self._light = scene, world, choice, light
        stage, frames, schedule = scene.stage, scene.frames, build_schedule(scene)
        moment_of = schedule.moment if choice.poses == "actual" else schedule.nominal
        self._cameras = [(s_y, s) for s_y in stage.s_y.tolist() for s in stage.s.tolist()]
        self._moments = [[moment_of(s, t, s_y) for t in frames.t.tolist()] for s_y, s in self._cameras]
        places = [[(moment.t, moment.viewpoint) for moment in row] for row in self._moments]
        self._topology = scene_topology(world)
        together = len({time for time, _ in (row[0] for row in places)}) == 1
        kept = _CACHED_TIMES if together else _CACHED_SCAN_TIMES
        self._geometries = Geometries(world, self._topology, kept, light)
        self._rolling = scene.shutter.readout_time_s > 0
        # With a rolling shutter, the next row and therefore the next time of a point do not follow from its
        # displacement.
        content = "standard" if self._rolling else choice.content
        self._follower = PointTracker(self._geometries, scene.camera, places, content)
        self._reference: Future[PixelPoints] = Future()
        self.warnings: list[str] = []
        centre = self._cameras.index((0, 0))
        others = (k for k in range(len(self._cameras)) if k != centre)
        self._views = [centre] if choice.views == "reference" else [centre, *others]

    @property
    def tasks(self) -> list[Callable[[], list[PlacedMap]]]:
        """Functions that compute the maps of one image, or the visibility of the reference points in those of a frame.

        The first must begin no later than the others, which may wait for the reference image. They are not retained
        here, because objects that refer to each other are freed late.
        """
        frames, found = self._scene.frames, list[Callable[[], list[PlacedMap]]]()
        # The reference image comes first, because the visibility of its points in all other images is evaluated.
        first = frames.t.tolist().index(0)
        for frame in [first, *(n for n in range(frames.count) if n != first)]:
            found += [partial(self._image, index, frame) for index in self._views]
            found.append(partial(self._visible, frame))
        return found

    @property
    def steps(self) -> int:
        """Number of images and visibility maps."""
        return (len(self._views) + len(self._cameras)) * self._scene.frames.count

    def _image(self, index: int, frame: int) -> list[PlacedMap]:
        """Return the maps of one image."""
        try:
            found = self._maps(index, frame)
        except BaseException as error:
            # Tasks that wait for the reference image end as well.
            if not self._reference.done():
                self._reference.set_exception(error)
            raise
        at = {"t": frame} if self._choice.views == "reference" else _at(self._scene.stage, index, frame)
        return [(name, at, values) for name, values in found.items()]

    def _maps(self, index: int, frame: int) -> dict[str, NDArray[Any]]:
        scene, world, content = self._scene, self._world, self._choice.content
        moment = self._moments[index][frame]
        geometry = self._geometries.at(moment.t)
        if self._rolling:
            maps = _truth_by_rows(scene, world, self._topology, moment, content, self._light)
        else:
            maps = truth_maps(geometry, scene.camera, moment.viewpoint, scene.stage.baseline_mm, content)
        reference = (self._views[0], scene.frames.t[frame]) == (index, 0)
        own = PixelPoints(maps, geometry, scene.camera, moment.viewpoint, reused=reference)
        if reference:
            found = (maps["object_id"], maps["boundary_distance"], scene.score.interior_margin_px)
            self.warnings = interior_warnings(world, *found)
            self._reference.set_result(own)
        return maps | self._follower.maps(own, index, frame)

    def _visible(self, frame: int) -> list[PlacedMap]:
        """Return the visibility of the points of the reference image in all images of a frame."""
        reference, stage = self._reference.result(), self._scene.stage
        return [
            ("visible", _at(stage, index, frame), self._follower.shown(reference, index, frame))
            for index in range(len(self._cameras))
        ]

    def put(self, results: Iterable[list[PlacedMap]], put: Put, progress: Progress | None = None) -> None:
        """Store the results of all tasks, in their order."""
        done = 0
        for maps in results:
            # All maps of an image are one step, each visibility map is another.
            alone = [name == "visible" for name, _, _ in maps]
            for number, item in enumerate(maps):
                if progress is not None and (number == 0 or alone[number]):
                    progress("truth", done, self.steps)
                    done += 1
                put(*item)
            # Maps are freed before the next are computed, to limit memory.
            size = sum(values.nbytes for _, _, values in maps)
            maps.clear()
            del item
            if size > _RELEASED_BYTES:
                release_memory()
        if progress is not None:
            progress("truth", done, self.steps)


@with_one_blas_thread
def fill_truth(
    scene: Scene,
    world: BuiltScene,
    choice: TruthOptions,
    put: Put,
    progress: Progress | None = None,
    light: LightProvider | None = None,
) -> list[str]:
    """Compute the maps of a ground truth, image by image."""
    work = TruthTasks(scene, world, choice, light)
    size = (scene.camera.width * scene.camera.height, len(world.faces))
    at_once = count_tasks_at_once(*size)
    # Maps of large images are stored before the next are computed, to limit memory.
    with (
        retained_memory(),
        closing(in_order(lambda task: task(), work.tasks if at_once > 1 else [], at_once)) as results,
    ):
        work.put(results if at_once > 1 else (task() for task in work.tasks), put, progress)
    return work.warnings


_RELEASED_BYTES = 1 << 26  # size of maps whose memory is returned, because they are kept among arrays of later images
_MOST_AT_ONCE = 1 << 20  # pixels and faces of tasks at a time, which limits their memory


def count_tasks_at_once(pixels: int, faces: int) -> int:
    """Return how many images with a number of pixels and faces are computed at the same time."""
    return int(np.clip(_MOST_AT_ONCE // (pixels + faces), 1, thread_count()))


def memory_for(pixels: int, faces: int) -> AbstractContextManager[None]:
    """Retain freed memory while images are computed, unless they are large, whose memory has gaps."""
    return retained_memory() if pixels + faces <= _MOST_AT_ONCE else nullcontext()


def _at(stage: Stage, index: int, frame: int) -> dict[str, int]:
    """Return the index of an image along the leading dimensions of per-camera variables."""
    row, position = divmod(index, stage.positions)
    return {**({"s_y": row} if stage.rows > 1 else {}), "s": position, "t": frame}


def _truth_by_rows(
    scene: Scene,
    world: BuiltScene,
    topology: Topology,
    moment: ImageAcquisition,
    content: TruthMaps,
    light: LightProvider | None,
) -> dict[str, NDArray[Any]]:
    """Return the ground truth of a rolling-shutter image, each row at its own mid-exposure."""
    camera, shutter = scene.camera, scene.shutter
    later_s = shutter.row_offsets_s(np.arange(camera.height, dtype=np.float64), camera.height)
    travel_mm = shutter.stage_speed_mm_per_s * later_s
    places = [moment.viewpoint.moved((along, 0.0, 0.0)) for along in travel_mm.tolist()]
    times = moment.t + later_s / scene.frames.frame_interval_s
    return truth_by_rows(world, topology, camera, times, places, scene.stage.baseline_mm, content, light)


def _poses(scene: Scene, schedule: Schedule) -> dict[str, NDArray[np.float64]]:
    """Return the actual poses and times of all images."""
    stage, frames = scene.stage, scene.frames
    shape = (stage.rows, stage.positions, frames.count)
    position, rotation, time = np.empty((*shape, 3)), np.empty((*shape, 3)), np.empty(shape)
    for index in np.ndindex(shape):
        s_y, s, t = (int(axis[k]) for axis, k in zip((stage.s_y, stage.s, frames.t), index, strict=True))
        moment = schedule.moment(s, t, s_y)
        position[index], rotation[index] = moment.viewpoint.position_mm, moment.rotation_rad
        time[index] = moment.t * frames.frame_interval_s
    poses = {"camera_position_mm": position, "camera_rotation_rad": rotation, "image_time_s": time}
    return poses if stage.rows > 1 else {name: values[0] for name, values in poses.items()}
