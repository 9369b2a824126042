"""The truth of a recording: the maps of all its images in one data set."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import Moment, Schedule
from scenetruth.progress import Progress
from scenetruth.provenance import intrinsics_from, provenance_of, schedule_of
from scenetruth.raycast import Topology
from scenetruth.scene.check import check_scene
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World, build_world
from scenetruth.schema import VARIABLES, label
from scenetruth.truth.following import PixelPoints, follow_points
from scenetruth.truth.maps import GeometryPass, TruthMaps, truth_maps
from scenetruth.truth.rolling import truth_by_rows

__all__ = ["TruthPoses", "TruthViews", "make_truth", "truth_of_world"]

TruthViews = Literal["reference", "all"]
TruthPoses = Literal["real", "nominal"]


def make_truth(
    scene: Scene,
    *,
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "real",
    truth_content: TruthMaps = "standard",
    folder: str | Path = "",
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
    folder
        Folder to which relative paths of mesh and image files in the scene refer.
    progress
        Called with (what, done, total) as the work goes on.

    Returns
    -------
    xarray.Dataset
        Maps (t, y, x) or (s, t, y, x) in float64, at pixel centres; see ``docs/truth.md``. NaN where nothing is seen.

    Raises
    ------
    SceneError
        If the scene cannot be made, or nothing of it can be seen.

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
    world = build_world(scene, Path(folder))
    check_scene(scene, world)
    return truth_of_world(scene, world, truth_views, truth_poses, truth_content, provenance_of(scene, folder), progress)


def truth_of_world(
    scene: Scene,
    world: World,
    truth_views: TruthViews,
    truth_poses: TruthPoses,
    truth_content: TruthMaps,
    provenance: dict[str, Any],
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the truth of a world that has been built and checked; see `make_truth`.

    Parameters
    ----------
    scene, world
        The scene, and its objects.
    truth_views, truth_poses, truth_content, progress
        As of `make_truth`.
    provenance
        Attributes that say from which scene and program the truth is.

    Returns
    -------
    xarray.Dataset
        As of `make_truth`.
    """
    stage, frames, schedule = scene.stage, scene.frames, schedule_of(scene)
    moment_of = schedule.moment if truth_poses == "real" else schedule.nominal
    reference = truth_views == "reference"
    views = [(0, 0)] if reference else [(s_y, s) for s_y in stage.s_y.tolist() for s in stage.s.tolist()]
    topology = Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg)
    geometry = None
    arrays: dict[str, NDArray[Any]] = {}
    seen: list[list[PixelPoints]] = [[] for _ in views]
    images = stage.rows * stage.positions * frames.count
    total = len(views) * frames.count + images
    for n, t in enumerate(frames.t.tolist()):
        for m, (s_y, s) in enumerate(views):
            if progress is not None:
                progress("truth", n * len(views) + m, total)
            moment = moment_of(s, t, s_y)
            if geometry is None or geometry.snapshot.t != moment.t:
                geometry = GeometryPass(world, topology, moment.t)
            if scene.shutter.readout_time_s > 0:
                maps = _truth_by_rows(scene, world, topology, moment, truth_content)
            else:
                maps = truth_maps(geometry, scene.camera, moment.viewpoint, stage.baseline_mm, truth_content)
            seen[m].append(PixelPoints(world, maps, geometry, moment.viewpoint))
            for name, values in maps.items():
                if name not in arrays:
                    lead = values.shape[:-2]
                    arrays[name] = np.empty((*lead, len(views), frames.count, *values.shape[-2:]), dtype=values.dtype)
                arrays[name][..., m, n, :, :] = values
    cameras = [(s_y, s) for s_y in stage.s_y.tolist() for s in stage.s.tolist()]
    moments = [[moment_of(s, t, s_y) for t in frames.t.tolist()] for s_y, s in cameras]
    arrays |= follow_points(
        world,
        topology,
        scene.camera,
        [[(moment.t, moment.viewpoint) for moment in row] for row in moments],
        [cameras.index(view) for view in views],
        seen,
        (views.index((0, 0)), frames.t.tolist().index(0)),
        # With a rolling shutter, the displacement of a point does not tell in which row, and so when, it is seen next.
        "standard" if scene.shutter.readout_time_s > 0 else truth_content,
        None if progress is None else lambda done, _: progress("truth", total - images + done, total),
    )
    if progress is not None:
        progress("truth", total, total)
    lead = () if reference else (stage.rows, stage.positions) if stage.rows > 1 else (stage.positions,)
    visible = arrays.pop("visible")
    arrays = {name: values.reshape(*values.shape[:-4], *lead, *values.shape[-3:]) for name, values in arrays.items()}
    if stage.rows > 1:
        visible = visible.reshape(stage.rows, stage.positions, *visible.shape[1:])
    arrays |= {"visible": visible, **_poses(scene, schedule)}
    names = json.dumps([item.name for _, item in scene.parts])
    return label(
        "truth",
        {name: arrays[name] for name in VARIABLES["truth"] if name in arrays},
        intrinsics_from(scene),
        t=frames.t,
        s=stage.s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if stage.rows > 1 else None,
        attrs={**provenance, "object_names": names, "truth_poses": truth_poses},
    )


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
