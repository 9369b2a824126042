"""Noise-free reference image and ground truth of a scene, as input of the Cramér-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.image_gradients import GreyNoise
from scenetruth.design.prediction.camera_response import compute_grey_levels
from scenetruth.provenance import build_schedule, intrinsics_from, outline_recording
from scenetruth.raycast import scene_topology
from scenetruth.render import choose_renderer
from scenetruth.resources import build_checked_scene
from scenetruth.scene import Scene
from scenetruth.schema import label
from scenetruth.truth import Geometries, PixelPoints, PointTracker, truth_maps

__all__ = ["ReferenceRender", "render_reference"]

Array = NDArray[np.float64]

_MAPS = ("depth", "velocity", "normal", "disparity", "flow", "mixed", "object_id", "growth_rate", "boundary_distance")
_MORE_MAPS = ("principal_growth_rates",)
_CACHED_TIMES = 4


@dataclass(frozen=True, eq=False)
class ReferenceRender:
    """Inputs of the Cramér-Rao bound for a scene; grey values and noise are fractions of full scale, maps (y, x)."""

    truth: xr.Dataset  # maps of the reference camera and frame, and ``visible`` of all images
    recording: xr.Dataset  # noise-free reference image for all images, as ``image`` and ``radiance``
    noise: GreyNoise
    noise_map: Array  # temporal noise
    pattern_map: Array  # fixed-pattern noise
    level_map: Array  # grey level
    names: tuple[str, ...]


def render_reference(scene: Scene, *, complete: bool = False) -> ReferenceRender:
    """Render the reference image of a scene and compute its ground truth, at the planned poses."""
    world = build_checked_scene(scene)
    schedule, stage, frames = build_schedule(scene), scene.stage, scene.frames
    cameras = [(s_y, s) for s_y in stage.s_y.tolist() for s in stage.s.tolist()]
    moments = [[schedule.nominal(s, t, s_y) for t in frames.t.tolist()] for s_y, s in cameras]
    reference = schedule.nominal(0, 0)
    topology = scene_topology(world)
    geometries = Geometries(world, topology, _CACHED_TIMES)
    geometry = geometries.at(reference.t)
    extent: Literal["standard", "complete"] = "complete" if complete else "standard"
    maps = truth_maps(geometry, scene.camera, reference.viewpoint, stage.baseline_mm, extent)
    places = [[(moment.t, moment.viewpoint) for moment in row] for row in moments]
    follower = PointTracker(geometries, scene.camera, places, "standard")
    points = PixelPoints(maps, geometry, scene.camera, reference.viewpoint)
    size = (scene.camera.height, scene.camera.width)
    shown = np.zeros((len(cameras), frames.count, *size), dtype=np.bool_)
    # Iterate by frame: the geometry of a time is cached.
    for frame in range(frames.count):
        for index in range(len(cameras)):
            shown[index, frame] = follower.shown(points, index, frame)
    with choose_renderer(scene, world).renderer as renderer:
        radiance = renderer.render(reference.t, reference.viewpoint).astype(np.float64)
    grey = compute_grey_levels(scene.sensor, radiance.ravel())
    level, noise, pattern = (each.reshape(size) for each in (grey.level, grey.noise, grey.pattern))
    lead = (stage.rows, stage.positions) if stage.rows > 1 else (stage.positions,)
    # Of the other frames, only `visible` is used: they share the maps of the reference, which takes no memory.
    arrays: dict[str, NDArray[Any]] = {
        name: np.broadcast_to(maps[name][..., None, :, :], (*maps[name].shape[:-2], frames.count, *size))
        for name in (*_MAPS, *_MORE_MAPS)
        if name in maps
    }
    arrays["visible"] = shown.reshape(*lead, frames.count, *size)
    truth = label(
        "truth",
        arrays,
        intrinsics_from(scene),
        t=frames.t,
        s=stage.s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if stage.rows > 1 else None,
    )
    recording = outline_recording(scene, {"full_scale": 1.0}, save_radiance=True).dataset()
    dims = recording["image"].dims
    same = np.broadcast_to(level.astype(np.float32), recording["image"].shape)
    recording = recording.assign(image=(dims, same), radiance=(dims, same))
    return ReferenceRender(
        truth=truth,
        recording=recording,
        noise=_linear(level, noise),
        noise_map=noise,
        pattern_map=pattern,
        level_map=level,
        names=tuple(item.name for _, item in scene.parts),
    )


def _linear(level: Array, noise: Array) -> GreyNoise:
    """Return the regression line of noise variance over grey level: exact for linear sensors."""
    variance = noise**2
    spread = level - level.mean()
    square = float(np.sum(spread**2))
    slope = float(np.sum(spread * variance)) / square if square > 0 else 0.0
    return GreyNoise(float(variance.mean() - slope * level.mean()), slope, float(variance.min()))
