"""Simulation of the recording and the ground truth of a scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from itertools import chain, groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import ImageAcquisition, LinearImage, build_sensor_chain
from scenetruth.errors import SceneWarning
from scenetruth.memory import release_memory
from scenetruth.progress import Progress
from scenetruth.provenance import build_schedule, outline_recording, provenance_attributes, recording_hash
from scenetruth.random_streams import generator_for
from scenetruth.render import Renderer, choose_renderer
from scenetruth.resources import Limits, load_checked_scene, raising_all_problems, refuse_beyond_limits
from scenetruth.scene import Overrides, SceneLike
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.scene_report import check_scene
from scenetruth.schema import DatasetOutline, IncrementalDataset, Put
from scenetruth.storage import RECORDING, SCENE, TRUTH, StoreWriter, store_name
from scenetruth.threads import in_order, with_one_blas_thread
from scenetruth.truth import (
    TruthMaps,
    TruthOptions,
    TruthPoses,
    TruthTasks,
    TruthViews,
    announce_truth,
    count_tasks_at_once,
    memory_for,
    outline_truth,
    refuse_arguments,
    truth_from_world,
)

if TYPE_CHECKING:
    import xarray as xr

    from scenetruth.render.light_maps import LightOfBands, LightOfScene

__all__ = ["Simulation", "make_truth", "simulate", "simulate_into"]


class Simulation(NamedTuple):
    """Recording and ground truth of a scene, the result of `simulate`.

    Parameters
    ----------
    recording
        Images with their metadata, as from `make_recording`.
    truth
        Exact maps of depth, disparity, motion and other quantities.

    See Also
    --------
    simulate : Returns it.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> simulation = st.simulate(plain)
    >>> simulation.recording.image.shape, simulation.truth.depth.shape
    ((3, 1, 30, 40), (1, 30, 40))
    """

    recording: xr.Dataset
    truth: xr.Dataset


def simulate(
    scene: SceneLike,
    *,
    overrides: Overrides = (),
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "actual",
    truth_content: TruthMaps = "standard",
    save_radiance: bool = False,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Simulate the images of a scene, and compute the exact ground truth.

    Parameters
    ----------
    scene
        The scene, its values, its file, or the name of a bundled scene.
    overrides
        Changed fields of the scene, as for `load_scene`.
    truth_views
        ``"reference"``: truth of the reference camera (s = 0) at every frame; ``"all"``: truth of every camera.
    truth_poses
        ``"actual"``: truth at the actual time and pose of each image, including stage errors; ``"nominal"``: truth at
        the nominal time and pose.
    truth_content
        ``"standard"``: the maps for scoring; ``"complete"``: all maps, at more than twice the size, with acceleration,
        displacement and finite flow to t ± 1, slopes, curvatures, rotation rate, principal growth rates, and material
        coordinates; ``"complete_with_light"``: also maps of light, see `make_truth`.
    save_radiance
        Whether the recording also contains ``radiance``, the linear, noise-free input images of the sensor.
    limits
        Resource limits (`scenetruth.Limits`); the default limits if not given.
    progress
        Called with (what, done, total).

    Returns
    -------
    Simulation
        Named tuple ``(recording, truth)`` in memory: the recording with ``image`` (s, t, y, x), or (s, t, y, x,
        channel) for a camera with bands, and optionally ``radiance``, and the truth with maps (t, y, x) or
        (s, t, y, x). The recording contains the nominal poses and times of the images, the truth the actual values. If
        the stage has rows, ``s_y`` precedes ``s``. `run_scene` with ``stages=("render",)`` writes both to disk image by
        image.

    Raises
    ------
    ArgumentError
        If arguments are invalid; lists every problem.
    SceneError
        If the scene is invalid or exceeds a limit, or no part of it is visible.
    BackendUnavailableError
        If the specified render backend is unavailable.

    Warns
    -----
    SceneWarning
        If textures are too fine, images are saturated, or objects have no pixels in the scored interior.

    See Also
    --------
    make_truth : Compute the truth only.
    run_scene : Run all stages, with results in a directory.
    make_recording : Create a recording from images of any origin.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 2}, "render": {"backend": "raycast"}}
    >>> recording, truth = simulate(st.Scene.from_dict(plain))
    >>> dict(recording.image.sizes), recording.attrs["render_backend"]
    ({'s': 3, 't': 2, 'y': 30, 'x': 40}, 'raycast')
    >>> truth.depth.dims, truth.depth.sel(t=0)[15, 20].item(), truth.disparity.sel(t=0)[15, 20].item()
    (('t', 'y', 'x'), 100.0, 3.0)
    """
    refuse_arguments(scene, truth_views, truth_poses, truth_content, progress)
    scene = load_checked_scene(scene, overrides=overrides, limits=limits or Limits())
    refuse_beyond_limits(scene, limits)
    choice = TruthOptions(truth_views, truth_poses, truth_content)
    work = _Work(scene, choice, save_radiance=save_radiance, progress=progress)
    with work.opened() as blank:
        images, maps = IncrementalDataset(blank.dataset()), IncrementalDataset(work.outline_truth().dataset())
        work.perform(images.put, maps.put)
    work.warn(stacklevel=3)
    return Simulation(images.dataset(), maps.dataset())


def make_truth(
    scene: SceneLike,
    *,
    overrides: Overrides = (),
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "actual",
    truth_content: TruthMaps = "standard",
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the exact ground truth of a scene without rendering images.

    Parameters
    ----------
    scene
        A scene, its values, its file, or the name of a bundled scene.
    overrides
        Overrides of scene fields, as in `load_scene`.
    truth_views
        ``"reference"``: ground truth of the reference camera (s = 0) at every frame; ``"all"``: of every camera.
    truth_poses
        ``"actual"``: ground truth at the actual time and pose of each image, including stage errors; ``"nominal"``: at
          the planned time and pose.
    truth_content
        ``"standard"``: the maps that estimates are scored against; ``"complete"``: all maps, at more than twice the
          size: also acceleration, displacement and finite flow to t ± 1, slopes, curvatures, rotation rate, principal
          growth rates and material coordinates; ``"complete_with_light"``: also radiance, its shares of diffuse,
          specular, transmitted and ambient light, and the fraction of the lamps' light that is not blocked.
    limits
        Resource limits of the scene (`scenetruth.Limits`).
    progress
        Callback with the arguments (task, done, total).

    Returns
    -------
    xarray.Dataset
        Maps (t, y, x) or (s, t, y, x) in float64, at pixel centres; see ``docs/reference/data_model.md``. NaN where
        no surface is visible. Maps of light of cameras with bands begin with the dimension ``channel``.

    Raises
    ------
    ArgumentError
        If arguments are invalid; lists every problem.
    SceneError
        If the scene is invalid or exceeds a limit, or no object is visible.

    See Also
    --------
    simulate : Simulate images and ground truth.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}}
    >>> truth = st.make_truth(st.Scene.from_dict(plain))
    >>> float(truth.depth[0, 15, 20]), float(truth.disparity[0, 15, 20])
    (100.0, 3.0)
    """
    refuse_arguments(scene, truth_views, truth_poses, truth_content, progress)
    scene = load_checked_scene(scene, overrides=overrides, limits=limits or Limits())
    refuse_beyond_limits(scene, limits)
    choice = TruthOptions(truth_views, truth_poses, truth_content)
    world = _build(scene, choice)
    light = _light_of(scene, world, choice)
    return truth_from_world(scene, world, choice, provenance_attributes(scene), progress, light)


def _light_of(scene: Scene, world: BuiltScene, choice: TruthOptions) -> LightOfScene | LightOfBands | None:
    """Return the light of a scene if maps of light are chosen."""
    if choice.content != "complete_with_light":
        return None
    from scenetruth.render.light_maps import LightOfBands, LightOfScene

    bands = zip(scene.band_scenes(), world.bands or (world,), strict=True)
    found = tuple(LightOfScene(one.lighting, painted) for one, painted in bands)
    return LightOfBands(found) if scene.camera.bands else found[0]


def simulate_into(
    folder: Path, scene: Scene, choice: TruthOptions, *, save_radiance: bool = False, progress: Progress | None = None
) -> tuple[str, str]:
    """Simulate a scene into an empty directory, image by image."""
    import yaml

    text = yaml.safe_dump(scene.to_dict(), sort_keys=False, allow_unicode=True)
    (folder / SCENE).write_text(text, encoding="utf-8")
    work = _Work(scene, choice, save_radiance=save_radiance, progress=progress)
    (recorded, measured), zipped = _stores(folder, scene), scene.storage.form == "zip"
    with work.opened() as blank, StoreWriter(recorded, blank, zipped=zipped) as images:
        like, narrow = work.outline_truth(), scene.storage.truth == "float32"
        with StoreWriter(measured, like, zipped=zipped, narrow=narrow) as maps:
            work.perform(images.put, maps.put)
    work.warn(stacklevel=3)
    return blank.attrs["render_backend"], blank.attrs["render_fallback_reason"]


def _stores(folder: Path, scene: Scene) -> tuple[Path, Path]:
    """Return the paths of recording and truth."""
    zipped = scene.storage.form == "zip"
    return folder / store_name(RECORDING, zipped=zipped), folder / store_name(TRUTH, zipped=zipped)


def _build(scene: Scene, choice: TruthOptions) -> BuiltScene:
    """Build a scene for images and ground truth, or raise an error with the problems of all objects and lamps."""
    with raising_all_problems(scene):
        world = build_scene(scene)
        # The geometry that checks compute serves the ground truth.
        announce_truth(scene, world, choice)
        check_scene(scene, world)
    return world


class _Image(NamedTuple):
    """Image of the scan: index in the recording; moment; row, camera and frame; and, once rendered, its values."""

    at: dict[str, int]
    moment: ImageAcquisition
    place: tuple[int, int, int]
    radiance: NDArray[np.float32] | None = None
    read: NDArray[Any] | None = None
    brightest: float = 0.0


class _Work:
    """Simulation of one scene with arbitrary destinations of images and maps."""

    def __init__(self, scene: Scene, choice: TruthOptions, *, save_radiance: bool, progress: Progress | None) -> None:
        self.scene, self.choice, self.save_radiance, self.progress = scene, choice, save_radiance, progress
        self.world = _build(scene, choice)
        self.provenance = provenance_attributes(scene)
        self.warnings: list[str] = []
        sensor, shape = build_sensor_chain(scene.sensor), (scene.camera.height, scene.camera.width)
        self._sensor = sensor.open(shape, partial(generator_for, scene.seed, "sensor"), scene.camera.bands)
        self._previous: LinearImage | None = None
        self._brightest = 0.0

    @contextmanager
    def opened(self) -> Iterator[DatasetOutline]:
        """Open the renderer, and yield the outline of the recording, with blank images."""
        scene = self.scene
        choice = choose_renderer(scene, self.world)
        self._another = choice.another
        with choice.renderer as self._renderer:
            # Links the truth to these images.
            name = self._renderer.name
            self.provenance["recording_hash"] = recording_hash(self.provenance["scene_hash"], name)
            attrs = {**self.provenance, "render_backend": name, "render_fallback_reason": choice.fallback_reason}
            yield outline_recording(scene, attrs, save_radiance=self.save_radiance)

    def outline_truth(self) -> DatasetOutline:
        """Return the outline of the truth, with blank maps; requires `opened`, to whose recording it belongs."""
        return outline_truth(self.scene, self.choice, self.provenance)

    @with_one_blas_thread
    def perform(self, put_image: Put, put_map: Put) -> None:
        """Render all images, apply the sensor model, and compute the truth, in several threads; requires `opened`."""
        scene, progress = self.scene, self.progress
        truth = TruthTasks(scene, self.world, self.choice, _light_of(scene, self.world, self.choice))
        size = (scene.camera.width * scene.camera.height, len(self.world.faces))
        at_once = count_tasks_at_once(*size)
        runs = self._list_images(at_once)
        total = sum(map(len, runs))
        work: list[Callable[[], list[Any]]] = []
        renderers: list[Renderer] = []
        if self._another is not None:
            renderers += [self._renderer, *(self._another() for _ in range(at_once - 1))]
            work += [partial(self._render, run, renderers) for run in runs]
        if at_once > 1:
            work += truth.tasks
        with memory_for(*size), closing(in_order(lambda task: task(), work, at_once)) as results:
            images = chain.from_iterable(results) if self._another is not None else self._render_in_turn(runs)
            for done, image in enumerate(islice(images, total)):
                if progress is not None:
                    progress("render", done, total)
                self._expose(image, put_image)
            if progress is not None:
                progress("render", total, total)
            # The truth needs other arrays, for which the memory of the images has gaps.
            renderers.clear()
            release_memory()
            # Maps of large images are stored before the next are computed, to limit memory.
            truth.put(results if at_once > 1 else (task() for task in truth.tasks), put_map, progress)
        self.warnings += [*_saturation_warnings(scene, self._brightest), *truth.warnings]

    def _list_images(self, at_once: int) -> list[list[_Image]]:
        """Return the images in the order of the scan, because some sensors depend on the previous image, in runs.

        A run is rendered by one renderer, which retains the geometry of a time: all images of a time if there are
        enough times for all threads, else each image.
        """
        stage, frames = self.scene.stage, self.scene.frames
        places = [(k, m, s_y, s) for k, s_y in enumerate(stage.s_y.tolist()) for m, s in enumerate(stage.s.tolist())]
        order = [(n, t, *place) for n, t in enumerate(frames.t.tolist()) for place in places]
        order.sort(key=lambda at: (at[0], stage.number_in_scan(at[5], at[1], at[4])))
        schedule = build_schedule(self.scene)
        images = [
            _Image({**({"s_y": k} if stage.rows > 1 else {}), "s": m, "t": n}, schedule.moment(s, t, s_y), (s_y, s, t))
            for n, t, k, m, s_y, s in order
        ]
        runs = [list(run) for _, run in groupby(images, key=lambda image: image.moment.t)]
        return runs if 1 < at_once <= len(runs) / 2 else [[image] for image in images]

    def _render(self, run: list[_Image], renderers: list[Renderer]) -> list[_Image]:
        """Render images by one of the renderers that are not in use."""
        renderer = renderers.pop()
        try:
            return [self._read(image, renderer.render(image.moment.t, image.moment.viewpoint)) for image in run]
        finally:
            renderers.append(renderer)

    def _render_in_turn(self, runs: list[list[_Image]]) -> Iterator[_Image]:
        """Render all images by a renderer that is bound to its thread."""
        images = [image for run in runs for image in run]
        rendered = self._renderer.render_all((image.moment.t, image.moment.viewpoint) for image in images)
        yield from map(self._read, images, rendered)

    def _read(self, image: _Image, radiance: NDArray[np.float32]) -> _Image:
        """Return an image with its radiance and, if it does not depend on others, its digital numbers."""
        brightest = float(radiance.max())
        if self._sensor.chain.remembers:
            return image._replace(radiance=radiance, brightest=brightest)
        read = self._sensor.read(LinearImage(radiance, *image.place))
        return image._replace(radiance=radiance if self.save_radiance else None, read=read, brightest=brightest)

    def _expose(self, image: _Image, put: Put) -> None:
        """Store an image, the next of the scan."""
        self._brightest = max(self._brightest, image.brightest)
        read = image.read
        if image.radiance is not None:
            if self.save_radiance:
                put("radiance", image.at, image.radiance)
            if read is None:
                linear = LinearImage(image.radiance, *image.place)
                read, self._previous = self._sensor.read(linear, self._previous), linear
        assert read is not None
        put("image", image.at, read)

    def warn(self, stacklevel: int) -> None:
        """Issue the collected warnings."""
        for message in self.warnings:
            warnings.warn(message, SceneWarning, stacklevel=stacklevel)


def _saturation_warnings(scene: Scene, brightest: float) -> list[str]:
    limit = build_sensor_chain(scene.sensor).saturation_radiance
    # A value at full scale may result from rounding.
    if brightest <= limit * (1 + 1e-6):
        return []
    lit = scene.lighting != Lighting()
    place, remedy = ("lighting", "reduce irradiance or ambient") if lit else ("sensor", "reduce the exposure time")
    return [
        f"{place}: images reach a radiance of {brightest:.4g}, but the sensor's full scale is {limit:.4g}; {remedy}"
    ]
