"""From a scene to a recording and its truth."""

from __future__ import annotations

import hashlib
import json
import platform
import warnings
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import Camera, Moment, Schedule
from scenetruth.errors import SceneWarning
from scenetruth.randomness import generator_for
from scenetruth.raycast import Topology
from scenetruth.render import choose_renderer
from scenetruth.scene.check import check_scene
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World, build_world
from scenetruth.schema import VARIABLES, Intrinsics, label, make_recording
from scenetruth.truth import (
    GeometryPass,
    PixelPoints,
    TruthMaps,
    follow_points,
    truth_by_rows,
    truth_maps,
)

__all__ = ["TruthMaps", "TruthPoses", "TruthViews", "make_truth", "scene_hash", "simulate"]

Progress = Callable[[str, int, int], None]
TruthViews = Literal["reference", "all"]
TruthPoses = Literal["real", "nominal"]

_PACKAGES = (
    "scenetruth",
    "numpy",
    "scipy",
    "numba",
    "xarray",
    "zarr",
    "trimesh",
    "embreex",
    "pyrender-maintained",
    "PyOpenGL",
)


def simulate(
    scene: Scene,
    *,
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "real",
    truth_content: TruthMaps = "standard",
    ideal: bool = False,
    folder: str | Path = "",
    progress: Progress | None = None,
) -> tuple[xr.Dataset, xr.Dataset]:
    """Render a scene as a camera on its stage would see it, and compute the exact truth.

    Parameters
    ----------
    scene
        The scene.
    truth_views
        ``"reference"``: truth of the reference camera (s = 0) at every frame; ``"all"``: of every camera.
    truth_poses
        ``"real"``: truth of what each pixel saw, from where the camera stood when the image was taken; ``"nominal"``:
        of what it would have seen from where, and when, it was planned.
    truth_content
        ``"standard"``: what estimates are scored against; ``"complete"``: everything that is known of the surface
        points, at more than twice the size: acceleration, displacement and finite flow to t ± 1, slopes, curvatures,
        rotation rate, principal growth, coordinates on the surface.
    ideal
        Whether the recording also holds ``ideal``, the linear images without noise that the sensor was given.
    folder
        Where relative paths of mesh and image files in the scene count from.
    progress
        Called with (what, done, total) as the work goes on.

    Returns
    -------
    tuple
        The recording, ``image`` (s, t, y, x) and perhaps ``ideal``, and the truth, maps (t, y, x) or (s, t, y, x).
        The recording says where and when images were planned, the truth where and when they were taken in fact. If the
        stage has rows, ``s_y`` comes before ``s``.

    Raises
    ------
    SceneError
        If the scene cannot be made, or nothing of it can be seen.
    BackendUnavailableError
        If the scene names a render backend that does not run here.
    """
    world = build_world(scene, Path(folder))
    check_scene(scene, world)
    recording = _record(scene, world, progress, ideal=ideal)
    truth = make_truth(
        scene,
        world,
        truth_views=truth_views,
        truth_poses=truth_poses,
        truth_content=truth_content,
        progress=progress,
    )
    return recording, truth


def make_truth(
    scene: Scene,
    world: World,
    *,
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "real",
    truth_content: TruthMaps = "standard",
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the truth of a scene without rendering it; see `simulate`."""
    stage, frames, schedule = scene.stage, scene.frames, _schedule_of(scene)
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
        # Where a point lands in an image whose rows are taken one after the other, its displacement does not say.
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
        _intrinsics(scene),
        t=frames.t,
        s=stage.s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if stage.rows > 1 else None,
        attrs={**_provenance(scene), "object_names": names, "truth_poses": truth_poses},
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


def _schedule_of(scene: Scene) -> Schedule:
    return Schedule(scene.stage, scene.frames, partial(generator_for, scene.seed, "stage"))


def _poses(scene: Scene, schedule: Schedule) -> dict[str, NDArray[np.float64]]:
    """Return where and when all images are taken in fact."""
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


def scene_hash(scene: Scene) -> str:
    """Return a hash of everything that a scene says, 16 hexadecimal digits."""
    text = json.dumps(scene.to_plain(), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _record(scene: Scene, world: World, progress: Progress | None, *, ideal: bool) -> xr.Dataset:
    stage, frames, camera = scene.stage, scene.frames, scene.camera
    sensor = None if isinstance(scene.sensor, str) else scene.sensor
    pattern = None
    if sensor is not None:
        pattern = sensor.fixed_pattern((camera.height, camera.width), generator_for(scene.seed, "sensor", "pattern"))
    schedule = _schedule_of(scene)
    shape = (stage.rows, stage.positions, frames.count, camera.height, camera.width)
    images: NDArray[Any] = np.empty(shape, dtype=np.float32 if sensor is None else sensor.dtype)
    linear: NDArray[np.float32] | None = np.empty(shape, dtype=np.float32) if ideal else None
    places = [(k, m, s_y, s) for k, s_y in enumerate(stage.s_y.tolist()) for m, s in enumerate(stage.s.tolist())]
    total, done = len(places) * frames.count, 0
    brightest = 0.0
    choice = choose_renderer(scene, world)
    with choice.renderer as renderer:
        for n, t in enumerate(frames.t.tolist()):
            for k, m, s_y, s in places:
                if progress is not None:
                    progress("render", done, total)
                moment = schedule.moment(s, t, s_y)
                radiance = renderer.render(moment.t, moment.viewpoint)
                brightest = max(brightest, float(radiance.max()))
                if linear is not None:
                    linear[k, m, n] = radiance
                if sensor is None:
                    images[k, m, n] = radiance
                else:
                    # The reference row is sensed as if it were the only one.
                    noise = generator_for(scene.seed, "sensor", *((s_y,) if s_y else ()), s, t)
                    images[k, m, n] = sensor.sense(radiance, noise, pattern)
                done += 1
    if progress is not None:
        progress("render", total, total)
    _warn_of_saturation(scene, brightest)
    if stage.rows == 1:
        images, linear = images[0], None if linear is None else linear[0]
    recording = make_recording(
        images,
        camera.focal_px,
        stage.baseline_mm,
        camera.principal_point,
        frames.frame_interval_s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if stage.rows > 1 else None,
        full_scale=1.0 if sensor is None else sensor.full_scale,
        attrs={
            **_provenance(scene),
            "render_backend": renderer.name,
            "render_fallback_reason": choice.fallback_reason,
            **({} if camera.distortion is None else {"distortion": list(camera.distortion.coefficients)}),
        },
    )
    if linear is not None:
        entry = VARIABLES["recording"]["ideal"]
        recording["ideal"] = (recording["image"].dims, linear, {"units": entry.units, "long_name": entry.long_name})
    return recording


def _warn_of_saturation(scene: Scene, brightest: float) -> None:
    """Warn if images of a scene with light of its own are brighter than the sensor can tell."""
    limit = 1.0 if isinstance(scene.sensor, str) else scene.sensor.saturation_radiance
    # What is exactly as bright as full scale may have been rounded up.
    if scene.lighting != Lighting() and brightest > limit * (1 + 1e-6):
        message = (
            f"lighting: images reach a radiance of {brightest:.4g} where the sensor's full scale is {limit:.4g}; "
            "reduce irradiance or ambient"
        )
        warnings.warn(message, SceneWarning, stacklevel=4)


def _intrinsics(scene: Scene) -> Intrinsics:
    camera: Camera = scene.camera
    return Intrinsics(camera.focal_px, camera.principal_point, scene.stage.baseline_mm, scene.frames.frame_interval_s)


def _provenance(scene: Scene) -> dict[str, Any]:
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "scene": json.dumps(scene.to_plain()),
        "scene_hash": scene_hash(scene),
        "seed": scene.seed,
        "versions": json.dumps(versions),
    }
