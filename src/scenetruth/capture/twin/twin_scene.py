"""Scene of a twin: the rig of a capture, with the surfaces, motions and textures that were measured with it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.capture_calibration import CALIBRATION_FILE
from scenetruth.capture.capture_file import Capture, CaptureLike
from scenetruth.capture.folder_reading import CaptureFolder, open_capture
from scenetruth.capture.rectification import Geometry, calibration_problems
from scenetruth.capture.twin.measured_motion import MeasuredMotion, fit_motion
from scenetruth.capture.twin.measured_surface import Canvas, GridMesh, SurfacePart, find_parts, mesh_part
from scenetruth.capture.twin.surface_texture import (
    ImageMean,
    ImageSet,
    NoiseLine,
    average_images,
    fit_noise_line,
    make_texture,
)
from scenetruth.capture.twin.twin_rig import SensorModel, TwinRig, describe_sensor, make_rig
from scenetruth.errors import CaptureError, Problem, SceneError
from scenetruth.output import OwnershipResult, check_output, write_atomically
from scenetruth.progress import Progress
from scenetruth.scene import Scene, load_scene
from scenetruth.scene.mesh.mesh_file import load_mesh_file
from scenetruth.schema import STATUS_VALID
from scenetruth.simulation import make_truth
from scenetruth.storage import RECORDING, is_store, open_store, store_name

__all__ = [
    "SCENE_FILE",
    "MeasuredRun",
    "Twin",
    "check_mesh",
    "find_calibration",
    "make_twin",
    "open_run",
    "twin_problems",
]

Floats = NDArray[np.float64]

SCENE_FILE = "scene.yaml"
"""Name of the scene file in the folder of a twin."""

_MARGIN_PX = 20
_FINE_PX, _STEP_PX = 400, 2
_SEED = 20
_SAME_FOCAL = 1e-6
_FREE_PX, _LEAST_FREE, _LEAST_DIFFERENCE = 4, 200, 0.03
_OWN = re.compile(r"scene\.yaml|surface_\d+(\.ply|\.obj|\.png|_positions\.npy)")


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """Recording and estimate of a run directory.

    ``recording``: Images, opened lazily. ``estimate``: Depth and motion. ``method``: Name of the method.
    ``settings``: Its settings. ``file``: The store of the estimate.
    """

    recording: xr.Dataset
    estimate: xr.Dataset
    method: str
    settings: Mapping[str, Any]
    file: Path

    def map(self, name: str) -> Floats | None:
        """Return a map of the reference frame, components first, NaN where invalid; None if it is missing."""
        if name not in self.estimate:
            return None
        values = self.estimate[name].sel(t=0)
        status = "status_disparity" if name.startswith(("depth", "disparity")) else "status_motion"
        found = values.values.astype(np.float64)
        if status in self.estimate:
            found = np.where(self.estimate[status].sel(t=0).values == STATUS_VALID, found, np.nan)
        return found

    def pixel_std(self, name: str) -> Floats | None:
        """Return the standard deviation of a quantity without the part that pixels have in common."""
        total, common = self.map(f"{name}_std"), self.map(f"{name}_std_common")
        if total is None or common is None:
            return total
        return np.sqrt(np.maximum(total**2 - np.nan_to_num(common) ** 2, 0.0))


@dataclass(frozen=True, eq=False)
class Twin:
    """Simulated copy of a measurement.

    Attributes
    ----------
    folder
        Folder with ``scene.yaml`` and the files of its surfaces.
    scene
        The scene.
    rig
        Camera and stage, with the frame of the recording.
    sensor
        Sensor, with the origin of its noise.
    motions
        Type of motion of every surface, by name.
    notes
        Differences from the measurement that could not be represented.

    See Also
    --------
    make_twin : Makes it.

    Examples
    --------
    >>> from scenetruth.capture import Twin
    >>> sorted(Twin.__dataclass_fields__)
    ['folder', 'motions', 'notes', 'rig', 'scene', 'sensor']
    """

    folder: Path
    scene: Scene
    rig: TwinRig
    sensor: SensorModel
    motions: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def open_run(run: str | Path, method: str | None = None) -> MeasuredRun:
    """Open the recording and one estimate of a run directory.

    Raises
    ------
    CaptureError
        If a store is missing, or there are several estimates and no method is given.
    """
    folder, problems = Path(run), []
    stores = [folder / store_name(RECORDING, zipped=zipped) for zipped in (False, True)]
    recording = next((store for store in stores if is_store(store)), None)
    if recording is None:
        message = "has no recording; write one: scenetruth capture import FOLDER -o RUN"
        problems.append(Problem("run", message, str(folder)))
    patterns = (store_name("estimate*", zipped=zipped) for zipped in (False, True))
    estimates: dict[str, tuple[Path, xr.Dataset]] = {}
    for store in sorted(store for pattern in patterns for store in folder.glob(pattern)):
        found = open_store(store, kind="estimate")
        estimates.setdefault(str(found.attrs.get("method", "external")), (store, found))
    if method is None and len(estimates) > 1:
        problems.append(Problem("method", f"must be one of the estimates of {folder}: {', '.join(estimates)}"))
    elif method is not None and method not in estimates:
        listed = f"; it has {', '.join(estimates)}" if estimates else ""
        problems.append(Problem("method", f"has no estimate in {folder}{listed}", method))
    elif not estimates:
        message = f"has no estimate; compute one: scenetruth estimate {folder} --method refined"
        problems.append(Problem("run", message, str(folder)))
    if problems or recording is None:
        raise CaptureError(problems, source=folder)
    name = method or next(iter(estimates))
    store, estimate = estimates[name]
    problems += [
        Problem(store.name, f"lacks {each}", sorted(map(str, estimate.data_vars)))
        for each in ("depth",)
        if each not in estimate
    ]
    if 0 not in estimate["t"].values:
        problems.append(Problem(store.name, "lacks the reference frame t = 0", estimate["t"].values.tolist()))
    if problems:
        raise CaptureError(problems, source=folder)
    settings = json.loads(estimate.attrs.get("settings", "{}"))
    return MeasuredRun(open_store(recording, kind="recording"), estimate, name, settings, store)


def find_calibration(run: MeasuredRun, calibration: RigCalibration | str | Path | None) -> RigCalibration | None:
    """Return a calibration, that of a file, or that of the run directory with which its recording was rectified.

    Raises
    ------
    CaptureError
        If the recording is rectified, and there is no calibration.
    """
    if isinstance(calibration, RigCalibration):
        return calibration
    if calibration is None:
        if run.recording.attrs.get("geometry") != "rectified":
            return None
        calibration = run.file.parent / CALIBRATION_FILE
        if not calibration.exists():
            message = f"is missing: the recording was rectified by one, and {run.file.parent} has none"
            raise CaptureError([Problem("calibration", message)], source=run.file.parent)
    return RigCalibration.load(calibration)


def make_twin(
    capture: CaptureLike,
    run: str | Path,
    output: str | Path,
    *,
    calibration: RigCalibration | str | Path | None = None,
    method: str | None = None,
    mesh: str | Path | None = None,
    seed: int = _SEED,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Twin:
    """Make the twin of a measurement: a scene of the same rig with the measured surface, motion and texture.

    Camera, lens and stage are those of the calibration, the sensor has the noise of the dark frames and flat fields of
    the capture, or else of its images. Depth is smoothed within its uncertainty, cut at discontinuities and meshed.
    Every surface has the simplest motion that agrees with the measured velocities, and the mean of all images as
    texture, without the noise that remains in it.

    Parameters
    ----------
    capture
        Folder with a ``capture.yaml``, the path of such a file, or a capture.
    run
        Run directory with the recording that was imported from the capture, and an estimate of it.
    output
        Folder of the twin: ``scene.yaml`` with meshes, textures and vertex positions.
    calibration
        Calibration of the rig, or its file; default: ``calibration.yaml`` of the run directory if its recording is
        rectified, else an ideal stage and the camera of the capture file.
    method
        Method whose estimate is used; required if the run directory contains several.
    mesh
        Mesh file of the surface in mm, in the frame of the recording, in place of the estimated depth.
    seed
        Seed of the noise of the scene.
    overwrite
        Replace an existing twin.
    progress
        Called with (what, done, total).

    Returns
    -------
    Twin
        The twin, with notes on what it does not represent.

    Raises
    ------
    CaptureError
        If the capture, the run or the calibration cannot be used, or do not belong together; lists every problem.
    SceneError
        If the mesh cannot be read.
    OutputExistsError
        If the folder exists already.

    See Also
    --------
    run_twin : Also simulates the twin and predicts the errors of the measurement.

    Notes
    -----
    Lens blur and motion blur are part of the texture. Motion is constant over the frames: the velocity at t = 0.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     make_twin({"camera": {"width": 640}}, "run", "twin")
    ... except st.CaptureError as error:
    ...     print(len(error.problems) > 0)
    True
    """
    folder, measured, rig = open_measurement(capture, run, calibration, method, mesh)
    check_output(output, overwrite=overwrite, claim=claim_twin)
    making = _Making(folder, measured, rig, seed, progress)
    with write_atomically(output, overwrite=overwrite, claim=claim_twin) as partial:
        partial.mkdir()
        plain = making.write(partial, None if mesh is None else Path(mesh))
        text = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
        (partial / SCENE_FILE).write_text(text, encoding="utf-8")
        # A scene that cannot be loaded is not kept.
        load_scene(partial / SCENE_FILE)
    place = Path(output)
    return Twin(place, load_scene(place / SCENE_FILE), making.rig, making.sensor, making.motions, tuple(making.notes))


def open_measurement(
    capture: CaptureLike,
    run: str | Path,
    calibration: RigCalibration | str | Path | None,
    method: str | None,
    mesh: str | Path | None,
    *,
    repeatable: bool = False,
) -> tuple[CaptureFolder, MeasuredRun, RigCalibration | None]:
    """Return capture, run and calibration of a measurement; raise if they do not belong together.

    ``repeatable``: Whether the method must be installed.
    """
    folder, measured = open_capture(capture), open_run(run, method)
    rig = find_calibration(measured, calibration)
    problems = twin_problems(folder, rig, measured)
    if repeatable and measured.method == "external":
        message = "is of a program that is not installed as a method; estimate with an installed one"
        problems.append(Problem("method", message, measured.method))
    if problems:
        raise CaptureError(problems, source=folder.capture.folder)
    check_mesh(mesh)
    return folder, measured, rig


def check_mesh(mesh: str | Path | None) -> None:
    """Raise if a mesh file cannot be read."""
    if mesh is None:
        return
    try:
        load_mesh_file(Path(mesh))
    except SceneError as error:
        raise SceneError([Problem("mesh", each.message, str(mesh)) for each in error.problems]) from error


def claim_twin(path: Path) -> OwnershipResult:
    """Claim the folder of a twin."""
    if not (path / SCENE_FILE).is_file():
        return OwnershipResult("is a directory that scenetruth did not write" if path.is_dir() else "is a file")
    return OwnershipResult(foreign=tuple(entry.name for entry in path.iterdir() if not _OWN.fullmatch(entry.name)))


def twin_problems(folder: CaptureFolder, calibration: RigCalibration | None, run: MeasuredRun) -> list[Problem]:
    """Return why a calibration or a run is not that of a capture."""
    capture, problems = folder.capture, list[Problem]()
    if calibration is not None:
        geometry: Geometry = "rectified" if run.recording.attrs.get("geometry") == "rectified" else "recorded"
        pixels, x_mm = folder.images.pixels, folder.positions_mm()
        problems += calibration_problems(capture, calibration, pixels, geometry, x_mm)
    sizes = run.recording["image"].sizes
    pixels = capture.camera.pixels
    height, width = pixels.shape(capture.camera.height, capture.camera.width)
    pairs = (
        ("camera.width", width, sizes["x"], "columns"),
        ("camera.height", height, sizes["y"], "rows"),
        ("stage.positions", capture.stage.positions, sizes["s"], "positions"),
        ("stage.rows", capture.stage.rows, sizes.get("s_y", 1), "rows of positions"),
        ("frames.count", capture.frames.count, sizes["t"], "frames"),
    )
    for path, expected, present, noun in pairs:
        if expected != present:
            message = f"does not fit the recording, which has {present} {noun}; import the capture again"
            problems.append(Problem(path, message, expected))
    problems += _lens_problems(capture, calibration, run)
    if (height, width) != (capture.camera.height, capture.camera.width):
        message = "must be 'mosaic' for a twin, whose camera has all pixels of the sensor"
        problems.append(Problem("camera.plane", message, pixels.plane))
    return problems


def _lens_problems(capture: Capture, calibration: RigCalibration | None, run: MeasuredRun) -> list[Problem]:
    """Return whether a recording was imported with another camera than that of a capture or a calibration."""
    if calibration is not None:
        focal, path = calibration.value("f"), "calibration"
    else:
        try:
            focal, path = capture.camera.to_camera().focal_px, "camera.focal_length_px"
        except ValueError as error:
            return [Problem("camera.focal_length_px", str(error))]
    present = float(run.recording.attrs["focal_length_px"])
    if abs(present / focal - 1) < _SAME_FOCAL:
        return []
    message = f"is not that of the recording, which has f = {present:.6g} px; "
    message += "import the capture again, or give the calibration with which it was imported"
    return [Problem(path, message, float(f"{focal:.6g}"))]


class _Making:
    """The parts of a scene and its files."""

    def __init__(
        self,
        folder: CaptureFolder,
        run: MeasuredRun,
        calibration: RigCalibration | None,
        seed: int,
        progress: Progress | None,
    ) -> None:
        self.folder, self.run, self.seed, self.progress = folder, run, seed, progress
        self.images = ImageSet.of(run.recording)
        self.canvas = Canvas(self.images.camera, _MARGIN_PX)
        self.rig = make_rig(folder.capture, calibration, run.recording)
        self.notes: list[str] = []
        self.motions: dict[str, str] = {}
        if "channel" in run.recording["image"].dims:
            self.notes.append("the twin is grey: colours are averaged")
        if folder.images.missing:
            self.notes.append(f"the twin has the {len(folder.images.missing)} images that are missing in the capture")
        self.sensor: SensorModel

    def write(self, place: Path, mesh: Path | None) -> dict[str, Any]:
        """Write all files of the scene but its own; return the scene as plain values."""
        self._say(0)
        parts = self._parts() if mesh is None else [self._given_part(mesh)]
        motions = [self._motion(part) for part in parts]
        self._say(1)
        means = average_images(self.images, self.canvas, parts, motions)
        self._say(2)
        seen = fit_noise_line(means)
        raw = None if seen is None else seen.divided(self.images.noise_transfer)
        self.sensor = describe_sensor(self.folder, raw)
        objects = []
        for part, motion, mean in zip(parts, motions, means, strict=True):
            entry = self._write_object(place, part, motion, mean, self.sensor.noise, mesh)
            if entry is not None:
                objects.append(entry)
        self._say(3)
        capture = self.folder.capture
        plain: dict[str, Any] = {
            "format": 1,
            "description": f"Twin of: {capture.description or capture.folder.name}",
            "camera": self.rig.camera,
            "stage": self.rig.stage,
            "frames": {"count": capture.frames.count, "frame_interval_s": capture.frames.frame_interval_s},
            "objects": objects,
            "background": self._background(parts),
            "sensor": self.sensor.section,
            "render": {"backend": "raycast"},
            "estimate": {"method": self.run.method, **self.run.settings},
            "seed": self.seed,
        }
        if capture.camera.line_time_s > 0:
            readout = capture.camera.line_time_s * (capture.camera.height - 1)
            plain["shutter"] = {"readout_time_s": readout}
        # Plain types only, because numbers of NumPy have no YAML form.
        return dict(json.loads(json.dumps(plain)))

    def _say(self, done: int) -> None:
        if self.progress is not None:
            self.progress("twin", done, 3)

    def _parts(self) -> list[SurfacePart]:
        depth, std = self.run.map("depth"), self.run.pixel_std("depth")
        assert depth is not None
        capture = self.folder.capture
        reach = float(np.hypot(np.abs(capture.stage.x_mm).max(), np.abs(capture.stage.y_mm).max()))
        if std is None:
            std = np.full(depth.shape, np.nan)
            self.notes.append("the estimate has no depth_std: its depth is smoothed by its own scatter")
        parts = find_parts(self.canvas, depth, std, reach, self._shown(np.isfinite(depth)))
        if not parts:
            message = f"has no surface: {np.isfinite(depth).sum():,} pixels of frame 0 have a valid depth"
            raise CaptureError([Problem(self.run.file.name, message)], source=self.run.file.parent)
        lost = np.isfinite(depth) & ~np.any([self.canvas.crop(part.measured) for part in parts], axis=0)
        if lost.any():
            self.notes.append(f"{int(lost.sum()):,} pixels with a depth belong to no surface of 64 px or more")
        return parts

    def _shown(self, measured: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
        """Return the pixels of the reference image whose brightness differs from that of the background."""
        free = ~ndimage.binary_dilation(measured, iterations=_FREE_PX)
        values = self.images.reference()
        smooth = ndimage.gaussian_filter(np.nan_to_num(values), 1.0)
        if free.sum() < _LEAST_FREE:
            return None
        differs = np.abs(smooth - np.median(smooth[free])) > _LEAST_DIFFERENCE
        return np.asarray(ndimage.binary_closing(differs, iterations=_FREE_PX) & np.isfinite(values))

    def _given_part(self, mesh: Path) -> SurfacePart:
        """Return the surface of a mesh file as seen by the reference camera."""
        camera = self.canvas.camera.without_distortion().refined(1, self.canvas.margin)
        plain = {
            "camera": camera.model_dump(mode="json", exclude_none=True),
            "stage": {"positions": 1, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "objects": [
                {
                    "name": "surface_1",
                    "mesh": {"kind": "file", "file": str(mesh.resolve())},
                    "texture": {"kind": "uniform"},
                }
            ],
        }
        depth = make_truth(Scene.from_dict(plain))["depth"].sel(t=0).values
        if self.canvas.camera.distortion is not None:
            self.notes.append("the depth of the mesh is that of a camera without distortion")
        seen = np.isfinite(depth)
        filled = np.where(seen, depth, float(np.nanmedian(depth)))
        return SurfacePart("surface_1", filled, seen, seen, seen)

    def _motion(self, part: SurfacePart) -> MeasuredMotion:
        velocity, std = self.run.map("velocity"), self.run.pixel_std("velocity")
        points = self.canvas.rays * part.depth_mm[..., None]
        if velocity is None or self.folder.capture.frames.count == 1:
            return fit_motion(points, None, None)
        extended = np.stack([self.canvas.extend(each) for each in velocity])
        extended[:, ~part.measured] = np.nan
        deviation = None if std is None else np.stack([self.canvas.extend(each) for each in std])
        motion = fit_motion(points, extended, deviation)
        if motion.kind == "static":
            self.notes.append(f"{part.name} is at rest: fewer than 50 of its pixels have a velocity")
        return motion

    def _write_object(
        self,
        place: Path,
        part: SurfacePart,
        motion: MeasuredMotion,
        mean: ImageMean,
        noise: NoiseLine,
        mesh: Path | None,
    ) -> dict[str, Any] | None:
        if mesh is None:
            longest = max(self.canvas.camera.width, self.canvas.camera.height)
            grid = mesh_part(part, _STEP_PX if longest <= _FINE_PX else _STEP_PX + 1)
            if grid is None:
                self.notes.append(f"{part.name} is too narrow for a mesh and omitted")
                return None
            points = self.canvas.rays * part.depth_mm[..., None]
            vertices, faces = np.asarray(grid.at_vertices(points)), grid.faces
            texels = _texels(grid, self.canvas)
            velocity = np.asarray(grid.at_vertices(motion.velocity(points)))
        else:
            vertices, faces, texels, velocity = self._given_mesh(mesh, part, motion)
        self.motions[part.name] = motion.kind
        _write_mesh(place / f"{part.name}.ply", vertices, texels, faces)
        _write_texture(place / f"{part.name}.png", make_texture(self.canvas, part, mean, noise, self.seed))
        entry: dict[str, Any] = {
            "name": part.name,
            "mesh": {"kind": "file", "file": f"{part.name}.ply"},
            "texture": {"kind": "image", "file": f"{part.name}.png", "encoding": "linear"},
        }
        entries = motion.to_entries()
        if entries is None:
            frames = self.folder.capture.frames.t
            states = np.stack([motion.positions(vertices, velocity, float(t)) for t in frames])
            np.save(place / f"{part.name}_positions.npy", states)
            entry["deformation"] = [
                {"kind": "nodal", "file": f"{part.name}_positions.npy", "quantity": "positions"}
            ]  # fmt: skip
        elif entries:
            entry["motion"] = entries
        return entry

    def _given_mesh(self, file: Path, part: SurfacePart, motion: MeasuredMotion) -> tuple[Any, Any, Any, Any]:
        """Return vertices, faces, texture coordinates and velocities of a mesh file."""
        mesh = load_mesh_file(file)
        vertices = np.asarray(mesh.vertices_mm, dtype=np.float64)
        pixels = self.canvas.camera.project(vertices) + self.canvas.margin
        height, width = self.canvas.shape
        texels = np.clip((pixels + 0.5) / (width, height), 0.0, 1.0)
        points = self.canvas.rays * part.depth_mm[..., None]
        places = np.where(np.isfinite(pixels), pixels, 0.0)[:, ::-1].T
        field = motion.velocity(points)
        velocity = [ndimage.map_coordinates(field[..., n], places, order=1, mode="nearest") for n in range(3)]
        return vertices, np.asarray(mesh.faces), texels, np.stack(velocity, axis=-1)

    def _background(self, parts: Sequence[SurfacePart]) -> float:
        """Return the median radiance of the reference image without surface."""
        free = ~np.any([self.canvas.crop(part.front) for part in parts], axis=0)
        values = self.images.reference()[free & np.isfinite(self.images.reference())]
        return float(f"{np.clip(np.median(values), 0, 1):.6g}") if values.size else 0.0


def _texels(grid: GridMesh, canvas: Canvas) -> Floats:
    """Return the texture coordinates of vertices, v downwards."""
    height, width = canvas.shape
    return np.asarray((grid.places[:, ::-1] + 0.5) / (width, height))


def _write_mesh(file: Path, vertices: Floats, texels: Floats, faces: NDArray[Any]) -> None:
    """Write a binary PLY file with texture coordinates, whose t is upwards."""
    head = ["ply", "format binary_little_endian 1.0", "comment scenetruth: surface of a twin, in mm"]
    head += [f"element vertex {len(vertices)}", *(f"property double {name}" for name in "xyzst")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    points = np.column_stack([vertices, texels[:, 0], 1 - texels[:, 1]]).astype("<f8")
    corners = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    corners["count"], corners["corners"] = 3, faces
    file.write_bytes("\n".join(head).encode("ascii") + points.tobytes() + corners.tobytes())


def _write_texture(file: Path, radiance: Floats) -> None:
    """Write radiances in [0, 1] as a PNG file of 16 bits."""
    import imageio.v3 as imageio

    values = np.rint(65535 * np.clip(radiance, 0, 1)).astype(np.uint16)
    imageio.imwrite(file, values, extension=".png")
