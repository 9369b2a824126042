"""Built scene: meshes, textures and motion of all objects, evaluated at any time and validated."""

from __future__ import annotations

import os
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import as_number
from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import collect_input_files, describe_missing
from scenetruth.random_streams import generator_for
from scenetruth.scene.band_textures import BandTextures
from scenetruth.scene.deformation import DeformationModel, DeformationStep, Surroundings
from scenetruth.scene.material import MATT, Material
from scenetruth.scene.mesh import MeshFileError, TriangleMesh
from scenetruth.scene.motion import MovedPoints, PointMap, Points, apply, pose_map, to_moved_points
from scenetruth.scene.motion.motion_presets import FRAME_INTERVAL_S
from scenetruth.scene.reference_configuration import (
    AnalyticConfiguration,
    ReferenceConfiguration,
    SheetConfiguration,
    corner_normals,
    make_reference_configuration,
)
from scenetruth.scene.scene_models import Scene, compute_image_times
from scenetruth.scene.scene_object import SceneObject
from scenetruth.scene.taylor import TT, VALUE, Jet, T
from scenetruth.scene.texture import Painted, SurfaceTexture, tint_texture
from scenetruth.scene.texture.procedural_textures import UniformTexture
from scenetruth.scene.vertex_animation import VertexModel

__all__ = [
    "BuiltScene",
    "SceneBody",
    "Snapshot",
    "add_missing_files",
    "build_scene",
    "find_materials",
    "find_motion_problems",
    "make_point_maps",
    "may_send_more",
    "paint_bodies",
]


_LEAST_AREA = 1e-9  # relative area below which a triangle counts as vanished; float64 leaves 1e-16
_UPRIGHT = 1e-6  # relative area below which a triangle is perpendicular to the XY plane and has no sign there


def find_motion_problems(
    scene: Scene,
    where: str,
    thing: SceneObject,
    start: ReferenceConfiguration,
    maps: Sequence[PointMap],
    faces: NDArray[np.int32],
    times: Sequence[float],
) -> list[Problem]:
    """Return the problems of the deformation and motion of an object with initial points, map chain and faces."""
    found: dict[int, Problem] = {}
    last = max((n for n, item in enumerate(maps) if isinstance(item, DeformationStep)), default=-1)
    for t in times:
        at = np.array([float(t)])
        points = start.at(at)
        for item in maps[: last + 1]:
            if not isinstance(item, DeformationStep):
                points = item(points, at)
                continue
            field, message = item.problem(points, at)
            moved = points if field else item(points, at)
            if not field and not all(np.isfinite(coordinate).all() for coordinate in moved):
                message = "coordinates overflow; reduce the rate or the size"
            elif not field and item.entry.in_the_flat:
                message = _inside_out(points, moved, faces)
            if message:
                path = f"{where}.deformation.{item.number}" + (f".{field}" if field else "")
                found.setdefault(item.number, Problem(path, f"{message} (at t = {t:g})"))
                break
            points = moved
    return [found[number] for number in sorted(found)] + _clock_problems(scene, where, thing)


def _inside_out(before: Points, after: Points, faces: NDArray[np.int32]) -> str:
    """Return a message if a map in X and Y inverts or collapses triangles, else an empty string."""
    one, other = _areas(before, faces), _areas(after, faces)
    sides = [_extent(np.broadcast_to(field, before[0].shape), faces) for field in before]
    flat = np.abs(one) > _UPRIGHT * np.max(sides, axis=0) ** 2
    bad = flat & ~(other * np.sign(one) > _LEAST_AREA * np.abs(one))
    count = int(np.count_nonzero(bad))
    return f"inverts or collapses {count} of {len(faces)} triangles" if count else ""


def _extent(field: Any, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the range of a coordinate within each face, several times faster than `numpy.ptp`."""
    a, b, c = (field[faces[:, corner]] for corner in range(3))
    extent: NDArray[np.float64] = np.maximum(np.maximum(a, b), c) - np.minimum(np.minimum(a, b), c)
    return extent


def _areas(points: Points, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return twice the signed areas in the XY plane."""
    x, y = (np.asarray(field)[faces] for field in points[:2])
    areas: NDArray[np.float64] = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    return areas


def _clock_problems(scene: Scene, where: str, item: SceneObject) -> list[Problem]:
    """Return the presets that require one frame per minute but are used at another interval."""
    interval: Any = scene.frames.frame_interval_s
    if interval == FRAME_INTERVAL_S:
        return []
    message = f"requires one frame per minute, but frames.frame_interval_s is {interval:g}: use 60 or specify a rate"
    return [
        Problem(f"{where}.motion.{number}.preset", message, preset)
        for number, motion in enumerate(item.motion)
        if (preset := getattr(motion, "preset", None)) is not None
    ]


_SNAPSHOT_COUNT = 4  # number of snapshots that are cached at any size
_SNAPSHOT_NUMBERS, _MOST_SNAPSHOTS = 1 << 22, 64  # numbers in all cached snapshots, 32 MB, and largest number of them


@dataclass(frozen=True, eq=False)
class SceneBody:
    """One object of a built scene.

    ``uv``, ``uv_back``: Texture coordinates at the corners, shape (m, 3, 2); for the back of faces, None if the same.
    ``maps``: Deformation, pose and motion, in order of application.
    ``materials``, ``material_of``: Materials, and that of every face, shape (m,); None if there is only one.
    """

    name: str
    mesh: TriangleMesh
    start: ReferenceConfiguration
    uv: NDArray[np.float64]
    texture: SurfaceTexture
    maps: Sequence[PointMap]
    uv_back: NDArray[np.float64] | None = None
    materials: tuple[Material, ...] = (MATT,)
    material_of: NDArray[np.int64] | None = None

    @property
    def faces(self) -> NDArray[np.int32]:
        """Vertex indices, shape (m, 3)."""
        return self.mesh.faces

    @cached_property
    def vertices_mm(self) -> NDArray[np.float64]:
        """World positions at t = 0, shape (n, 3)."""
        return self.at(0.0).positions_mm

    def at(self, t: float) -> MovedPoints:
        """Return position, velocity and acceleration of all vertices at time t (in frames)."""
        time = Jet.variable(np.array([float(t)]), 0, 1)
        points = self.start.at(time)
        return to_moved_points(apply(self.maps, points, time), len(points[0]))

    def at_with_rates(self, t: float) -> tuple[MovedPoints, NDArray[np.float64]]:
        """Return `at` and `rates_at` of a time, by one evaluation if the vertices are the surface points."""
        if not isinstance(self.start, SheetConfiguration | AnalyticConfiguration):
            return self.at(t), self.rates_at(t)
        fields = self._surface(t)
        rows = [field[[VALUE, T, TT]] for field in fields]
        return MovedPoints(*(np.stack([row[order] for row in rows], axis=1) for order in range(3))), _rates(fields)

    def rates_at(self, t: float) -> NDArray[np.float64]:
        """Return the diagonal of the rate of deformation at all surface points at time t, 1/frame, shape (k, 3)."""
        return _rates(self._surface(t))

    def positions_at(self, t: float) -> NDArray[np.float64]:
        """Return the vertex positions at time t, shape (n, 3), without velocities and compiled code."""
        time = np.array([float(t)])
        points = self.start.at(time)
        for item in self.maps:
            points = item(points, time)
        return np.column_stack([np.broadcast_to(field, self.mesh.vertices_mm.shape[:1]) for field in points])

    def surface_at(self, t: float) -> NDArray[np.float64]:
        """Return the motion and shape tensors of all surface points at time t, see `surface_tensors`."""
        from scenetruth.scene.surface_tensor_kernels import surface_tensors

        tensors: NDArray[np.float64] = surface_tensors(*self._surface(t))
        return tensors

    def _surface(self, t: float) -> list[NDArray[np.float64]]:
        """Return the coefficients of X, Y and Z of all surface points at time t in t, a and b, shape (10, k) each."""
        time = Jet.variable(np.array([float(t)]), 0, 3)
        points = self.start.surface(time)
        shape = points[0].coefficients.shape
        return [np.broadcast_to(field.coefficients, shape) for field in apply(self.maps, points, time)]


def _rates(fields: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the diagonal of the rate of deformation of surface points, see `SceneBody.rates_at`."""
    from scenetruth.scene.surface_tensor_kernels import DEFORMATION, surface_tensors

    return np.ascontiguousarray(surface_tensors(*fields)[:, DEFORMATION : DEFORMATION + 3])


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Positions of all vertices in mm, velocities per frame and accelerations per frame², (n, 3), at t in frames.

    ``rates``: See `BuiltScene.rates_at`, shape (k, 3); None if they are not expected.
    """

    t: float
    vertices_mm: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]
    rates: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """All objects of a scene with concatenated vertices and faces.

    ``bands``: The same objects with the textures and materials of each band of the camera; empty for a grey camera.
    """

    bodies: tuple[SceneBody, ...]
    bands: tuple[BuiltScene, ...] = ()

    @cached_property
    def vertex_offsets(self) -> NDArray[np.int64]:
        """Index of the first vertex of every body, and the total count."""
        return np.cumsum([0, *(len(body.mesh.vertices_mm) for body in self.bodies)])

    @cached_property
    def face_offsets(self) -> NDArray[np.int64]:
        """Index of the first face of every body, and the total count."""
        return np.cumsum([0, *(len(body.faces) for body in self.bodies)])

    @cached_property
    def faces(self) -> NDArray[np.int32]:
        """Vertex indices of all faces, shape (m, 3)."""
        parts = [body.faces + offset for body, offset in zip(self.bodies, self.vertex_offsets, strict=False)]
        return np.concatenate(parts).astype(np.int32)

    @cached_property
    def uv(self) -> NDArray[np.float64]:
        """Texture coordinates at the corners of all faces, shape (m, 3, 2)."""
        return np.concatenate([body.uv for body in self.bodies])

    @cached_property
    def image_uv(self) -> NDArray[np.float64]:
        """Image-texture coordinates at the corners of all faces, shape (m, 3, 2); NaN for meshes without."""
        parts = [body.mesh for body in self.bodies]
        return np.concatenate([np.full(mesh.chart_mm.shape, np.nan) if mesh.uv is None else mesh.uv for mesh in parts])

    @cached_property
    def chart_mm(self) -> NDArray[np.float64]:
        """Material coordinates in mm at the corners of all faces, shape (m, 3, 2)."""
        return np.concatenate([body.mesh.chart_mm for body in self.bodies])

    @cached_property
    def uv_back(self) -> NDArray[np.float64]:
        """Texture coordinates for the back of all faces, shape (m, 3, 2); ``uv`` if both sides are the same."""
        if all(body.uv_back is None for body in self.bodies):
            return self.uv
        return np.concatenate([body.uv if body.uv_back is None else body.uv_back for body in self.bodies])

    @cached_property
    def crease_deg(self) -> NDArray[np.float64]:
        """Crease angle at every side of every face, shape (m, 3)."""
        return np.concatenate([np.broadcast_to(body.mesh.crease_deg, body.faces.shape) for body in self.bodies])

    @cached_property
    def face_body(self) -> NDArray[np.int32]:
        """Body index of every face, shape (m,)."""
        return np.repeat(np.arange(len(self.bodies), dtype=np.int32), np.diff(self.face_offsets))

    @cached_property
    def materials(self) -> list[tuple[Material, int]]:
        """All materials, each with the body that it belongs to."""
        return [(material, index) for index, body in enumerate(self.bodies) for material in body.materials]

    @cached_property
    def face_material(self) -> NDArray[np.int32]:
        """Index of the material of every face, shape (m,)."""
        offsets = np.cumsum([0, *(len(body.materials) for body in self.bodies)])
        parts = [
            np.full(len(body.faces), offset) if body.material_of is None else body.material_of + offset
            for body, offset in zip(self.bodies, offsets, strict=False)
        ]
        return np.concatenate(parts).astype(np.int32)

    @cached_property
    def surface_corners(self) -> NDArray[np.int32]:
        """Index of the surface point (`surface_at`) at every face corner, shape (m, 3)."""
        counts = [int(body.start.corners.max()) + 1 for body in self.bodies]
        offsets = np.cumsum([0, *counts[:-1]])
        parts = [body.start.corners + offset for body, offset in zip(self.bodies, offsets, strict=True)]
        return np.concatenate(parts).astype(np.int32)

    @cached_property
    def face_smooth(self) -> NDArray[np.bool_]:
        """Whether a face is shaded as part of a smooth surface, shape (m,); see `TriangleMesh.smooth`."""
        return np.repeat([body.mesh.smooth for body in self.bodies], np.diff(self.face_offsets))

    def corner_normals_at(self, t: float) -> NDArray[np.float64]:
        """Return smooth-surface normals at all face corners at time t, (m, 3, 3), sign arbitrary; NaN if flat."""
        return np.concatenate(
            [
                corner_normals(body.mesh, body.start, body.maps, t)
                if body.mesh.smooth
                else np.full((len(body.faces), 3, 3), np.nan)
                for body in self.bodies
            ]
        )

    def at(self, t: float) -> Snapshot:
        """Return all vertices at time t (in frames); recent snapshots are cached and must not be modified."""
        found = self._recent.get(t)
        if found is None:
            if t in self._expected:
                both = [body.at_with_rates(t) for body in self.bodies]
                moved, rates = [one for one, _ in both], np.concatenate([other for _, other in both])
            else:
                moved, rates = [body.at(t) for body in self.bodies], None
            found = Snapshot(
                t,
                np.concatenate([item.positions_mm for item in moved]),
                np.concatenate([item.velocities for item in moved]),
                np.concatenate([item.accelerations for item in moved]),
                rates,
            )
            # Several threads may do the same.
            size = 3 * found.vertices_mm.size + (0 if rates is None else rates.size)
            # Images and truth of a time have its snapshot in common.
            kept = int(np.clip(_SNAPSHOT_NUMBERS // max(size, 1), _SNAPSHOT_COUNT, _MOST_SNAPSHOTS))
            for oldest in list(self._recent)[: 1 - kept]:
                self._recent.pop(oldest, None)
            self._recent[t] = found
        return found

    @cached_property
    def _recent(self) -> dict[float, Snapshot]:
        """Cached snapshots by time, oldest first."""
        return {}

    @cached_property
    def _expected(self) -> set[float]:
        """Times of `expect_rates`."""
        return set()

    def expect_rates(self, times: Iterable[float]) -> None:
        """Compute the rates of deformation at some times together with the vertices, which takes half the time."""
        self._expected.update(times)

    def in_bands(self, bodies: Sequence[tuple[SceneBody, ...]]) -> BuiltScene:
        """Return the scene with the objects of each band, which have the same shapes and motions."""
        bands = tuple(BuiltScene(each) for each in bodies)
        found = BuiltScene(self.bodies, bands)
        for each in (found, *bands):
            # The vertices of a time are computed once.
            each.__dict__["_recent"], each.__dict__["_expected"] = self._recent, self._expected
        return found

    def surface_at(self, t: float) -> NDArray[np.float64]:
        """Return the motion and shape tensors of all surface points at time t, shape (k, 18), see `surface_tensors`."""
        return np.concatenate([body.surface_at(t) for body in self.bodies])

    def rates_at(self, t: float) -> NDArray[np.float64]:
        """Return the diagonal of the rate of deformation at all surface points at time t, 1/frame, shape (k, 3)."""
        return np.concatenate([body.rates_at(t) for body in self.bodies])


def build_scene(
    scene: Scene, folder: Path = Path(), *, painted: bool = True, meshes: Mapping[str, TriangleMesh] | None = None
) -> BuiltScene:
    """Build meshes, textures and motions of a scene; ``meshes``, by names of objects, replace those it describes."""
    bodies: list[SceneBody] = []
    problems: list[Problem] = []
    first, *others = scene.band_scenes()
    for given, (path, item) in zip(scene.parts, first.parts, strict=True):
        count = len(problems)
        # Overflow is detected and reported by the checks.
        with np.errstate(all="ignore"):
            _build(first, path, item, folder, painted, meshes or {}, bodies, problems)
        problems[count:] = [_of_band(problem, given, scene.camera.bands[:1]) for problem in problems[count:]]
    more = [tuple(bodies)] * len(others)
    if painted and not problems:
        more = [
            _repaint(bodies, (scene, first, other), band, folder, problems)
            for band, other in zip(scene.camera.bands[1:], others, strict=True)
        ]
    if problems:
        raise SceneError(add_missing_files(problems, scene, folder))
    world = BuiltScene(tuple(bodies))
    return world if not scene.camera.bands else world.in_bands((world.bodies, *more))


def _of_band(problem: Problem, given: tuple[str, SceneObject], band: Sequence[str]) -> Problem:
    """Return a problem of an object in one band with its path in the scene."""
    path, item = given
    prefix = f"{path}.texture."
    if not isinstance(item.texture, BandTextures) or not problem.path.startswith(prefix):
        return problem
    inside = ".".join(("textures", *band, problem.path.removeprefix(prefix)))
    return Problem(prefix + inside, problem.message, problem.value)


def _repaint(
    bodies: Sequence[SceneBody], scenes: tuple[Scene, Scene, Scene], band: str, folder: Path, problems: list[Problem]
) -> tuple[SceneBody, ...]:
    """Return the bodies with textures and materials of another band, or append problems.

    ``scenes``: The scene with all bands, in the band of the bodies, and in the other band.
    """
    found = []
    for body, given, (_, before), (path, item) in zip(bodies, *(scene.parts for scene in scenes), strict=True):
        painted = Painted(body.texture, body.uv, body.uv_back)
        if (item.texture, item.tint) != (before.texture, before.tint):
            try:
                painted = _paint(scenes[2], item, body.mesh, folder)
            except SceneError as error:
                one = [Problem(f"{path}.texture.{each.path}", each.message, each.value) for each in error.problems]
                problems += [_of_band(problem, given, (band,)) for problem in one]
                continue
        materials, of_face = (body.materials, body.material_of) if item.material.from_file else ((item.material,), None)
        texture, uv, uv_back = painted
        found.append(replace(body, texture=texture, uv=uv, uv_back=uv_back, materials=materials, material_of=of_face))
    return tuple(found)


def _paint(scene: Scene, item: SceneObject, mesh: TriangleMesh, folder: Path) -> Painted:
    """Return the texture of an object of a scene in one band."""
    painted = item.texture.paint(mesh, folder, generator_for(scene.seed, "texture", item.name))
    return painted._replace(texture=tint_texture(painted.texture, as_number(item.tint)))


def may_send_more(scene: Scene, name: str) -> bool:
    """Return whether an object might reflect and transmit more light than it receives, by its tint and material."""
    items = [item for one in scene.band_scenes() for _, item in one.parts if item.name == name]
    return any(
        item.material.from_file
        or as_number(item.tint) > 1
        or as_number(item.material.transmittance) + as_number(item.material.reflectance) > 1
        for item in items
    )


def paint_bodies(scene: Scene, world: BuiltScene, names: Container[str], folder: Path) -> BuiltScene:
    """Return a scene built without textures with the textures and materials of some objects, in all bands."""
    versions = []
    for one in scene.band_scenes():
        items = {item.name: item for _, item in one.parts if item.name in names}
        versions.append(tuple(_painted_body(one, items.get(body.name), body, folder) for body in world.bodies))
    return BuiltScene(versions[0]).in_bands(versions) if scene.camera.bands else BuiltScene(versions[0])


def _painted_body(scene: Scene, item: SceneObject | None, body: SceneBody, folder: Path) -> SceneBody:
    if item is None:
        return body
    try:
        texture, uv, uv_back = _paint(scene, item, body.mesh, folder)
        materials, of_face = find_materials(item, body.mesh)
    except SceneError:
        # Files that cannot be read are reported with the objects.
        return body
    return replace(body, texture=texture, uv=uv, uv_back=uv_back, materials=materials, material_of=of_face)


def add_missing_files(problems: list[Problem], scene: Scene, folder: Path) -> list[Problem]:
    """Return the problems and all further missing files of the objects."""
    values = {problem.path for problem in problems}
    files = [
        (f"{path}.{where}", folder / file) for path, item in scene.parts for where, file in collect_input_files(item)
    ]
    missing = [
        Problem(where, describe_missing(file, "no such file"), str(file))
        for where, file in files
        if not os.path.exists(file)
    ]
    return [*problems, *(problem for problem in missing if problem.path not in values)]


def _build(
    scene: Scene,
    path: str,
    item: SceneObject,
    folder: Path,
    painted: bool,
    meshes: Mapping[str, TriangleMesh],
    bodies: list[SceneBody],
    problems: list[Problem],
) -> None:
    """Append the body of one object, or its problems."""
    part = "mesh"
    try:
        mesh = meshes.get(item.name) or item.mesh.make(folder)
        part = "texture"
        given = item if painted else item.model_copy(update={"texture": UniformTexture(kind="uniform"), "tint": 1.0})
        texture, uv, uv_back = _paint(scene, given, mesh, folder)
        part = "material"
        materials, material_of = find_materials(item, mesh)
        part = "deformation.0"
        first = item.deformation[0] if item.deformation else None
        start = (
            first.start(mesh, folder, scene.frames)
            if isinstance(first, VertexModel)
            else make_reference_configuration(mesh)
        )
    except SceneError as error:
        problems += [
            Problem(f"{path}.{part}.{problem.path}", problem.message, problem.value) for problem in error.problems
        ]
        return
    maps = make_point_maps(item, mesh, scene.frames.frame_interval_s)
    problems += find_motion_problems(scene, path, item, start, maps, mesh.faces, compute_image_times(scene))
    bodies.append(SceneBody(item.name, mesh, start, uv, texture, maps, uv_back, materials, material_of))


def find_materials(item: SceneObject, mesh: TriangleMesh) -> tuple[tuple[Material, ...], NDArray[np.int64] | None]:
    """Return the materials of an object, and that of every face; None if there is only one."""
    if not item.material.from_file:
        return (item.material,), None
    try:
        if mesh.appearance is None:
            msg = "the mesh has no materials; give `refractive_index` and other values, or a `preset`"
            raise MeshFileError(msg)
        found, of_face = mesh.appearance.gloss()
    except MeshFileError as error:
        raise SceneError([Problem("from_file", str(error), value=True)]) from error
    return tuple(Material(**gloss._asdict()) for gloss in found), of_face


def make_point_maps(item: SceneObject, mesh: TriangleMesh, frame_interval_s: float) -> list[PointMap]:
    """Return the deformations (in-plane growth before sheet shape), pose and motions of an object, in order."""
    x = mesh.vertices_mm[:, 0] if mesh.material_mm is None else mesh.material_mm[:, 0]
    around = Surroundings((float(x.min()), float(x.max())), frame_interval_s)
    steps = [
        DeformationStep(number, entry, around, entry.point_map(around))
        for number, entry in enumerate(item.deformation)
        if isinstance(entry, DeformationModel)
    ]
    in_the_flat = [step for step in steps if mesh.shape is not None and step.entry.in_the_flat]
    shape = [] if mesh.shape is None else [mesh.shape]
    rotations = [(rotation.axis, rotation.angle_deg) for rotation in item.pose.rotations]
    return [
        *in_the_flat,
        *shape,
        *(step for step in steps if step not in in_the_flat),
        pose_map(item.pose.position_mm, rotations),
        *(motion.point_map(item.pose.position_mm) for motion in item.motion),
    ]
