"""True parameters of a simulated capture: board, its poses, stage with its errors, and fiducial strip."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, field_validator
from scipy.spatial.transform import Rotation

from scenetruth.camera import Frames, Schedule, Stage, StagePose, Viewpoint, build_sensor_chain
from scenetruth.camera.sensor import GaussianSensor, PhotonConversion
from scenetruth.capture.board_artwork import (
    BoardArtwork,
    BoardKind,
    BoardPrint,
    default_board,
    draw_board,
    draw_dots,
    read_board_print,
)
from scenetruth.capture.board_rendering import BoardLight, PlacedBoard, project_points
from scenetruth.errors import ArgumentError, Problem, SceneError, SceneWarning
from scenetruth.provenance import build_schedule
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from scenetruth.simulation import make_truth
from scenetruth.validated_model import Finite, FrozenModel, NonNegative, Positive
from scenetruth.validation_problems import list_problems

__all__ = ["BoardPose", "CapturePlan", "CaptureSimulation", "FiducialStrip", "plan_capture", "read_settings"]

Array = NDArray[np.float64]
Vector = tuple[Finite, Finite, Finite]

_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
# Tilts of calibrated poses: 35 to 40° determine the focal length best; every fourth pose is nearly frontal.
_TILT_DEG, _TILT_SPREAD_DEG, _FRONTAL_DEG, _FRONTAL_EVERY = 37.5, 2.5, 6.0, 4
_TURN_DEG = 25.0
_DEPTH_SHARE, _LATERAL_SHARE = 0.05, 0.06
_EDGE_PX = 4.0
_PAPER, _FLAT, _INK_SHARE, _BACKGROUND_SHARE = 0.8, 0.7, 0.06, 0.25
_DATA_SHEET_STD = 0.005
_EXPOSURE_S = 0.01  # stated for sensors that have no exposure time
_TWO_EXPOSURES = (0.5, 1.0)
_STRIP_POINTS, _LEAST_STRIP_POINTS, _STRIP_TURN_RAD, _STRIP_NEARER, _STRIP_DOT_PX = 17, 5, 5e-3, 0.02, 12.0


class BoardPose(FrozenModel):
    """Pose of a board: position of the centre of its points, and rotation vector, in world coordinates."""

    position_mm: Vector
    """Position of the centre of the calibration points in mm."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation vector in degrees; (0, 0, 0) faces the camera with u to the right and v down."""


class CaptureSimulation(FrozenModel):
    """Settings of a simulated capture.

    Draws of the board, the strip and the step length have the stated standard deviations.

    See Also
    --------
    scenetruth.capture.simulate_capture : Takes the fields as arguments.

    Examples
    --------
    >>> from scenetruth.capture import CaptureSimulation
    >>> settings = CaptureSimulation(board="dots", poses=12)
    >>> settings.scale_std, settings.dark, settings.flat
    (0.0001, 8, 16)
    """

    board: BoardPrint | BoardKind = "charuco"
    """Calibration board, or only its type: then its size follows from the field of view."""
    poses: Annotated[int, Field(ge=0, le=200)] | Annotated[tuple[BoardPose, ...], Field(max_length=200)] = 8
    """Number of drawn poses of the board, or the poses; 0 for no board."""
    scale_std: Positive = 1e-4
    """Relative standard deviation of the size of the board."""
    warp_mm: NonNegative = 0.02
    """Standard deviation of each coefficient of the flatness error of the board in mm."""
    step_std: NonNegative = 1e-4
    """Relative standard deviation of the step length of the stage."""
    dark: Annotated[int, Field(ge=0, le=1000)] = 8
    """Number of images without light."""
    flat: Annotated[int, Field(ge=0, le=1000)] = 16
    """Number of images of a uniformly bright surface."""
    exposures: Annotated[tuple[Annotated[float, Field(ge=0.01, le=100)], ...], Field(max_length=20)] | None = None
    """Exposure times of dark and flat images as multiples of that of all other images, increasing, with 1 among them;
    ``dark`` and ``flat`` images at each. Empty: that of all other images. Default: 0.5 and 1 if the noise of the sensor
    does not depend on the light, which frames at rest cannot distinguish from an encoding of the values; else empty."""
    static: Annotated[int, Field(ge=0, le=1000)] = 4
    """Number of images of the objects at rest, from the reference camera at rest, for the noise."""
    strip: bool = False
    """Whether a fiducial strip is visible in all images of the objects."""
    strip_scale_std: Positive = 1e-4
    """Relative standard deviation of the size of the strip."""
    distance_mm: Positive | None = None
    """Mean distance of the board in mm; default: mean depth of the objects."""
    noise_seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """Seed of the noise and the fixed patterns of the sensor; default: that of the scene. Captures with another seed
    are repetitions with the same rig, texture and motion."""
    truth_maps: bool = True
    """Whether the folder ``truth`` contains the exact maps."""

    @field_validator("exposures")
    @classmethod
    def _increasing(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value and (list(value) != sorted(set(value)) or 1.0 not in value):
            msg = "must increase, with 1 among them, the exposure of the images"
            raise ValueError(msg)
        return value


def read_settings(values: Mapping[str, Any]) -> CaptureSimulation:
    """Return validated settings; raises `ArgumentError` with every problem."""
    problems, plain = list[Problem](), dict(values)
    board = plain.get("board")
    if isinstance(board, Mapping):
        try:
            plain["board"] = read_board_print(board)
        except ArgumentError as error:
            problems += error.problems
            del plain["board"]
    try:
        settings = CaptureSimulation.model_validate(plain)
    except ValidationError as error:
        problems += list_problems(error, plain, model=CaptureSimulation)
    if problems:
        raise ArgumentError(problems, source="a simulated capture")
    return settings


@dataclass(frozen=True, eq=False)
class FiducialStrip:
    """Fiducial strip: nominal points in its own frame, shape (n, 3), and the placed artwork of its dots."""

    points_mm: Array
    placed: PlacedBoard
    plates: tuple[dict[str, Any], ...]
    """Plates of the strip as objects of a scene file."""


@dataclass(frozen=True, eq=False)
class CapturePlan:
    """True parameters of a simulated capture.

    ``scene``: The scene with listed poses of the stage, and with the plates of the strip.
    ``settings``: Settings with the board that is used.
    ``boards``: The board in every pose; empty without a board.
    ``board_stage``: Stage with the poses of all positions, for the images of the board.
    ``step_scale``: Relative error of the step length.
    ``data_sheet_px``: Focal length as in the data sheet of the lens.
    """

    scene: Scene
    settings: CaptureSimulation
    boards: tuple[PlacedBoard, ...]
    board_stage: Stage
    strip: FiducialStrip | None
    step_scale: float
    distance_mm: float
    data_sheet_px: float

    @property
    def light(self) -> BoardLight:
        """Radiances of the board."""
        paper = _PAPER * _full_radiance(self.scene)
        return BoardLight(_INK_SHARE * paper, paper, _BACKGROUND_SHARE * paper)

    @property
    def flat_radiance(self) -> float:
        """Radiance of the uniformly bright surface; the longest exposure of it is not saturated."""
        return _FLAT * _full_radiance(self.scene) / max((1.0, *self.exposures))

    @property
    def exposures(self) -> tuple[float, ...]:
        """Exposure times of dark and flat images as multiples of that of the images; empty for that of the images."""
        if self.settings.exposures is not None:
            return self.settings.exposures
        sensor = self.scene.sensor
        return _TWO_EXPOSURES if isinstance(sensor, GaussianSensor) and sensor.noise_std and self.settings.flat else ()

    @property
    def exposure_time_s(self) -> float | None:
        """Exposure time of the images; None if neither the sensor has one nor the capture several."""
        effects = build_sensor_chain(self.scene.sensor).effects
        stated = [effect.exposure_time_s for effect in effects if isinstance(effect, PhotonConversion)]
        return stated[0] if stated else _EXPOSURE_S if self.exposures else None

    @property
    def strip_contrast(self) -> float:
        """Reflectance of ink less that of the plate, relative to the plate."""
        return _INK_SHARE - 1.0

    def board_viewpoint(self, pose: int, s: int, s_y: int = 0) -> Viewpoint:
        """Return the pose of the camera for an image of the board; poses are scanned as frames, the first forwards."""
        return self._board_schedule.moment(s, pose, s_y).viewpoint

    def board_rotation(self, pose: int, s: int, s_y: int = 0) -> Array:
        """Return the rotation vector of the camera in rad for an image of the board."""
        return self._board_schedule.moment(s, pose, s_y).rotation_rad

    @property
    def _board_schedule(self) -> Schedule:
        seed = self.scene.seed
        return Schedule(self.board_stage, Frames(count=len(self.boards)), partial(generator_for, seed, "board_stage"))


def plan_capture(scene: Scene, settings: CaptureSimulation) -> CapturePlan:
    """Draw the true parameters of a capture of a scene."""
    scene.require_grey("a simulated capture")
    draw = partial(generator_for, scene.seed, "capture")
    _check_scene(scene, settings)
    mean_depth, nearest = _measure_depth(scene)
    distance = settings.distance_mm or mean_depth
    step_scale = settings.step_std * float(draw("step").standard_normal())
    guides = _guide_poses(scene)
    x_um = 1e3 * step_scale * np.tile(scene.stage.x_mm, scene.stage.rows)
    base = [
        guide.model_copy(update={"x_um": guide.x_um + along})
        for guide, along in zip(guides, x_um.tolist(), strict=True)
    ]
    board_stage = _stage(scene, base, None)
    true_stage = _stage(scene, base, _visit_poses(scene, guides))
    strip = _make_strip(scene, settings, nearest, draw("strip")) if settings.strip else None
    plates = () if strip is None else strip.plates
    plain = scene.to_dict() | {"stage": true_stage.model_dump(mode="json")}
    plain["objects"] = [*plain["objects"], *plates]
    true_scene = Scene.from_dict(plain)
    settings, boards = _place_boards(true_scene, settings, distance, draw)
    factor = 1 + _DATA_SHEET_STD * float(draw("data_sheet").standard_normal())
    focal = float(f"{scene.camera.focal_px * factor:.4g}")
    plan = CapturePlan(true_scene, settings, boards, board_stage, strip, step_scale, distance, focal)
    _check_points(plan)
    return plan


_COARSE_PX = 64


def _measure_depth(scene: Scene) -> tuple[float, float]:
    """Return the mean depth of the reference image, and the smallest depth of all frames, in mm."""
    coarse = scene.model_copy(update={"camera": scene.camera.shrunk_to(_COARSE_PX)})
    with warnings.catch_warnings():
        # Warnings of the scene concern images of its own size.
        warnings.simplefilter("ignore", SceneWarning)
        depth = make_truth(coarse)["depth"]
    return float(depth.sel(t=0).mean()), float(depth.min())


def _check_scene(scene: Scene, settings: CaptureSimulation) -> None:
    """Raise for scenes whose images cannot be those of a laboratory."""
    problems, chain = [], build_sensor_chain(scene.sensor)
    if chain.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        message = "must return digital numbers of 8 to 16 bits; specify a sensor with a bit depth, such as "
        problems.append(Problem("sensor", message + "{kind: emva1288, preset: industrial_cmos}"))
    taken = {"strip_upper", "strip_lower"} & {item.name for item in scene.objects}
    if settings.strip and taken:
        problems.append(Problem("objects", f"must not use the name {min(taken)}, which the strip has"))
    if problems:
        raise SceneError(problems)


def _full_radiance(scene: Scene) -> float:
    limit = build_sensor_chain(scene.sensor).saturation_radiance
    return limit if math.isfinite(limit) else 1.0


def _guide_poses(scene: Scene) -> list[StagePose]:
    """Return the errors of all positions that repeat at every visit, row by row: listed, or drawn."""
    if scene.stage.poses is not None:
        return [pose.model_copy(update={"visits": None}) for pose in scene.stage.poses]
    found = []
    for off, turn in (rows[0] for rows in _deviations(scene)):
        found.append(_pose(off * (0.0, 1.0, 1.0), turn))
    return found


def _deviations(scene: Scene) -> list[list[tuple[Array, Array]]]:
    """Return displacement in µm from the tilted axis and rotation vector in rad, by position and frame."""
    stage = scene.stage
    schedule, found = Schedule(stage, scene.frames, partial(generator_for, scene.seed, "stage")), []
    tilt = 1e-6 * np.array([0.0, *(stage.axis_tilt_urad or (0.0, 0.0))])
    for s_y in stage.s_y.tolist():
        for s, x_mm in zip(stage.s.tolist(), stage.x_mm.tolist(), strict=True):
            rows = []
            for t in scene.frames.t.tolist():
                moment, nominal = schedule.moment(s, t, s_y), schedule.nominal(s, t, s_y)
                off = moment.viewpoint.position_mm - nominal.viewpoint.position_mm - x_mm * tilt
                rows.append((1e3 * off, moment.rotation_rad))
            found.append(rows)
    return found


def _pose(off_um: Array, turn_rad: Array) -> StagePose:
    names = ("x_um", "y_um", "z_um", "pitch_urad", "yaw_urad", "roll_urad")
    # Rounding errors of differences are below 1e-8 µm and µrad.
    values = np.round(np.concatenate([off_um, 1e6 * turn_rad]), 7).tolist()
    return StagePose.model_validate(dict(zip(names, values, strict=True)))


def _visit_poses(scene: Scene, guides: Sequence[StagePose]) -> list[list[dict[str, float]]] | None:
    """Return the differences of all visits from the guide errors of their positions; None without any."""
    found = []
    for rows, guide in zip(_deviations(scene), guides, strict=True):
        visits = [_pose(off - guide.offset_um, turn - guide.rotation_rad) for off, turn in rows]
        found.append(
            [{name: value for name, value in visit.model_dump().items() if name != "visits" and value != 0}
             for visit in visits]
        )  # fmt: skip
    return found if any(any(rows) for rows in found) else None


def _stage(scene: Scene, base: Sequence[StagePose], visits: list[list[dict[str, float]]] | None) -> Stage:
    """Return the stage of a scene with listed poses."""
    plain: dict[str, Any] = scene.stage.model_dump(mode="json")
    poses: list[dict[str, Any]] = [pose.model_dump(mode="json", exclude={"visits"}) for pose in base]
    if visits is not None:
        poses = [{**pose, "visits": rows} for pose, rows in zip(poses, visits, strict=True)]
    if any(any(value for value in pose.values()) for pose in poses):
        plain["poses"] = poses
    try:
        return Stage.model_validate(plain)
    except ValidationError as error:
        message = f"gives positions that the stage cannot have: {error.errors(include_url=False)[0]['msg']}"
        raise ArgumentError([Problem("step_std", message)], source="a simulated capture") from error


def _field_mm(scene: Scene, distance_mm: float) -> Array:
    """Return width and height of the field of view at a distance in mm."""
    return np.array([scene.camera.width, scene.camera.height]) / scene.camera.focal_px * distance_mm


def _place_boards(
    scene: Scene, settings: CaptureSimulation, distance_mm: float, draw: Any
) -> tuple[CaptureSimulation, tuple[PlacedBoard, ...]]:
    """Return the settings with their board, and the board in all poses."""
    count = settings.poses if isinstance(settings.poses, int) else len(settings.poses)
    if count == 0:
        return settings, ()
    given = settings.board
    board = given
    if isinstance(board, str):
        width, height = _field_mm(scene, distance_mm).tolist()
        board = default_board(board, (width, height), float(np.ptp(scene.stage.x_mm)))
    artwork, generator = draw_board(board), draw("board")
    scale = settings.scale_std * float(generator.standard_normal())
    warp = tuple((settings.warp_mm * generator.standard_normal(3)).tolist())
    poses: Sequence[BoardPose]
    if isinstance(settings.poses, int):
        poses = [_draw_pose(scene, distance_mm, number, draw("pose", number)) for number in range(count)]
    else:
        poses = settings.poses
    placed = tuple(
        PlacedBoard(
            artwork,
            Rotation.from_rotvec(pose.rotation_deg, degrees=True).as_matrix(),
            np.array(pose.position_mm),
            scale,
            (warp[0], warp[1], warp[2]),
        )
        for pose in poses
    )
    return settings.model_copy(update={"board": board, "poses": tuple(poses)}), placed


def _draw_pose(scene: Scene, distance_mm: float, number: int, generator: np.random.Generator) -> BoardPose:
    """Draw one pose: tilted about directions that are spread evenly, with different depths and places."""
    spread = generator.uniform(-1, 1, 6)
    frontal = number % _FRONTAL_EVERY == _FRONTAL_EVERY - 1
    tilt = np.deg2rad(_FRONTAL_DEG if frontal else _TILT_DEG + _TILT_SPREAD_DEG * spread[0])
    azimuth = _GOLDEN_ANGLE * number + 0.3 * spread[1]
    turn = Rotation.from_rotvec([0, 0, np.deg2rad(_TURN_DEG * spread[2])])
    rotation = Rotation.from_rotvec(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0])) * turn
    lateral = _LATERAL_SHARE * _field_mm(scene, distance_mm) * spread[3:5]
    depth = distance_mm * (1 + _DEPTH_SHARE * ((number % 3) - 1 + 0.2 * spread[5]))
    c_x, c_y = scene.camera.principal_point
    # The middle of the image, where the principal point may be elsewhere.
    middle = np.array([(scene.camera.width - 1) / 2 - c_x, (scene.camera.height - 1) / 2 - c_y])
    place = middle * depth / scene.camera.focal_px + lateral
    return BoardPose(
        position_mm=(float(place[0]), float(place[1]), float(depth)),
        rotation_deg=tuple(np.rad2deg(rotation.as_rotvec()).tolist()),
    )


def _check_points(plan: CapturePlan) -> None:
    """Raise if points that must be visible are outside an image."""
    problems, scene = [], plan.scene
    places = [(s_y, s) for s_y in scene.stage.s_y.tolist() for s in scene.stage.s.tolist()]
    board_print = plan.settings.board
    whole = not isinstance(board_print, str) and board_print.kind != "charuco" and board_print.markers is None
    for number, board in enumerate(plan.boards):
        views = [plan.board_viewpoint(number, s, s_y) for s_y, s in places]
        corners = board.to_world(board.artwork.plate[0])
        if not all((view.to_camera(corners)[:, 2] > 0).all() for view in views):
            problems.append(Problem(f"poses.{number}", "must lie in front of the camera with the whole board"))
            continue
        if not all((board.position_mm - view.position_mm) @ board.rotation[:, 2] > 0 for view in views):
            problems.append(Problem(f"poses.{number}", "shows the back of the board; turn it by 180° about u or v"))
            continue
        inside = [_inside(scene, project_points(scene.camera, view, board)) for view in views]
        worst = min(float(one.mean()) for one in inside)
        if (whole and worst < 1) or worst < 0.25:
            need = "all" if whole else "a quarter"
            message = f"must have {need} of its points inside all images; {100 * worst:.0f} % are in one of them"
            problems.append(Problem(f"poses.{number}", f"{message}; use a smaller board or another pose"))
    if plan.strip is not None:
        schedule = build_schedule(scene)
        views = [schedule.moment(s, t, s_y).viewpoint for s_y, s in places for t in scene.frames.t.tolist()]
        pixels = [project_points(scene.camera, view, plan.strip.placed) for view in views]
        if not all(_inside(scene, each).all() for each in pixels):
            message = "has points outside an image; use a weaker lens distortion, or no strip"
            problems.append(Problem("strip", message, True))
    if problems:
        raise ArgumentError(problems, source="a simulated capture")


def _inside(scene: Scene, pixels: Array) -> NDArray[np.bool_]:
    """Return which positions are inside the image with a border of a few pixels."""
    size = np.array([scene.camera.width, scene.camera.height])
    return np.asarray(((pixels > _EDGE_PX) & (pixels < size - 1 - _EDGE_PX)).all(axis=-1))


def _make_strip(
    scene: Scene, settings: CaptureSimulation, nearest_mm: float, generator: np.random.Generator
) -> FiducialStrip:
    """Return a strip of two rows of dots along the upper and lower border of all images, in front of all objects."""
    camera, depth = scene.camera, nearest_mm * (1 - _STRIP_NEARER)
    per_mm = camera.focal_px / depth
    travel = np.abs(scene.stage.x_mm).max() * per_mm, np.abs(scene.stage.y_mm).max() * per_mm
    dot = _STRIP_DOT_PX
    reach = [
        (size - 1) / 2 - shift - 2 * dot for size, shift in zip((camera.width, camera.height), travel, strict=True)
    ]
    count = min(_STRIP_POINTS, int(max(reach[0], 0.0) / dot) + 1)
    if count < _LEAST_STRIP_POINTS or reach[1] < 4 * dot:
        message = f"does not fit into all images: {_LEAST_STRIP_POINTS} dots of {dot:g} px in a row need more width "
        message += "than all positions of the stage have in common; use a larger image, a shorter stage, or no strip"
        raise ArgumentError([Problem("strip", message, True)], source="a simulated capture")
    columns = np.linspace(-reach[0], reach[0], count) / per_mm
    rows = np.array([-reach[1], reach[1]]) / per_mm
    flat = np.array([[x, y] for y in rows for x in columns])
    # Nominal lengths are measured to 1 µm.
    flat = np.round(flat, 3)
    artwork = draw_dots(flat, dot / per_mm, dot / per_mm)
    scale = settings.strip_scale_std * float(generator.standard_normal())
    rotation = Rotation.from_rotvec(_STRIP_TURN_RAD * generator.standard_normal(3))
    c_x, c_y = camera.principal_point
    middle = np.array([(camera.width - 1) / 2 - c_x, (camera.height - 1) / 2 - c_y]) / per_mm
    placed = PlacedBoard(artwork, rotation.as_matrix(), np.array([*middle, depth]), scale)
    plates = tuple(
        _plate(scene, name, placed, artwork, float(row), dot / per_mm)
        for name, row in zip(("strip_upper", "strip_lower"), rows, strict=True)
    )
    return FiducialStrip(np.column_stack([flat, np.zeros(len(flat))]), placed, plates)


def _plate(
    scene: Scene, name: str, placed: PlacedBoard, artwork: BoardArtwork, row_mm: float, dot_mm: float
) -> dict[str, Any]:
    """Return the plate behind one row of dots as an object of a scene file."""
    turn = Rotation.from_matrix(placed.rotation).as_rotvec(degrees=True)
    angle = float(np.linalg.norm(turn))
    width = float(np.ptp(artwork.points_mm[:, 0]) + 3 * dot_mm)
    centre = placed.to_world(artwork.centre_mm * (1, 0) + np.array([0.0, row_mm]))
    return {
        "name": name,
        "mesh": {"kind": "plane", "size_mm": [width, 2.5 * dot_mm]},
        "texture": {"kind": "uniform", "radiance": _PAPER * min(_full_radiance(scene), 1.0)},
        "pose": {
            "position_mm": [float(x) for x in centre],
            "rotations": [{"axis": [float(x) for x in turn / angle], "angle_deg": angle}],
        },
    }
