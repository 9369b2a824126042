"""Checks of a scene before rendering: image size, disparity, memory, texture wavelength and lighting."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import as_number
from scenetruth.camera import build_sensor_chain
from scenetruth.errors import Problem, SceneError, SceneWarning
from scenetruth.scene.built_scene import BuiltScene, SceneBody, find_materials
from scenetruth.scene.lighting import IesLight, Lamp, Lighting, LightModel, PointLight
from scenetruth.scene.scene_models import Scene, compute_image_times
from scenetruth.scene.texture import TextureModel

__all__ = [
    "ObjectReport",
    "SceneReport",
    "check_scene",
    "describe_scene",
    "find_lighting_problems",
    "find_problems_of_contents",
    "find_setting_problems",
]


# Perturbation that gives a ray direction unlikely to be aligned with edges or faces.
_UNSTEADY = 1e-3
_SHARPEST_GLOSS = 0.03  # roughness whose reflections of wide lamps are exact within 0.2 %
_MOST_RESIDUAL_PX = 2.0
_BRIGHTER = 1e-3  # by which splines may exceed the values of a texture
_GENERIC_DIRECTION = np.array([0.351938, 0.681273, 0.641873])


def find_lighting_problems(scene: Scene, world: BuiltScene, times: Sequence[float] | None = None) -> list[Problem]:
    """Return the problems of a scene's lighting: brightness, lamp files, lamps in objects or at the camera."""
    times = [float(t) for t in scene.frames.t] if times is None else times
    lighting, without, problems = _lamp_problems(scene, times)
    return [*problems, *_lamps_in_objects(lighting, world, times, without)]


def find_setting_problems(scene: Scene) -> list[Problem]:
    """Return the problems that do not depend on the objects: of lens, shutter, backend and lamps."""
    # Overflow is reported as a problem.
    with np.errstate(all="ignore"):
        return [*_camera_problems(scene), *_lamp_problems(scene, [float(t) for t in scene.frames.t])[2]]


def find_problems_of_contents(scene: Scene, world: BuiltScene, times: Sequence[float] | None = None) -> list[Problem]:
    """Return the problems of visibility, lens, shutter, backend, lamps and reflectance; ``world`` may lack objects."""
    return _inspect(scene, world, times).problems


def _lamp_problems(scene: Scene, times: Sequence[float]) -> tuple[Lighting, set[int], list[Problem]]:
    """Return the lamps, the numbers of those without a position, and the problems that do not depend on the objects."""
    # Positions and directions are the same in all bands.
    lighting = scene.band_scenes()[0].lighting
    problems = []
    brightness = [lighting.brightness(t) for t in times]
    if min(brightness) <= 0:
        worst = times[int(np.argmin(brightness))]
        message = f"brightness is {min(brightness):.6g} at frame {worst:g}; it must be positive in all frames"
        problems.append(Problem("lighting.drift_per_frame", message, lighting.drift_per_frame))
    unread = _unread_lamps(lighting)
    # Their positions do not depend on their files.
    placed = tuple(_without_file(light) if n in unread else light for n, light in enumerate(lighting.lights))
    lighting = lighting.model_copy(update={"lights": placed})
    lost = _lost_lamps(lighting, times)
    found = [each for number in sorted(unread) for each in unread[number]]
    problems += [*found, *lost.values(), *_lamps_at_camera(scene, lighting, times, {*lost})]
    return lighting, {*lost}, problems


def _without_file(light: LightModel) -> LightModel:
    """Return a point light in place of a lamp with a photometric file."""
    assert isinstance(light, IesLight)
    given = {"position_mm": light.position_mm, "motion": light.motion, "irradiance": light.irradiance}
    return PointLight(kind="point", reference_distance_mm=light.reference_distance_mm, **given)


def _lamps_in_objects(
    lighting: Lighting, world: BuiltScene, times: Sequence[float], without: set[int]
) -> list[Problem]:
    """Return the problems of lamps inside objects or crossed by them."""
    problems: list[Problem] = []
    if all(lamp.position_mm is None for _, lamp in _lamps_at(lighting, 0.0, without)):
        return []
    closed = [_is_closed(body.positions_at(0.0), body.faces) for body in world.bodies]
    found: set[tuple[int, int]] = set()
    for t in times:
        lamps = [(number, lamp) for number, lamp in _lamps_at(lighting, t, without) if lamp.position_mm is not None]
        for index, body in enumerate(world.bodies):
            if not closed[index] and all(lamp.area is None for _, lamp in lamps):
                continue
            corners = body.positions_at(t)
            for number, lamp in lamps:
                if (number, index) in found:
                    continue
                inside = closed[index] and any(_is_inside(point, corners, body.faces) for point in lamp.outline_mm())
                if not inside and not lamp.is_crossed_by(corners[body.faces]):
                    continue
                found.add((number, index))
                part = "light is inside" if lamp.area is None else "lamp is, at least in part, inside"
                part, remedy = (part, "move it outside") if inside else ("lamp is crossed by", "move it away")
                message = f"the {part} '{body.name}' at frame {t:g}; {remedy}"
                where = tuple(round(float(value), 6) for value in np.asarray(lamp.position_mm))
                problems.append(Problem(f"lighting.lights.{number}.position_mm", message, where))
    return problems


def _reflectance_problems(scene: Scene, world: BuiltScene) -> list[Problem]:
    """Return the problems of surfaces that reflect and transmit more light than they receive, in any band."""
    problems: dict[str, Problem] = {}
    most: dict[str, float] = {}
    bands = [f" in the band '{band}'" for band in scene.camera.bands] or [""]
    for band, one, painted in zip(bands, scene.band_scenes(), world.bands or (world,), strict=False):
        bodies = {body.name: body for body in painted.bodies}
        for path, item in one.parts:
            if item.name not in bodies:
                continue
            body = bodies[item.name]
            # The leaves of a plant have one material, and textures of their own: the brightest of them decides.
            where = path if path.startswith("objects") else ".".join(path.split(".")[:2])
            tint = as_number(item.tint)
            share = max(as_number(each.transmittance) + as_number(each.reflectance) - 1 for each in body.materials)
            if share <= 0 and tint <= 1:
                continue
            rows, columns = body.texture.shape
            u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
            brightest = float(body.texture.radiance(np.column_stack([u.ravel(), v.ravel()])).max())
            sent = brightest * (1 + max(share, 0.0))
            if sent <= max(1 + _BRIGHTER, most.get(where, 0.0)):
                continue
            most[where] = sent
            if brightest > 1 + _BRIGHTER and tint > 1:
                message = f"the texture times the tint reaches {brightest:.3g}{band}, more than 1; "
                message += f"at most {tint / brightest:.3g}"
                problems[where] = Problem(f"{where}.tint", message, tint)
            else:
                message = f"the texture reaches {brightest:.3g}{band}: reflection and transmission add up to "
                message += f"{sent:.3g} of the light, more than 1; at most {1 / brightest - 1:.3g}"
                problems[where] = Problem(f"{where}.material.transmittance", message, item.material.transmittance)
    return list(problems.values())


def _material_warnings(scene: Scene) -> list[str]:
    """Return a warning if no light makes materials visible."""
    if scene.lighting.lit:
        return []
    names = [f"'{item.name}'" for _, item in scene.parts if not item.material.matt]
    if not names:
        return []
    return [f"material: no effect on {', '.join(names)}, because the scene is unlit; add lights or ambient light"]


def _lamps_at(lighting: Lighting, t: float, without: set[int]) -> list[tuple[int, Lamp]]:
    """Return lamps at time t with their numbers, apart from those without a position."""
    return [(number, light.lamp(t)) for number, light in enumerate(lighting.lights) if number not in without]


def _unread_lamps(lighting: Lighting) -> dict[int, list[Problem]]:
    """Return the problems of photometric files by the number of the lamp."""
    problems = {}
    for number, light in enumerate(lighting.lights):
        try:
            light.lamp(0.0)
        except SceneError as error:
            where = f"lighting.lights.{number}"
            problems[number] = [Problem(f"{where}.{each.path}", each.message, each.value) for each in error.problems]
    return problems


def _lamps_at_camera(scene: Scene, lighting: Lighting, times: Sequence[float], without: set[int]) -> list[Problem]:
    """Return the problems of lamps with a size through which the camera looks."""
    found: dict[int, Problem] = {}
    for t in times:
        for number, lamp in _lamps_at(lighting, t, without):
            cameras = product(scene.stage.x_mm, scene.stage.y_mm)
            if any(lamp.contains(np.array([x_mm, y_mm, 0.0])) for x_mm, y_mm in cameras):
                message = f"the camera is on or inside the lamp at frame {t:g}; move the lamp, or use a ring"
                where = tuple(round(float(value), 6) for value in np.asarray(lamp.position_mm))
                found.setdefault(number, Problem(f"lighting.lights.{number}.position_mm", message, where))
    return list(found.values())


def _lamp_warnings(scene: Scene, world: BuiltScene) -> list[str]:
    """Return warnings about lamps with a size in the field of view, and of those that face away from all objects."""
    messages = []
    for number, lamp in enumerate(scene.band_scenes()[0].lighting.lamps_at(0.0)):
        if lamp.area is None or lamp.position_mm is None:
            continue
        outline, where = lamp.outline_mm(), f"lighting.lights.{number}"
        ahead = outline[outline[:, 2] > 0]
        if any(_in_view(scene, point[None]) for point in ahead):
            messages.append(f"{where}: the lamp is in the field of view; images do not show lamps")
        if lamp.area.shape != "sphere":
            sides = [(body.vertices_mm - lamp.position_mm) @ lamp.axis for body in world.bodies]
            if max(float(side.max()) for side in sides) <= 0:
                messages.append(f"{where}: the lamp faces away from all objects; turn it by direction or target_mm")
    return messages


def _gloss_warnings(scene: Scene, world: BuiltScene) -> list[str]:
    """Return warnings of sharp gloss that reflects lamps wider than their distance."""
    # Bodies of a preview may have no materials.
    sharp = _least_roughness(scene, world)
    messages = []
    for number, lamp in enumerate(scene.band_scenes()[0].lighting.lamps_at(0.0)):
        if lamp.area is None or lamp.position_mm is None:
            continue
        reach = float(np.linalg.norm(lamp.outline_mm() - lamp.position_mm, axis=1).max())
        for body in world.bodies:
            roughness = sharp[body.name]
            if roughness < _SHARPEST_GLOSS and lamp.distance_mm(body.vertices_mm[body.faces]) < 2 * reach:
                message = f"lighting.lights.{number}: the lamp is wider than its distance from '{body.name}', whose "
                message += f"roughness of {roughness:g} is below {_SHARPEST_GLOSS:g}: reflections have errors of up to "
                messages.append(f"{message}a third; use a smaller lamp or a rougher surface")
    return messages


def _least_roughness(scene: Scene, world: BuiltScene) -> dict[str, float]:
    """Return the least roughness of objects by name, infinite without gloss."""
    found, items = {}, {item.name: item for _, item in scene.parts}
    for body in world.bodies:
        try:
            materials, _ = find_materials(items[body.name], body.mesh)
            found[body.name] = min(material.least_roughness for material in materials)
        except SceneError:
            # A file without gloss is reported with the objects.
            found[body.name] = np.inf
    return found


def _lost_lamps(lighting: Lighting, times: Sequence[float]) -> dict[int, Problem]:
    """Return the problems of lamps whose position or direction overflows, by number."""
    lost: dict[int, Problem] = {}
    for t in times:
        for number, lamp in _lamps_at(lighting, t, set()):
            directed = lamp.position_mm is None or lamp.directed or _is_flat(lamp)
            shines = not directed or abs(float(np.linalg.norm(lamp.axis)) - 1) < _UNSTEADY
            if not shines or not (lamp.position_mm is None or np.isfinite(lamp.position_mm).all()):
                message = f"position or direction of the light overflows at frame {t:g}; reduce the rate"
                lost.setdefault(number, Problem(f"lighting.lights.{number}.motion", message))
    return lost


def _is_flat(lamp: Lamp) -> bool:
    return lamp.area is not None and lamp.area.shape != "sphere"


def _is_closed(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    _, welded = np.unique(vertices, axis=0, return_inverse=True)
    corners = welded.reshape(-1)[faces]
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    return bool((uses % 2 == 0).all())


def _is_inside(point: NDArray[np.float64], vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    if (point < vertices.min(axis=0)).any() or (point > vertices.max(axis=0)).any():
        return False
    first, second, third = (vertices[faces[:, k]] - point for k in range(3))
    # Signed volumes of the ray and each edge, exactly opposite for adjacent faces, so no ray passes between them.
    volumes = np.stack(
        [np.cross(a, b) @ _GENERIC_DIRECTION for a, b in ((first, second), (second, third), (third, first))]
    )
    normals = np.cross(second - first, third - first)
    slope = normals @ _GENERIC_DIRECTION
    ahead = np.einsum("ij,ij->i", normals, first) * slope > 0
    crossed = ((volumes >= 0).all(axis=0) | (volumes < 0).all(axis=0)) & (slope != 0) & ahead
    return bool(np.count_nonzero(crossed) % 2)


_FINEST_PX = 2.0
_SAME_PX = 0.005  # difference of wavelengths that have the same two decimals
# A thousand kilometres: the resolution is 1e-7 mm in float64, and 64 mm in float32, which the ray search uses.
_FARTHEST_MM = 1e9
_BYTES_OF_TRUTH = 8 * (1 + 3 + 1 + 2 + 3 + 2 + 1 + 1) + 4 + 4 + 1 + 2 + 1 + 1


@dataclass(frozen=True)
class ObjectReport:
    """Expected properties of one object in the images.

    ``depth_mm``: Smallest and largest depth Z over all frames, of the vertices in front of the camera.
    ``disparity_px``: Smallest and largest disparity over all frames, px per step.
    ``wavelength_px``: Shortest and longest texture wavelength in the image at the smallest and largest depth, without
      foreshortening; None for textures without a specified wavelength.
    ``content``: What was read from the mesh file and its pictures.
    """

    name: str
    faces: int
    depth_mm: tuple[float, float]
    disparity_px: tuple[float, float]
    wavelength_px: tuple[float, float] | None
    content: tuple[str, ...] = ()


@dataclass(frozen=True)
class SceneReport:
    """Expected properties of the recording and ground truth of a scene.

    ``recording_bytes``, ``truth_bytes``: Memory of the recording, and of the ground truth of the reference camera.
    ``mean_disparity_px``: Mean disparity in the reference image.
    ``working_point_px``: Mean disparity rounded to the integer shift per step of s for registration.
    ``residual_disparity_px``: Range of the disparity after registration, at the reference frame.
    ``warnings``: Properties that impair estimation but not simulation.
    """

    image_count: int
    recording_bytes: int
    truth_bytes: int
    mean_disparity_px: float
    working_point_px: int
    residual_disparity_px: tuple[float, float]
    objects: tuple[ObjectReport, ...]
    warnings: tuple[str, ...]


def check_scene(scene: Scene, world: BuiltScene) -> None:
    """Raise a SceneError if nothing is visible, and warn about scenes unsuitable for estimation."""
    found = _inspect(scene, world, None)
    if found.problems:
        raise SceneError(found.problems)
    for message in [*_object_warnings(scene, found), *_gloss_warnings(scene, world)]:
        warnings.warn(message, SceneWarning, stacklevel=2)


def describe_scene(
    scene: Scene, world: BuiltScene, depth: NDArray[np.float64], times: Sequence[float] | None = None
) -> SceneReport:
    """Return the expected properties of the data."""
    found = _inspect(scene, world, times)
    problems = found.problems
    seen = depth[np.isfinite(depth)]
    # For a subset of the objects, visible objects may be among the others.
    whole = len(world.bodies) == len(scene.parts)
    if not problems and not seen.size and whole:
        problems = [Problem("objects", "none is visible in the reference camera at the reference frame")]
    if problems:
        raise SceneError(problems)
    disparity = scene.camera.focal_px * scene.stage.baseline_mm / seen
    mean = float(disparity.mean()) if seen.size else 0.0
    images = scene.stage.rows * scene.stage.positions * scene.frames.count
    pixels = scene.camera.width * scene.camera.height
    chain = build_sensor_chain(scene.sensor)
    sample = chain.dtype.itemsize * max(len(chain.channels(scene.camera.bands)), 1)
    messages = [*_object_warnings(scene, found), *_lamp_warnings(scene, world), *_gloss_warnings(scene, world)]
    ends = (float(disparity.min()), float(disparity.max())) if seen.size else (0.0, 0.0)
    span = (ends[0] - round(mean), ends[1] - round(mean))
    messages += _registration_warnings(scene, ends, mean)
    return SceneReport(
        image_count=images,
        recording_bytes=images * pixels * sample,
        truth_bytes=scene.frames.count * pixels * _BYTES_OF_TRUTH,
        mean_disparity_px=mean,
        working_point_px=round(mean),
        residual_disparity_px=span,
        objects=tuple(found.reports),
        warnings=tuple(messages),
    )


def _registration_warnings(scene: Scene, ends: tuple[float, float], mean: float) -> list[str]:
    """Return a warning if the method registers all pixels by one disparity, far from those of the scene.

    Derivative filters of `structure_tensor` need residual displacements of about a pixel; by default, it chooses the
    registration of each pixel. Other methods have no derivative filters.
    """
    if scene.estimate.method != "structure_tensor":
        return []
    settings: Any = scene.estimate.settings
    fixed = settings.working_point_px
    if fixed == "per_pixel" or (fixed == "auto" and settings.pyramid_levels > 0):
        return []
    if fixed == "auto":
        fixed = round(mean)
    left = max(abs(disparity - fixed) for disparity in ends)
    if left <= _MOST_RESIDUAL_PX or ends == (0.0, 0.0):
        return []
    return [
        f"estimate.working_point_px: disparities differ from {fixed} px per step by up to {left:.1f} px; derivative "
        "filters are accurate up to about 1 px: use 'per_pixel', or reduce the baseline or the depth range"
    ]


@dataclass(frozen=True, eq=False)
class _Findings:
    """Properties of the objects that images show, problems, and messages about the other objects."""

    reports: list[ObjectReport]
    problems: list[Problem]
    unseen: list[str]


def _object_warnings(scene: Scene, found: _Findings) -> list[str]:
    reports = found.reports
    of_files = [*_texture_warnings(reports), *_extension_warnings(reports)]
    return [*found.unseen, *of_files, *_material_warnings(scene)]


def _inspect(scene: Scene, world: BuiltScene, times: Sequence[float] | None) -> _Findings:
    moments = compute_image_times(scene) if times is None else times
    # Overflow is reported as a problem.
    with np.errstate(all="ignore"):
        found = _look_at_objects(scene, world, moments)
        problems = [*_camera_problems(scene), *find_lighting_problems(scene, world, times)]
        return replace(found, problems=[*found.problems, *problems, *_reflectance_problems(scene, world)])


def _camera_problems(scene: Scene) -> list[Problem]:
    """Return incompatible settings of lens, shutter and backend."""
    problems = []
    if scene.render.backend == "pyrender" and scene.needs_rays:
        message = f"OpenGL cannot render {scene.needs_rays}; use raycast or auto"
        problems.append(Problem("render.backend", message, scene.render.backend))
    psf, camera, shutter = scene.optics.psf, scene.camera, scene.shutter
    if psf is not None and 2 * psf.reach_px > min(camera.width, camera.height):
        value = f"radius {psf.reach_px:.3g} px"
        problems.append(Problem("optics.psf", "is wider than the image; reduce its width, or enlarge the image", value))
    elif psf is not None and (folded := camera.folding_problem(int(np.ceil(psf.reach_px)))):
        # The image receives light from a margin around it.
        problems.append(Problem("optics.psf", f"includes light from outside the image, where {folded}"))
    interval = scene.frames.frame_interval_s
    if shutter.exposure_time_s > interval:
        message = f"is longer than frames.frame_interval_s, {interval:g} s"
        problems.append(Problem("shutter.exposure_time_s", message, shutter.exposure_time_s))
    elif shutter.exposure_time_s + shutter.readout_time_s > interval:
        message = f"ends, together with the exposure, after frames.frame_interval_s, {interval:g} s"
        problems.append(Problem("shutter.readout_time_s", message, shutter.readout_time_s))
    return problems


@dataclass
class _ObjectRange:
    """Ranges of one object over the evaluated times."""

    near: float = np.inf
    far: float = -np.inf
    in_view: bool = False
    lost_at: float | None = None

    def look(self, scene: Scene, vertices: NDArray[np.float64], t: float) -> None:
        """Update the ranges with the vertices at one time."""
        if self.lost_at is not None:
            return
        if not np.abs(vertices).max() <= _FARTHEST_MM:
            self.lost_at = t
            return
        depth = vertices[:, 2]
        self.near, self.far = min(self.near, float(depth.min())), max(self.far, float(depth.max()))
        self.in_view = self.in_view or (self.near > 0 and _in_view(scene, vertices))


def _look_at_objects(scene: Scene, world: BuiltScene, times: Sequence[float]) -> _Findings:
    # Time by time, to limit memory.
    seen = [_ObjectRange() for _ in world.bodies]
    for t in times:
        for one, body in zip(seen, world.bodies, strict=True):
            one.look(scene, body.positions_at(t), t)
    for one, body in zip(seen, world.bodies, strict=True):
        # An object may be visible at a time that was skipped.
        for t in compute_image_times(scene) if not one.in_view and one.near > 0 and one.lost_at is None else ():
            one.look(scene, body.positions_at(t), t)
            if one.in_view:
                break
    reports, problems, unseen = [], [], []
    items = {item.name: (path, item) for path, item in scene.parts}
    shown = [one.in_view for one in seen]
    for number, (one, body) in enumerate(zip(seen, world.bodies, strict=True)):
        path, item = items[body.name]
        near, far = one.near, one.far
        hidden = far <= 0 or (near > 0 and not one.in_view)
        if hidden and one.lost_at is None and _may_shade(scene, world, number, shown):
            where = "is behind the camera" if far <= 0 else "is outside every image"
            unseen.append(f"{path}: '{item.name}' {where}; it can only cast shadows")
            continue
        if one.lost_at is not None:
            message = (
                f"'{item.name}' exceeds the coordinate range at frame {one.lost_at:g}: no coordinate may be farther "
            )
            message += f"than {_FARTHEST_MM:g} mm from the origin; reduce size, distance or speed"
            problems.append(Problem(f"{path}.motion" if item.motion else path, message))
        elif near <= 0:
            where = "is behind the camera" if far <= 0 else "reaches behind the camera"
            value = f"Z from {near:.6g} to {far:.6g} mm"
            remedy = "move it to Z > 0 for all frames"
            problems.append(Problem(f"{path}.pose.position_mm", f"'{item.name}' {where}; {remedy}", value))
        elif not one.in_view:
            message = f"'{item.name}' is outside every image; move it, or increase the field of view"
            problems.append(Problem(f"{path}.pose.position_mm", message, item.pose.position_mm))
        else:
            disparity = sorted(scene.camera.focal_px * scene.stage.baseline_mm / np.array([near, far]))
            reports.append(
                ObjectReport(
                    item.name,
                    len(body.faces),
                    (near, far),
                    (float(disparity[0]), float(disparity[1])),
                    _wavelengths_px(item.texture, scene.camera.focal_px, near, far),
                    body.mesh.file_notes + getattr(body.texture, "notes", ()),
                )
            )
    return _Findings(reports, problems, unseen)


def _may_shade(scene: Scene, world: BuiltScene, number: int, shown: Sequence[bool]) -> bool:
    """Return whether an object might cast a shadow on one that images show, by spheres around them."""
    lighting = scene.band_scenes()[0].lighting
    if not (lighting.lights and lighting.shadows):
        return False
    if len(world.bodies) < len(scene.parts):
        # Objects with problems of their own are missing.
        return True
    for t in compute_image_times(scene):
        try:
            lamps = lighting.lamps_at(t)
        except SceneError:
            # The lamp is reported.
            return True
        centre, radius = _sphere_around(world.bodies[number], t)
        for body in (body for body, visible in zip(world.bodies, shown, strict=True) if visible):
            target, reach = _sphere_around(body, t)
            for lamp in lamps:
                if lamp.position_mm is None:
                    ahead = max(float(-lamp.axis @ (centre - target)), 0.0)
                    passed, width = target - ahead * lamp.axis, reach
                else:
                    way = lamp.position_mm - target
                    share = np.clip(way @ (centre - target) / max(float(way @ way), 1e-300), 0.0, 1.0)
                    own = 0.0 if lamp.area is None else np.linalg.norm(lamp.outline_mm() - lamp.position_mm, axis=1)
                    passed, width = target + share * way, max(reach, float(np.max(own)))
                if not np.linalg.norm(centre - passed) > radius + width:
                    return True
    return False


def _sphere_around(body: SceneBody, t: float) -> tuple[NDArray[np.float64], float]:
    """Return the centre and radius of a sphere around an object in mm."""
    vertices = body.positions_at(t)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return centre, float(np.linalg.norm(vertices - centre, axis=1).max())


def _in_view(scene: Scene, vertices: NDArray[np.float64]) -> bool:
    """Return whether the bounding box of the projected vertices intersects an image of any camera."""
    camera, stage = scene.camera, scene.stage
    for x_mm, y_mm in product(stage.x_mm, stage.y_mm):
        pixels = camera.project(vertices - (x_mm, y_mm, 0.0))
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        if ((high >= -0.5) & (low <= np.array([camera.width, camera.height]) - 0.5)).all():
            return True
    return False


def _wavelengths_px(texture: TextureModel, focal: float, near: float, far: float) -> tuple[float, float] | None:
    wavelengths = texture.shortest_and_longest_mm
    return None if wavelengths is None else (wavelengths[0] * focal / far, wavelengths[1] * focal / near)


_IGNORED_EXTENSION = "ignored: extension "


def _extension_warnings(reports: list[ObjectReport]) -> list[str]:
    return [
        f"objects: the mesh file of '{report.name}' uses extensions of glTF that are not read: {', '.join(names)}; "
        "compare the object with another viewer"
        for report in reports
        if (names := [text[len(_IGNORED_EXTENSION) :] for text in report.content
                      if text.startswith(_IGNORED_EXTENSION)])
    ]  # fmt: skip


def _texture_warnings(reports: list[ObjectReport]) -> list[str]:
    return [
        f"objects: the texture of '{report.name}' has wavelengths down to {report.wavelength_px[0]:.2f} px; finer than "
        f"{_FINEST_PX:g} px it is aliased: use longer wavelengths or a longer focal length"
        for report in reports
        if report.wavelength_px is not None and report.wavelength_px[0] < _FINEST_PX - _SAME_PX
    ]
