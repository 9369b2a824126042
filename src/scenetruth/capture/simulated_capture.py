"""Simulated captures: the folder that a laboratory would record, with its true parameters in a separate folder."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from scenetruth.camera import LinearImage, SensorChain, Viewpoint, build_sensor_chain
from scenetruth.camera.sensor import DarkCurrent, OpenSensor, PhotonConversion
from scenetruth.capture.board_rendering import InkRenderer, open_board_renderer, project_points
from scenetruth.capture.simulated_rig import CapturePlan, plan_capture, read_settings
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.output import write_atomically
from scenetruth.progress import Progress
from scenetruth.provenance import build_schedule, own_release, scene_hash
from scenetruth.random_streams import generator_for
from scenetruth.render import choose_renderer
from scenetruth.render.renderer import Renderer
from scenetruth.resources import Limits, build_checked_scene, load_checked_scene, refuse_beyond_limits
from scenetruth.scene import Overrides, SceneLike
from scenetruth.scene.built_scene import build_scene
from scenetruth.simulation import make_truth
from scenetruth.storage import TRUTH, is_store, save_store, store_name

__all__ = ["simulate_capture"]

Array = NDArray[np.float64]

_INDEX, _FILE, _TRUTH, _STRIP = "simulated_capture.json", "capture.yaml", "truth", "strip.csv"
_FOLDER = JobFolder(_INDEX, "a simulated capture", _TRUTH)
# Frame numbers of the random streams of the sensor; scenes have at most 100,000 frames.
_STATIC, _DARK, _FLAT, _BOARD = 4_000_000, 3_000_000, 2_000_000, 1_000_000
_MOST_FRAMES = 1000  # of a level
_SUFFIX = "tif"


def simulate_capture(
    scene: SceneLike,
    output: str | Path,
    *,
    overrides: Overrides = (),
    limits: Limits | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Path:
    """Simulate a capture folder: images of a calibration board, dark, flat and static images, images of the objects.

    Camera, lens, stage with its errors, and sensor are those of the scene. Board images are exact means over the
    pixels. If interrupted, the same call resumes; files appear when they are complete.

    Parameters
    ----------
    scene
        The scene, its values, its file, or the name of a bundled scene. Its sensor must return digital numbers.
    output
        The capture folder. It contains ``capture.yaml``, the folders ``board``, ``dark``, ``flat``, ``static`` and
        ``images``, ``strip.csv`` with a strip, and the folder ``truth`` with the true parameters, points and maps.
    overrides
        Changed fields of the scene, as for `load_scene`.
    limits
        Resource limits of the scene; the default limits if not given.
    progress
        Called with (what, done, total).
    **settings
        Fields of `scenetruth.capture.CaptureSimulation`: board, poses, tolerances, numbers and exposures of dark and
        flat images, fiducial strip.

    Returns
    -------
    pathlib.Path
        The capture folder.

    Raises
    ------
    ArgumentError
        If settings are invalid, or points of the board are outside the images; lists every problem.
    SceneError
        If the scene is invalid, or its sensor returns no digital numbers.
    OutputExistsError
        If the folder contains another capture, or other data.

    See Also
    --------
    scenetruth.simulate : Simulates the images of the objects only.

    Examples
    --------
    >>> import tempfile
    >>> from scenetruth.capture import simulate_capture
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 60, "height": 45, "focal_length_px": 100}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 2}, "frames": {"count": 2}, "sensor": {"bit_depth": 8}}
    >>> board = {"kind": "checkerboard", "squares": [5, 4], "square_mm": 5}
    >>> with tempfile.TemporaryDirectory() as scratch:
    ...     folder = simulate_capture(plain, f"{scratch}/capture", board=board, poses=2, dark=1, flat=1)
    ...     sorted(path.name for path in folder.glob("board/*"))[:3]
    ['p00_s+0.tif', 'p00_s+1.tif', 'p00_s-1.tif']
    """
    given = read_settings(settings)
    loaded = load_checked_scene(scene, overrides=overrides, limits=limits or Limits())
    refuse_beyond_limits(loaded, limits)
    build_checked_scene(loaded)
    plan = plan_capture(loaded, given)
    identity = {
        "format": 1,
        "release": own_release(),
        "scene_hash": scene_hash(loaded),
        "settings": given.model_dump(mode="json"),
    }
    other = "contains the capture of another scene, other settings or another release; choose another"
    with _FOLDER.open(output, identity, other=other) as folder:
        _Writing(plan, folder, progress).write()
    return Path(output)


@dataclass(frozen=True)
class _Image:
    """One image of a series: its file, its indices in the random streams of the sensor, and its radiance."""

    name: str
    s_y: int
    s: int
    t: int
    radiance: Callable[[], NDArray[np.float32]]
    exposure: float = 1.0
    """Exposure time as a multiple of that of the images of the objects."""

    def linear(self) -> LinearImage:
        return LinearImage(self.radiance(), self.s_y, self.s, self.t)


class _Writing:
    """Writes the files of a capture that do not exist yet."""

    def __init__(self, plan: CapturePlan, folder: Path, progress: Progress | None) -> None:
        self.plan, self.folder, self.progress = plan, folder, progress
        self.scene = plan.scene
        self.chain = build_sensor_chain(self.scene.sensor)
        self.sensors: dict[float, OpenSensor] = {}
        self.places = [(s_y, s) for s_y in self.scene.stage.s_y.tolist() for s in self.scene.stage.s.tolist()]

    def write(self) -> None:
        series: list[list[_Image]] = [
            self._dark(), self._flat(), *self._boards(), self._static(), self._objects(),
        ]  # fmt: skip
        done, total = 0, sum(map(len, series))
        for images in series:
            for number, image in enumerate(images):
                if self.progress is not None:
                    self.progress("capture", done, total)
                done += 1
                path = self.folder / f"{image.name}.{_SUFFIX}"
                if path.exists():
                    continue
                previous = images[number - 1].linear() if self.chain.remembers and number > 0 else None
                self._put(path, _to_tiff(self._sensor(image.exposure).read(image.linear(), previous)))
        self._close()
        if self.progress is not None:
            self.progress("capture", total, total)
        self._write_truth()
        if self.plan.strip is not None:
            rows = [",".join(f"{x:.3f}" for x in point) for point in self.plan.strip.points_mm]
            self._put(self.folder / _STRIP, "\n".join(["x_mm,y_mm,z_mm", *rows, ""]).encode())
        # Its file completes the folder.
        self._put(self.folder / _FILE, _to_yaml(describe_capture(self.plan)))

    def _sensor(self, exposure: float) -> OpenSensor:
        """Return the sensor of an exposure; all have the same fixed patterns."""
        if exposure not in self.sensors:
            camera, given = self.scene.camera, self.plan.settings.noise_seed
            seed = self.scene.seed if given is None else given
            self.sensors[exposure] = expose_longer(self.chain, exposure).open(
                (camera.height, camera.width), partial(generator_for, seed, "sensor")
            )
        return self.sensors[exposure]

    def _put(self, path: Path, content: bytes) -> None:
        if not path.exists():
            with write_atomically(path) as partial_path:
                partial_path.write_bytes(content)

    def _image_name(self, folder: str, start: str, s_y: int, s: int, end: str = "") -> str:
        row = f"r{s_y:+d}_" if self.scene.stage.rows > 1 else ""
        return f"{folder}/{start}{row}s{s:+d}{end}"

    @cached_property
    def _shade(self) -> Array:
        vignetting = self.scene.optics.vignetting
        camera = self.scene.camera
        return np.ones((camera.height, camera.width)) if vignetting is None else vignetting.factor(camera)

    def _uniform(self, radiance: float) -> NDArray[np.float32]:
        return np.asarray(radiance * self._shade, dtype=np.float32)

    def _dark(self) -> list[_Image]:
        return self._even("dark", "d", _DARK, 0.0, self.plan.settings.dark)

    def _flat(self) -> list[_Image]:
        return self._even("flat", "f", _FLAT, self.plan.flat_radiance, self.plan.settings.flat)

    def _even(self, folder: str, start: str, first: int, radiance: float, count: int) -> list[_Image]:
        """Return the images of a uniform radiance, level after level."""
        exposures = self.plan.exposures
        found = []
        for level, exposure in enumerate(exposures or (1.0,)):
            name = f"{folder}/e{level}_{start}" if exposures else f"{folder}/{start}"
            # Sensors without an exposure time have signals proportional to the radiance.
            light = radiance if self._has_time else radiance * exposure
            found += [
                _Image(
                    f"{name}{n:03d}", 0, 0, first + _MOST_FRAMES * level + n, partial(self._uniform, light), exposure
                )
                for n in range(count)
            ]
        return found

    @property
    def _has_time(self) -> bool:
        return any(isinstance(effect, PhotonConversion) for effect in self.chain.effects)

    def _static(self) -> list[_Image]:
        moment = build_schedule(self.scene).moment(0, 0)

        # The radiance of all images is rendered once, by the first that is missing.
        @cache
        def render() -> NDArray[np.float32]:
            return self._render(moment.t, moment.viewpoint)

        names = [f"static/n{number:03d}" for number in range(self.plan.settings.static)]
        return [_Image(name, 0, 0, _STATIC + number, render) for number, name in enumerate(names)]

    def _boards(self) -> Iterator[list[_Image]]:
        scene = self.scene
        for number, board in enumerate(self.plan.boards):
            renderer = open_board_renderer(
                scene.camera, scene.optics, scene.shutter, scene.frames.frame_interval_s, board, self.plan.light
            )
            yield [
                _Image(
                    self._image_name("board", f"p{number:02d}_", s_y, s),
                    s_y,
                    s,
                    _BOARD + number,
                    partial(renderer.render, 0.0, self.plan.board_viewpoint(number, s, s_y)),
                )
                for s_y, s in self.places
            ]

    @cached_property
    def _renderer(self) -> Renderer:
        strip = self.plan.strip

        def print_ink(base: Renderer, camera: Any) -> Renderer:
            return base if strip is None else InkRenderer(base, camera, [strip.placed], self.plan.strip_contrast)

        return choose_renderer(self.scene, build_scene(self.scene), print_ink).renderer

    def _close(self) -> None:
        if "_renderer" in self.__dict__:
            self._renderer.close()

    def _objects(self) -> list[_Image]:
        stage, schedule = self.scene.stage, build_schedule(self.scene)
        found = []
        for t in self.scene.frames.t.tolist():
            # In the order of the scan, because some sensors depend on the previous image.
            for s_y, s in sorted(self.places, key=lambda at: stage.number_in_scan(at[1], t, at[0])):
                moment = schedule.moment(s, t, s_y)
                render = partial(self._render, moment.t, moment.viewpoint)
                found.append(_Image(self._image_name("images", "", s_y, s, f"_t{t:+d}"), s_y, s, t, render))
        return found

    def _render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        return self._renderer.render(t, viewpoint)

    def _write_truth(self) -> None:
        folder = self.folder / _TRUTH
        store = folder / store_name(TRUTH, zipped=self.scene.storage.form == "zip")
        if self.plan.settings.truth_maps and not is_store(store):
            save_store(make_truth(self.scene), store)
        self._put(folder / "scene.yaml", _to_yaml(self.scene.to_dict()))
        self._put(folder / "points.npz", self._points())
        self._put(folder / "parameters.yaml", _to_yaml(self._parameters()))

    def _points(self) -> bytes:
        """Return the exact pixel coordinates of all calibration points as an npz file."""
        scene, plan, arrays = self.scene, self.plan, dict[str, Array]()
        if plan.boards:
            arrays["board_points_mm"] = plan.boards[0].artwork.points_mm - plan.boards[0].artwork.centre_mm
            arrays["board"] = np.array([
                [project_points(scene.camera, plan.board_viewpoint(number, s, s_y), board) for s_y, s in self.places]
                for number, board in enumerate(plan.boards)
            ])  # fmt: skip
        if plan.strip is not None:
            schedule, placed = build_schedule(scene), plan.strip.placed
            arrays["strip"] = np.array([
                [project_points(scene.camera, schedule.moment(s, t, s_y).viewpoint, placed)
                 for t in scene.frames.t.tolist()]
                for s_y, s in self.places
            ])  # fmt: skip
        stream = io.BytesIO()
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        return stream.getvalue()

    def _parameters(self) -> dict[str, Any]:
        """Return the true parameters."""
        scene, plan = self.scene, self.plan
        camera, schedule = scene.camera, build_schedule(scene)
        tilt = scene.stage.axis_tilt_urad or (0.0, 0.0)
        found: dict[str, Any] = {
            "camera": {
                "focal_length_px": camera.focal_px,
                "principal_point_px": list(camera.principal_point),
                "distortion": None if camera.distortion is None else camera.distortion.model_dump(),
            },
            "stage": {
                "axis": [1.0, 1e-6 * tilt[0], 1e-6 * tilt[1]],
                "step_scale": plan.step_scale,
                "visits": [
                    _pose_of(schedule.moment(s, t, s_y).viewpoint, schedule.moment(s, t, s_y).rotation_rad,
                             **self._at(s_y), s=s, t=t)
                    for s_y, s in self.places
                    for t in scene.frames.t.tolist()
                ],
            },
            "sensor": self.chain.model_dump(mode="json"),
            "flat_radiance": plan.flat_radiance,
        }  # fmt: skip
        if plan.boards:
            first = plan.boards[0]
            found["board"] = {
                "scale": first.scale,
                "warp_mm": list(first.warp_mm),
                "half_width_mm": first.artwork.half_width_mm,
                "poses": [
                    {"position_mm": board.position_mm.tolist(), "rotation": board.rotation.tolist()}
                    for board in plan.boards
                ],
                "visits": [
                    _pose_of(plan.board_viewpoint(number, s, s_y), plan.board_rotation(number, s, s_y),
                             **self._at(s_y), s=s, pose=number)
                    for number in range(len(plan.boards))
                    for s_y, s in self.places
                ],
            }  # fmt: skip
        if plan.strip is not None:
            placed = plan.strip.placed
            found["strip"] = {
                "scale": placed.scale,
                "position_mm": placed.position_mm.tolist(),
                "rotation": placed.rotation.tolist(),
            }
        return found

    def _at(self, s_y: int) -> dict[str, int]:
        return {"row": s_y} if self.scene.stage.rows > 1 else {}


def _pose_of(viewpoint: Viewpoint, rotation_rad: Array, **index: int) -> dict[str, Any]:
    return {
        **index,
        "position_mm": viewpoint.position_mm.tolist(),
        "rotation_rad": np.asarray(rotation_rad).tolist(),
    }


def expose_longer(chain: SensorChain, factor: float) -> SensorChain:
    """Return a sensor with another exposure time: photons and dark current are multiplied by a factor."""
    if factor == 1:
        return chain
    effects = tuple(
        effect.model_copy(update={"exposure_time_s": factor * effect.exposure_time_s})
        if isinstance(effect, PhotonConversion | DarkCurrent)
        else effect
        for effect in chain.effects
    )
    return chain.model_copy(update={"effects": effects})


def describe_capture(plan: CapturePlan) -> dict[str, Any]:
    """Return what a laboratory knows of a capture, as the values of ``capture.yaml``."""
    scene, settings = plan.scene, plan.settings
    grid = scene.stage.rows > 1
    row = "r{row:+d}_" if grid else ""
    stage: dict[str, Any] = scene.stage.model_dump(
        mode="json",
        include={"positions", "baseline_mm", "positions_mm", "rows", "row_spacing_mm", "scan", "time_per_position_s"},
        exclude_none=True,
    )
    if scene.stage.errors is not None:
        stage["errors"] = scene.stage.errors.model_dump(mode="json", exclude_none=True)
    files: dict[str, Any] = {"images": f"images/{row}s{{s:+d}}_t{{t:+d}}.{_SUFFIX}"}
    found: dict[str, Any] = {
        "format": 1,
        "description": scene.description or "Simulated capture",
        "camera": _describe_camera(plan),
        "stage": {**stage, "step_std": settings.step_std or 1e-12},
        "frames": scene.frames.model_dump(mode="json"),
        "files": files,
        "distance_mm": float(f"{plan.distance_mm:.3g}"),
    }
    if plan.boards and not isinstance(settings.board, str):
        files["board"] = f"board/p{{pose:02d}}_{row}s{{s:+d}}.{_SUFFIX}"
        board = settings.board.stated("json")
        found["board"] = {**board, "scale_std": settings.scale_std, "warp_mm": settings.warp_mm}
    files |= {name: f"{name}/*.{_SUFFIX}" for name in ("dark", "flat", "static") if getattr(settings, name)}
    if plan.exposures:
        files |= {name: f"{name}/e{{level}}_*.{_SUFFIX}" for name in ("dark", "flat") if getattr(settings, name)}
        files["exposure_times_s"] = [float(f"{each * (plan.exposure_time_s or 1.0):.6g}") for each in plan.exposures]
    if plan.strip is not None:
        found["strip"] = {"file": _STRIP, "scale_std": settings.strip_scale_std}
    return found


def _describe_camera(plan: CapturePlan) -> dict[str, Any]:
    """Return size, format and data-sheet values of the camera."""
    scene = plan.scene
    chain = build_sensor_chain(scene.sensor)
    effects: Mapping[str, Any] = {effect.kind: effect for effect in chain.effects}
    found: dict[str, Any] = {
        "width": scene.camera.width,
        "height": scene.camera.height,
        "bit_depth": int(chain.full_scale).bit_length(),
        "focal_length_px": plan.data_sheet_px,
    }
    if "gain" in effects:
        black = effects["gain"].black_level_dn
        if "gamma" in effects:
            black = round(effects["gamma"].mean_response(black, chain.full_scale), 2)
        found["black_level_dn"] = black
    if "bayer_filter" in effects:
        found["bayer"] = effects["bayer_filter"].order
    if "gamma" in effects:
        found |= {"encoding": "gamma", "gamma": 1 / effects["gamma"].gamma}
    if plan.exposure_time_s is not None:
        found["exposure_time_s"] = plan.exposure_time_s
    if scene.shutter.readout_time_s > 0:
        found["line_time_s"] = scene.shutter.readout_time_s / max(scene.camera.height - 1, 1)
    return found


def _to_tiff(values: NDArray[Any]) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(values).save(stream, format="TIFF")
    return stream.getvalue()


def _to_yaml(values: Mapping[str, Any]) -> bytes:
    # Plain types only, because numbers of NumPy have no YAML form.
    plain = json.loads(json.dumps(values))
    text: str = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    return text.encode()
