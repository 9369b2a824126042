"""The truth of a recording: the maps of all its images in one data set."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import Moment, Schedule, Stage
from scenetruth.errors import Problem, SceneError
from scenetruth.plain import argument_problems
from scenetruth.progress import Progress
from scenetruth.provenance import intrinsics_from, provenance_of, schedule_of
from scenetruth.raycast import Topology
from scenetruth.resources import Limits, refuse_beyond_bounds
from scenetruth.scene.check import check_scene
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World, build_world
from scenetruth.schema import COMPONENTS, VARIABLES, Filling, Put, blank_map, label
from scenetruth.truth.following import Follower, PixelPoints
from scenetruth.truth.interior import interior_warnings
from scenetruth.truth.maps import Geometries, TruthMaps, truth_maps
from scenetruth.truth.names import DTYPES, FOLLOWED, FURTHER, MOVED, STANDARD
from scenetruth.truth.rolling import truth_by_rows

__all__ = [
    "TruthChoice",
    "TruthPoses",
    "TruthViews",
    "blank_truth",
    "fill_truth",
    "make_truth",
    "refuse_arguments",
    "truth_of_world",
]

TruthViews = Literal["reference", "all"]
TruthPoses = Literal["real", "nominal"]

# Times at which the world is kept: of this frame and both neighbours; with scans, of every camera for itself.
_KEPT_TIMES, _KEPT_TIMES_OF_SCANS = 4, 8


def make_truth(
    scene: Scene,
    *,
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "real",
    truth_content: TruthMaps = "standard",
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the exact truth of a scene without rendering images.

    Parameters
    ----------
    scene
        The scene.
    truth_views
        ``"reference"``: truth of the reference camera (s = 0) at every frame; ``"all"``: of every camera.
    truth_poses
        ``"real"``: truth at the time and pose at which each image was taken, with the errors of the stage;
        ``"nominal"``: truth at the planned time and pose.
    truth_content
        ``"standard"``: the maps that estimates are scored against; ``"complete"``: all maps, at more than twice the
        size, with acceleration, displacement and finite flow to t ± 1, slopes, curvatures,
        rotation rate, principal growth, and coordinates on the surface.
    limits
        Bounds of what the scene may ask for (`scenetruth.Limits`); those by default if not given.
    progress
        Called with (what, done, total) as the work goes on.

    Returns
    -------
    xarray.Dataset
        Maps (t, y, x) or (s, t, y, x) in float64, at pixel centres; see ``docs/truth.md``. NaN where nothing is seen.

    Raises
    ------
    SceneError
        If the scene cannot be made or passes a bound, or nothing of it can be seen.

    See Also
    --------
    simulate : Images and truth together.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}}
    >>> truth = st.make_truth(st.scene_from_plain(plain))
    >>> float(truth.depth[0, 15, 20]), float(truth.disparity[0, 15, 20])
    (100.0, 3.0)
    """
    refuse_arguments(scene, truth_views, truth_poses, truth_content, progress)
    refuse_beyond_bounds(scene, limits)
    world = build_world(scene)
    check_scene(scene, world)
    choice = TruthChoice(truth_views, truth_poses, truth_content)
    return truth_of_world(scene, world, choice, provenance_of(scene), progress)


def refuse_arguments(scene: Any, truth_views: Any, truth_poses: Any, truth_content: Any, progress: Any) -> None:
    """Refuse arguments of `make_truth` and its like whose types nobody checks at a call.

    Raises
    ------
    SceneError
        With all that are wrong.
    """
    problems = argument_problems(
        progress,
        truth_views=(truth_views, TruthViews),
        truth_poses=(truth_poses, TruthPoses),
        truth_content=(truth_content, TruthMaps),
    )
    if not isinstance(scene, Scene):
        message = "must be a Scene; load_scene and scene_from_plain make one"
        problems.insert(0, Problem("scene", message, type(scene).__name__))
    if problems:
        raise SceneError(problems)


def truth_of_world(
    scene: Scene, world: World, choice: TruthChoice, provenance: dict[str, Any], progress: Progress | None = None
) -> xr.Dataset:
    """Compute the truth of a world that has been built and checked; see `make_truth`.

    Parameters
    ----------
    scene, world
        The scene, and its objects.
    choice, progress
        As of `make_truth`.
    provenance
        Attributes that say from which scene and program the truth is.

    Returns
    -------
    xarray.Dataset
        As of `make_truth`.
    """
    filling = Filling(blank_truth(scene, choice, provenance))
    fill_truth(scene, world, choice, filling.put, progress)
    return filling.dataset()


@dataclass(frozen=True)
class TruthChoice:
    """Which truth is wanted; see `make_truth`."""

    views: TruthViews = "reference"
    poses: TruthPoses = "real"
    content: TruthMaps = "standard"


def blank_truth(scene: Scene, choice: TruthChoice, provenance: dict[str, Any]) -> xr.Dataset:
    """Return the truth of a scene with maps that take no memory: all of their pixels are one.

    Poses and times of the images, coordinates and attributes are there.
    """
    stage, frames, camera = scene.stage, scene.frames, scene.camera
    images = (*((stage.rows,) if stage.rows > 1 else ()), stage.positions, frames.count)
    size, all_views = (camera.height, camera.width), choice.views == "all"
    names = list(STANDARD + FOLLOWED)
    if choice.content == "complete":
        names += [*FURTHER, *(MOVED if scene.shutter.readout_time_s == 0 else ())]
    arrays: dict[str, NDArray[Any]] = {"visible": blank_map(np.bool_, (*images, *size))}
    for name in names:
        lead = [len(COMPONENTS[dim]) for dim in VARIABLES["truth"][name].dims if dim in COMPONENTS]
        shape = (*lead, *(images if all_views else images[-1:]), *size)
        arrays[name] = blank_map(DTYPES.get(name, np.float64), shape)
    arrays |= _poses(scene, schedule_of(scene))
    objects = json.dumps([item.name for _, item in scene.parts])
    return label(
        "truth",
        {name: arrays[name] for name in VARIABLES["truth"] if name in arrays},
        intrinsics_from(scene),
        t=frames.t,
        s=stage.s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if stage.rows > 1 else None,
        attrs={**provenance, "object_names": objects, "truth_poses": choice.poses},
    )


def fill_truth(
    scene: Scene, world: World, choice: TruthChoice, put: Put, progress: Progress | None = None
) -> list[str]:
    """Compute the maps of a truth, image by image.

    Parameters
    ----------
    scene, world
        The scene, and its objects.
    choice
        Which truth is wanted.
    put
        Takes every map: (name, place along the leading dimensions, values).
    progress
        As of `make_truth`.

    Returns
    -------
    list of str
        Warnings of objects without pixels in the interior (`interior_warnings`).
    """
    stage, frames, schedule = scene.stage, scene.frames, schedule_of(scene)
    moment_of = schedule.moment if choice.poses == "real" else schedule.nominal
    cameras = [(s_y, s) for s_y in stage.s_y.tolist() for s in stage.s.tolist()]
    moments = [[moment_of(s, t, s_y) for t in frames.t.tolist()] for s_y, s in cameras]
    places = [[(moment.t, moment.viewpoint) for moment in row] for row in moments]
    topology = Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg)
    together = len({time for time, _ in (row[0] for row in places)}) == 1
    geometries = Geometries(world, topology, _KEPT_TIMES if together else _KEPT_TIMES_OF_SCANS)
    rolling = scene.shutter.readout_time_s > 0
    # With a rolling shutter, the displacement of a point does not tell in which row, and so when, it is seen next.
    follower = Follower(geometries, scene.camera, places, "standard" if rolling else choice.content)
    centre = cameras.index((0, 0))
    views = [centre] if choice.views == "reference" else [centre, *(k for k in range(len(cameras)) if k != centre)]
    first = frames.t.tolist().index(0)
    reference: PixelPoints | None = None
    warnings: list[str] = []
    total, done = (len(views) + len(cameras)) * frames.count, 0

    def advance() -> None:
        nonlocal done
        if progress is not None:
            progress("truth", done, total)
        done += 1

    # The reference image comes first: all others are asked whether they show its points.
    for frame in [first, *(n for n in range(frames.count) if n != first)]:
        for index in views:
            advance()
            moment = moments[index][frame]
            geometry = geometries.at(moment.t)
            if rolling:
                maps = _truth_by_rows(scene, world, topology, moment, choice.content)
            else:
                maps = truth_maps(geometry, scene.camera, moment.viewpoint, stage.baseline_mm, choice.content)
            own = PixelPoints(maps, geometry, moment.viewpoint)
            if reference is None:
                reference = own
                found = (maps["object_id"], maps["boundary_distance"], scene.score.interior_margin_px)
                warnings = interior_warnings(world, *found)
            at = {"t": frame} if choice.views == "reference" else _at(stage, index, frame)
            for name, values in (maps | follower.maps(own, index, frame)).items():
                put(name, at, values)
            # Large images have large maps: one image's at a time.
            del maps, own, values
        for index in range(len(cameras)):
            advance()
            if reference is not None:
                put("visible", _at(stage, index, frame), follower.shown(reference, index, frame))
    if progress is not None:
        progress("truth", total, total)
    return warnings


def _at(stage: Stage, index: int, frame: int) -> dict[str, int]:
    """Return the place of an image along the leading dimensions of what every camera has."""
    row, position = divmod(index, stage.positions)
    return {**({"s_y": row} if stage.rows > 1 else {}), "s": position, "t": frame}


def _truth_by_rows(
    scene: Scene, world: World, topology: Topology, moment: Moment, content: TruthMaps
) -> dict[str, NDArray[Any]]:
    """Return the truth of an image that a rolling shutter takes, every row in the middle of its own exposure."""
    camera, shutter = scene.camera, scene.shutter
    later_s = shutter.row_offsets_s(np.arange(camera.height, dtype=np.float64), camera.height)
    travel_mm = shutter.stage_speed_mm_per_s * later_s
    places = [moment.viewpoint.moved((along, 0.0, 0.0)) for along in travel_mm.tolist()]
    times = moment.t + later_s / scene.frames.frame_interval_s
    return truth_by_rows(world, topology, camera, times, places, scene.stage.baseline_mm, content)


def _poses(scene: Scene, schedule: Schedule) -> dict[str, NDArray[np.float64]]:
    """Return the real poses and times of all images."""
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
