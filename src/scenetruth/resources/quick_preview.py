"""Quick preview of a scene in plain NumPy: coarse bodies at a few times, and a low-resolution depth image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera
from scenetruth.errors import Problem, SceneError
from scenetruth.resources.workload import ObjectWorkload
from scenetruth.scene.built_scene import (
    BuiltScene,
    SceneBody,
    find_motion_problems,
    make_point_maps,
    may_send_more,
    paint_bodies,
)
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.reference_configuration import make_reference_configuration
from scenetruth.scene.scene_models import Scene, compute_image_times
from scenetruth.scene.texture import Painted
from scenetruth.scene.texture.procedural_textures import UniformTexture
from scenetruth.scene.vertex_animation import VertexModel

__all__ = ["QuickPreview", "make_quick_preview", "preview_with_problems", "without_interior"]

# Widths of the preview image; where many triangles overlap, the next smaller width is used.
_WIDTHS_PX = (96, 48, 24)
_MOST_PIECES = 400_000
# Number of bodies times number of evaluated times.
_LOOKS = 300
_FEWEST_MOMENTS = 3
_MOST_BODIES = 100
_QUICKLY_MADE = 200_000  # largest number of triangles of a mesh that is built for the preview
_QUICKLY_READ = 4_000_000  # largest size in bytes of vertex files that are read for the preview
_QUICKLY_PAINTED = 4_000_000  # largest number of texels of a texture that is painted for the preview


@dataclass(frozen=True, eq=False)
class QuickPreview:
    """A coarse preview of a scene.

    ``world``, ``times``: Coarse bodies, and times to evaluate, in frames, including both ends. Only objects that might
      send more light than they receive have their textures.
    ``left_out``: Names of the omitted objects: too many, or from files that take long to read.
    ``unpainted``: Names of the objects that might send more light than they receive, whose textures take long.
    ``depth``, ``object_id``: Approximate depth (NaN for background) and body index (-1 for background) in the
      reference image, reduced by ``scale`` along both sides.
    """

    world: BuiltScene
    times: list[float]
    left_out: list[str]
    unpainted: list[str]
    depth: NDArray[np.float64]
    object_id: NDArray[np.int64]
    scale: float


def make_quick_preview(scene: Scene, parts: Sequence[ObjectWorkload], folder: Path = Path()) -> QuickPreview:
    """Compute the quick preview of a scene."""
    preview, problems = preview_with_problems(scene, parts, folder)
    if problems:
        raise SceneError(problems)
    return preview


def preview_with_problems(
    scene: Scene, parts: Sequence[ObjectWorkload], folder: Path = Path()
) -> tuple[QuickPreview, list[Problem]]:
    """Return the quick preview of the objects without problems, and the problems of the others' deformations."""
    step = -(-len(parts) // _MOST_BODIES)
    chosen = [part for part in parts[::step] if part.sketch is not None and _is_quick(part, folder)]
    names = {part.item.name for part in chosen}
    times = _moments(scene, len(chosen))
    bodies, problems = [], []
    for part in chosen:
        # Overflows are reported as problems.
        with np.errstate(all="ignore"):
            try:
                body = _body(scene, part, folder)
            except SceneError as error:
                where = f"{part.path}.deformation.0"
                problems += [Problem(f"{where}.{one.path}", one.message, one.value) for one in error.problems]
                continue
            found = _movement_problems(scene, part, body, times, folder)
        problems += found
        bodies += [] if found else [body]
    bright = {part.item.name for part in chosen if may_send_more(scene, part.item.name)}
    unpainted = [part.item.name for part in chosen if part.item.name in bright and not _is_quickly_painted(part)]
    world = paint_bodies(scene, BuiltScene(tuple(bodies)), bright - {*unpainted}, folder)
    with np.errstate(all="ignore"):
        depth, object_id = _picture([body.positions_at(0.0)[body.faces] for body in bodies], scene.camera)
    left_out = [part.item.name for part in parts if part.item.name not in names]
    scale = scene.camera.width / depth.shape[1]
    return QuickPreview(world, times, left_out, unpainted, depth, object_id, scale), problems


def _is_quickly_painted(part: ObjectWorkload) -> bool:
    return part.painted or part.texels <= _QUICKLY_PAINTED


def without_interior(preview: QuickPreview, margin_px: float) -> list[str]:
    """Return the names of the visible objects without interior pixels, at the resolution of the preview."""
    number = preview.object_id
    edges = np.zeros(number.shape, dtype=np.bool_)
    across, down = number[:, 1:] != number[:, :-1], number[1:] != number[:-1]
    edges[:, 1:] |= across
    edges[:, :-1] |= across
    edges[1:] |= down
    edges[:-1] |= down
    reach = margin_px / preview.scale - 1
    far = _is_farther(edges, reach)
    seen, inside = (set(number[mask].tolist()) for mask in (number >= 0, far & (number >= 0)))
    return [preview.world.bodies[index].name for index in sorted(seen - inside)] if reach > 0 else []


def _is_farther(edges: NDArray[np.bool_], reach: float) -> NDArray[np.bool_]:
    """Return the pixels without an edge within a distance."""
    near = np.zeros(edges.shape, dtype=np.bool_)
    for up in range(-int(reach), int(reach) + 1):
        half = int(np.sqrt(reach**2 - up**2))
        moved = np.zeros(edges.shape, dtype=np.bool_)
        rows = edges.shape[0]
        moved[max(up, 0) : rows + min(up, 0)] = edges[max(-up, 0) : rows - max(up, 0)]
        count = np.cumsum(np.pad(moved, ((0, 0), (half + 1, half))), axis=1)
        near |= count[:, 2 * half + 1 :] > count[:, : -2 * half - 1]
    return ~near


def _is_quick(part: ObjectWorkload, folder: Path) -> bool:
    given = part.item.deformation[0] if part.item.deformation else None
    if not isinstance(given, VertexModel):
        return True
    from scenetruth.input_files import collect_input_files

    sizes = [(folder / file).stat().st_size for _, file in collect_input_files(given) if (folder / file).is_file()]
    return sum(sizes) <= _QUICKLY_READ


def _body(scene: Scene, part: ObjectWorkload, folder: Path) -> SceneBody:
    item, mesh = part.item, part.sketch
    assert mesh is not None
    given = item.deformation[0] if item.deformation else None
    start = (
        given.start(mesh, folder, scene.frames)
        if isinstance(given, VertexModel)
        else make_reference_configuration(mesh)
    )
    painted = _unpainted(mesh)
    maps = make_point_maps(item, mesh, scene.frames.frame_interval_s)
    return SceneBody(item.name, mesh, start, painted.uv, painted.texture, maps)


def _movement_problems(
    scene: Scene, part: ObjectWorkload, body: SceneBody, times: Sequence[float], folder: Path
) -> list[Problem]:
    """Return the problems of an object's deformations; problems of the sketch are verified on the full mesh."""

    def found(one: SceneBody) -> list[Problem]:
        return find_motion_problems(scene, part.path, part.item, one.start, one.maps, one.mesh.faces, times)

    problems = found(body)
    if not problems or part.size.faces > _QUICKLY_MADE:
        return problems
    return found(_body(scene, replace(part, sketch=part.item.mesh.make(folder)), folder))


def _unpainted(mesh: TriangleMesh) -> Painted:
    return UniformTexture(kind="uniform").paint(mesh, Path(), np.random.default_rng(0))


def _moments(scene: Scene, bodies: int) -> list[float]:
    """Return a selection of the times of a scene: the reference, both ends, and as many between as are cheap."""
    times = sorted(compute_image_times(scene))
    count = min(len(times), max(_FEWEST_MOMENTS, _LOOKS // max(bodies, 1)))
    chosen = {times[index] for index in np.linspace(0, len(times) - 1, count).round().astype(int).tolist()}
    return sorted({*chosen, 0.0})


_ALL_PIECES = 4_000_000  # number of pieces that fit into 1 GB including all intermediate results


def _picture(corners: Sequence[NDArray[np.float64]], camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the depth and the body index of the nearest surface in every pixel of the preview."""
    for width_px in _WIDTHS_PX[:-1]:
        found = _drawn(corners, camera.shrunk_to(width_px), _MOST_PIECES)
        if found is not None:
            return found
    found = _drawn(corners, camera.shrunk_to(_WIDTHS_PX[-1]), np.inf)
    assert found is not None
    return found


def _drawn(
    corners: Sequence[NDArray[np.float64]], camera: Camera, most_pieces: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Return depths and body indices, or None if there are too many pieces of triangles, each drawn at its centroid."""
    parts = [part for part in corners if len(part)]
    body = np.repeat(np.arange(len(corners)), [len(part) for part in corners])
    pieces = np.concatenate(parts) if parts else np.empty((0, 3, 3))
    pieces, body = _in_front(pieces, body)
    depth = np.full(camera.height * camera.width, np.inf)
    object_id = np.full(depth.shape, -1)
    made = 0
    while len(pieces):
        x, y = np.moveaxis(camera.project(pieces.reshape(-1, 3)).reshape(-1, 3, 2), -1, 0)
        (left, right), (top, bottom) = _ends(x), _ends(y)
        seen = (right >= -0.5) & (left < camera.width - 0.5) & (bottom >= -0.5) & (top < camera.height - 0.5)
        large = seen & (np.maximum(right - left, bottom - top) > 1.0)
        pieces_then = made + 4 * np.count_nonzero(large)
        if pieces_then > most_pieces:
            return None
        if pieces_then > _ALL_PIECES:
            # Surfaces that reach the camera would be subdivided without end: draw the remaining pieces as they are.
            large = np.zeros_like(large)
        small = seen & ~large
        middle = (pieces[small, 0] + pieces[small, 1] + pieces[small, 2]) / 3
        _splat(middle, body[small], camera, depth, object_id)
        made += int(np.count_nonzero(small))
        pieces, body = _cut(pieces[large]), np.tile(body[large], 4)
    depth[object_id < 0] = np.nan
    shape = (camera.height, camera.width)
    return depth.reshape(shape), object_id.reshape(shape)


def _ends(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the minimum and maximum of three columns, ten times faster than a NumPy reduction."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _in_front(pieces: NDArray[np.float64], body: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    front = (pieces[..., 2] > 0).all(axis=1)
    return pieces[front], body[front]


def _cut(pieces: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cut every triangle into four at the midpoints of its sides."""
    a, b, c = pieces[:, 0], pieces[:, 1], pieces[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(each, axis=1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def _splat(
    points: NDArray[np.float64],
    body: NDArray[Any],
    camera: Camera,
    depth: NDArray[np.float64],
    object_id: NDArray[np.int64],
) -> None:
    """Draw points into a depth image with a depth test."""
    pixel = np.rint(camera.project(points)).astype(np.int64)
    inside = ((pixel >= 0) & (pixel < [camera.width, camera.height])).all(axis=1)
    place, z, number = (pixel[inside] @ [1, camera.width]), points[inside, 2], body[inside]
    order = np.lexsort((z, place))
    place, z, number = place[order], z[order], number[order]
    first = np.ones(len(place), dtype=np.bool_)
    first[1:] = place[1:] != place[:-1]
    place, z, number = place[first], z[first], number[first]
    nearer = z < depth[place]
    depth[place[nearer]], object_id[place[nearer]] = z[nearer], number[nearer]
