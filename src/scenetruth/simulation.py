"""From a scene to a recording and its truth."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import LinearImage, chain_of
from scenetruth.errors import SceneWarning
from scenetruth.progress import Progress
from scenetruth.provenance import provenance_of, recording_hash, schedule_of
from scenetruth.randomness import generator_for
from scenetruth.render import choose_renderer
from scenetruth.scene.check import check_scene
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World, build_world
from scenetruth.schema import VARIABLES, make_recording
from scenetruth.truth import TruthMaps, TruthPoses, TruthViews, interior_warnings, truth_of_world

__all__ = ["simulate"]


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
        ``"real"``: truth at the time and pose at which each image was taken, with the errors of the stage;
        ``"nominal"``: truth at the planned time and pose.
    truth_content
        ``"standard"``: the maps that estimates are scored against; ``"complete"``: all maps, at more than twice the
        size, with acceleration, displacement and finite flow to t ± 1, slopes, curvatures,
        rotation rate, principal growth, and coordinates on the surface.
    ideal
        Whether the recording also holds ``ideal``, the linear images without noise that the sensor was given.
    folder
        Folder to which relative paths of mesh and image files in the scene refer.
    progress
        Called with (what, done, total) as the work goes on.

    Returns
    -------
    tuple
        The recording, ``image`` (s, t, y, x) and perhaps ``ideal``, and the truth, maps (t, y, x) or (s, t, y, x).
        The recording holds the planned poses and times of the images, the truth the real ones. If the stage has rows,
        ``s_y`` comes before ``s``.

    Raises
    ------
    SceneError
        If the scene cannot be made, or nothing of it can be seen.
    BackendUnavailableError
        If the scene names a render backend that does not run here.

    Warns
    -----
    SceneWarning
        If textures are too fine, images saturated, or objects without pixels in the interior of which scores tell.

    See Also
    --------
    make_truth : The truth alone.
    run_scene : All stages, with their results in a folder.
    make_recording : A recording from images of any origin.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 2}, "render": {"backend": "raycast"}}
    >>> recording, truth = simulate(st.scene_from_plain(plain))
    >>> dict(recording.image.sizes), recording.attrs["render_backend"]
    ({'s': 3, 't': 2, 'y': 30, 'x': 40}, 'raycast')
    >>> truth.depth.dims, truth.depth.sel(t=0)[15, 20].item(), truth.disparity.sel(t=0)[15, 20].item()
    (('t', 'y', 'x'), 100.0, 3.0)
    """
    world = build_world(scene, Path(folder))
    check_scene(scene, world)
    provenance = provenance_of(scene, folder)
    recording = _record(scene, world, provenance, progress, ideal=ideal)
    # The truth belongs to these very images.
    provenance["recording_hash"] = recording.attrs["recording_hash"]
    truth = truth_of_world(scene, world, truth_views, truth_poses, truth_content, provenance, progress)
    _warn_of_lost_interiors(scene, world, truth)
    return recording, truth


def _record(
    scene: Scene, world: World, provenance: dict[str, Any], progress: Progress | None, *, ideal: bool
) -> xr.Dataset:
    stage, frames, camera = scene.stage, scene.frames, scene.camera
    sensor = chain_of(scene.sensor)
    opened = sensor.open((camera.height, camera.width), partial(generator_for, scene.seed, "sensor"))
    schedule = schedule_of(scene)
    shape = (stage.rows, stage.positions, frames.count, camera.height, camera.width)
    images: NDArray[Any] = np.empty(shape, dtype=sensor.dtype)
    linear: NDArray[np.float32] | None = np.empty(shape, dtype=np.float32) if ideal else None
    places = [(k, m, s_y, s) for k, s_y in enumerate(stage.s_y.tolist()) for m, s in enumerate(stage.s.tolist())]
    total, done = len(places) * frames.count, 0
    previous: LinearImage | None = None
    brightest = 0.0
    choice = choose_renderer(scene, world)
    with choice.renderer as renderer:
        for n, t in enumerate(frames.t.tolist()):
            # In the order of the scan: some sensors need the image before.
            for k, m, s_y, s in sorted(places, key=lambda place: stage.number_in_scan(place[3], t, place[2])):
                if progress is not None:
                    progress("render", done, total)
                moment = schedule.moment(s, t, s_y)
                radiance = renderer.render(moment.t, moment.viewpoint)
                brightest = max(brightest, float(radiance.max()))
                if linear is not None:
                    linear[k, m, n] = radiance
                image = LinearImage(radiance, s_y, s, t)
                images[k, m, n] = opened.read(image, previous)
                previous = image if sensor.remembers else None
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
        full_scale=sensor.full_scale,
        attrs={
            **provenance,
            "recording_hash": recording_hash(provenance["scene_hash"], renderer.name),
            "render_backend": renderer.name,
            "render_fallback_reason": choice.fallback_reason,
            **({} if camera.distortion is None else {"distortion": list(camera.distortion.coefficients)}),
        },
    )
    if linear is not None:
        entry = VARIABLES["recording"]["ideal"]
        recording["ideal"] = (recording["image"].dims, linear, {"units": entry.units, "long_name": entry.long_name})
    return recording


def _warn_of_lost_interiors(scene: Scene, world: World, truth: xr.Dataset) -> None:
    """Warn of objects of which the scores of the interior will say nothing."""
    maps = truth[["object_id", "boundary_distance"]]
    at = maps.sel({name: 0 for name in ("t", "s", "s_y") if name in maps["object_id"].dims})
    margin = scene.score.interior_margin_px
    for message in interior_warnings(world, at["object_id"].values, at["boundary_distance"].values, margin):
        warnings.warn(message, SceneWarning, stacklevel=3)


def _warn_of_saturation(scene: Scene, brightest: float) -> None:
    """Warn if images of a scene with light of its own are brighter than the sensor can tell."""
    limit = chain_of(scene.sensor).saturation_radiance
    # What is exactly as bright as full scale may have been rounded up.
    if scene.lighting != Lighting() and brightest > limit * (1 + 1e-6):
        message = (
            f"lighting: images reach a radiance of {brightest:.4g} where the sensor's full scale is {limit:.4g}; "
            "reduce irradiance or ambient"
        )
        warnings.warn(message, SceneWarning, stacklevel=4)
