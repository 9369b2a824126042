"""Kernels for the irradiance at surface points and the shading of images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast.shadow_kernels import BLOCKED, LIT, UNSURE
from scenetruth.threads import in_bands

__all__ = [
    "add_light",
    "behind_sphere",
    "direct_light",
    "face_steps",
    "facing_points",
    "find_alike",
    "light_of_faces",
    "light_up_faces",
    "lit_means",
    "mean_by_owner",
    "shade_image",
    "shadow_steps",
    "smooth_points",
    "uneven_pixels",
]

DARK = 0
"""Cone zone of points that receive no light."""

# Other zones: the border of the cone, where the light falls off, and its interior (everywhere without a cone).
_BORDER, _INSIDE = 1, 2
_MIX = np.uint64(0x9E3779B97F4A7C15)  # multiplier that combines the zones of all lights into one number
# Minimum number of points, of points with a cheap operation, and of pixel rows per thread.
_LEAST_POINTS, _LEAST_EASY_POINTS, _LEAST_ROWS = 4096, 65536, 8
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


def light_up_faces(
    mesh: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]],
    origin: NDArray[np.float64],
    lamps: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]],
    ambient: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]:
    """Return ``by_lamp``, ``total`` and ``bits`` of flat faces under parallel lamps, see `FaceLight`.

    ``mesh``: World positions, vertex indices and unit normals of the faces. ``origin``: Of the camera.
    ``lamps``: Irradiance of each lamp, shape (lamps,); cosine of its direction and the normals, and state of the faces,
      shape (lamps, m).
    """
    count, number = mesh[1].shape[0], len(lamps[0])
    by_lamp, total = np.empty((count, number)), np.empty(count)
    bits = np.zeros((3, count), dtype=np.uint64)
    arguments = (mesh, origin, lamps, ambient, by_lamp, total, bits)
    in_bands(_light_up_faces, count, *arguments, least=_LEAST_POINTS)
    return by_lamp, total, bits


@kernel()
def _light_up_faces(
    low: int, high: int, mesh: tuple[Any, ...], origin: NDArray[np.float64], lamps: tuple[Any, ...], ambient: float,
    by_lamp: NDArray[np.float64], total: NDArray[np.float64], bits: NDArray[np.uint64],
) -> None:  # fmt: skip
    vertices, faces, normals = mesh
    irradiances, cosines, states = lamps
    for face in range(low, high):
        towards = 0.0
        for k in range(3):
            towards += normals[face, k] * (origin[k] - vertices[faces[face, 0], k])
        side = 1.0 if towards > 0.0 else -1.0
        total[face] = ambient
        for lamp in range(irradiances.shape[0]):
            light, state = irradiances[lamp] * max(-cosines[lamp, face] * side, 0.0), states[lamp, face]
            if light > 0.0:
                row = 0 if state == LIT else (1 if state == BLOCKED else 2)
                bits[row, face] |= np.uint64(1) << np.uint64(lamp)
            if state == BLOCKED:
                light = 0.0
            total[face] += light
            by_lamp[face, lamp] = -light if state == UNSURE else light


@kernel()
def face_steps(light: NDArray[np.float64], neighbours: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the mean squared difference of the light between a face and its neighbours, and around them, shape (m,).

    ``light``: Of each face by each lamp, NaN where it has no steps to neighbours, shape (m, lamps).
    ``neighbours``: Of each face, -1 for none, shape (m, 3).
    """
    squares, found = np.zeros(light.shape[0]), np.empty(light.shape[0])
    for face in range(light.shape[0]):
        for k in range(3):
            other, step = neighbours[face, k], 0.0
            if other < 0:
                continue
            for lamp in range(light.shape[1]):
                part = light[other, lamp] - light[face, lamp]
                if not np.isnan(part):
                    step += part
            squares[face] += step * step / 3.0
    for face in range(light.shape[0]):
        around = 0.0
        for k in range(3):
            other = neighbours[face, k]
            around += squares[face] if other < 0 else squares[other]
        found[face] = (squares[face] + around / 3.0) / 2.0
    return found


@kernel()
def mean_by_owner(
    owner: NDArray[np.int64], face: NDArray[np.int32], values: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return the mean value of the faces of samples with the same owner, 0 without samples, shape (count,).

    ``owner``: Owner of each sample, -1 for none. ``face``: Face of each sample. ``values``: Of each face.
    """
    means, number = np.zeros(count), np.zeros(count, dtype=np.int64)
    for n in range(owner.shape[0]):
        if owner[n] >= 0:
            means[owner[n]] += values[face[n]]
            number[owner[n]] += 1
    for n in range(count):
        means[n] /= max(number[n], 1)
    return means


@kernel()
def light_of_faces(face: NDArray[np.int32], total: NDArray[np.float64], unsure: NDArray[np.bool_]) -> Any:
    """Return the light at hits on faces, 1 without a hit, and the indices of hits on faces that are not decided.

    ``face``: Face of each hit, -1 for none. ``total``, ``unsure``: Light of each face, and whether it is not decided.
    """
    light, where, used = np.empty(face.shape[0]), np.empty(face.shape[0], dtype=np.int64), 0
    for n in range(face.shape[0]):
        met = face[n]
        light[n] = 1.0
        if met >= 0:
            light[n] = total[met]
            if unsure[met]:
                where[used] = n
                used += 1
    return light, where[:used]


@kernel()
def find_alike(faces: NDArray[np.int32], pixels: NDArray[np.int64], cells: NDArray[np.int32], count: int) -> Any:
    """Return samples that stand for all, and for each sample the index of the one that stands for it.

    Samples of a face in the same cell of a pixel are alike, unless one in another cell is between them.

    ``faces``: Face of each sample, below ``count``. ``pixels``, ``cells``: Its pixel, and its cell, -1 for none.
    """
    last = np.full(count, -1, dtype=np.int64)
    chosen, of, used = np.empty(faces.shape[0], dtype=np.int64), np.empty(faces.shape[0], dtype=np.int64), 0
    for n in range(faces.shape[0]):
        before = last[faces[n]]
        if before >= 0 and cells[n] >= 0 and cells[n] == cells[before] and pixels[n] == pixels[before]:
            of[n] = of[before]
        else:
            chosen[used], of[n] = n, used
            used += 1
        last[faces[n]] = n
    return chosen[:used], of


def smooth_points(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    faces: NDArray[np.int64],
    weights: NDArray[np.float64],
    corners: NDArray[np.float64],
    corner_normals: NDArray[np.float64],
    face_smooth: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Replace triangle normals by those of smooth surfaces, ``normals`` (n, 3), in place.

    Points are located by ``faces`` (n,) and ``weights`` (n, 2) of the second and third corner; ``corners`` and
    ``corner_normals``, (m, 3, 3), are given for all triangles. Corner normals are oriented to the side of ``normals``,
    averaged by weight and normalised; where one is not finite, the triangle normal is kept.
    Returns the origins of shadow rays, shape (n, 3): the weighted mean of the projections of the point onto the tangent
    planes of the corners, if it lies above the triangle, else the point. This avoids false shadows near the terminator
    of convex surfaces (Hanika, Hacking the shadow terminator, Ray Tracing Gems II, 2021).
    """
    starts = points.copy()
    surface = (corners, corner_normals, face_smooth)
    in_bands(_smooth_points, points.shape[0], points, normals, faces, weights, *surface, starts, least=_LEAST_POINTS)
    return starts


@kernel()
def _smooth_points(
    low: int, high: int, points: NDArray[np.float64], normals: NDArray[np.float64], faces: NDArray[np.int64],
    weights: NDArray[np.float64], corners: NDArray[np.float64], corner_normals: NDArray[np.float64],
    face_smooth: NDArray[np.bool_], starts: NDArray[np.float64],
) -> None:  # fmt: skip
    total, shift = np.empty(3), np.empty(3)
    for n in range(np.uint64(low), np.uint64(high)):
        face = faces[n]
        if not face_smooth[face]:
            continue
        total[:], shift[:] = 0.0, 0.0
        length, above = 0.0, 0.0
        for c in range(3):
            side, away = 0.0, 0.0
            weight = weights[n, c - 1] if c > 0 else 1.0 - weights[n, 0] - weights[n, 1]
            for k in range(3):
                side += corner_normals[face, c, k] * normals[n, k]
                away += corner_normals[face, c, k] * (points[n, k] - corners[face, c, k])
            sign = -1.0 if side < 0.0 else 1.0
            for k in range(3):
                total[k] += sign * weight * corner_normals[face, c, k]
                shift[k] -= weight * away * corner_normals[face, c, k]
        for k in range(3):
            length += total[k] * total[k]
            above += shift[k] * normals[n, k]
        if not length > 0.0:
            continue
        for k in range(3):
            normals[n, k] = total[k] / np.sqrt(length)
            if above > 0.0:
                starts[n, k] += shift[k]


def facing_points(
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    depth: NDArray[np.float64],
    face: NDArray[np.int32],
    seen: NDArray[np.int64],
    face_normals: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the hit points of rays and the unit normals on the visible side.

    ``origin``: Origin of the rays in mm, shape (3,).
    ``directions``: Directions of the rays, shape (k, 3).
    ``depth``, ``face``: Hits of the rays, see `Hits`, shape (k,).
    ``seen``: Indices of rays with a hit, shape (n,).
    ``face_normals``: Unit normals of the faces, shape (m, 3).
    Returns: Points in mm and unit normals towards the origin, shape (n, 3) each.
    """
    count = seen.shape[0]
    points = np.empty((count, 3), dtype=np.float64)
    normals = np.empty((count, 3), dtype=np.float64)
    rays = (origin, directions, depth, face)
    in_bands(_facing_points, count, *rays, seen, face_normals, points, normals, least=_LEAST_POINTS)
    return points, normals


@kernel()
def _facing_points(
    low: int, high: int, origin: NDArray[np.float64], directions: NDArray[np.float64], depth: NDArray[np.float64],
    face: NDArray[np.int32], seen: NDArray[np.int64], face_normals: NDArray[np.float64],
    points: NDArray[np.float64], normals: NDArray[np.float64],
) -> None:  # fmt: skip
    for n in range(np.uint64(low), np.uint64(high)):
        ray = seen[n]
        met, far = face[ray], depth[ray]
        # Read everything before writing, because the compiler cannot exclude aliasing.
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        nx, ny, nz = face_normals[met, 0], face_normals[met, 1], face_normals[met, 2]
        sign = -1.0 if nx * dx + ny * dy + nz * dz > 0.0 else 1.0
        points[n, 0], points[n, 1], points[n, 2] = origin[0] + far * dx, origin[1] + far * dy, origin[2] + far * dz
        normals[n, 0], normals[n, 1], normals[n, 2] = sign * nx, sign * ny, sign * nz


def direct_light(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    position: NDArray[np.float64],
    axis: NDArray[np.float64],
    parallel_light: bool,
    irradiance: float,
    reference_distance: float,
    cos_inner: float,
    cos_outer: float,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the irradiance of points by one light, without shadows.

    The irradiance is E (r_0 / r)² S(cos θ) max(0, n . l) (Lambert's cosine law, inverse square law) with the unit
    vector l towards the light, its distance r, and the angle θ to the axis of a spotlight; S is 3 h² - 2 h³ of the
    relative position h in the cone border. Parallel light has no distance term, and only spotlights have S.

    ``points``, ``normals``: Points in mm and unit normals on the visible side, shape (n, 3) each.
    ``position``: Position of the light in mm, shape (3,); ignored for parallel light.
    ``axis``: Unit vector of the light direction, shape (3,).
    ``reference_distance``: r_0 in mm.
    Returns: Irradiance, shape (n,); cone zone, `DARK` also for surfaces facing away, shape (n,), uint8; unit vectors
    towards the light, shape (n, 3); distance of the light in mm, shape (n,), infinite for parallel light.
    """
    count = points.shape[0]
    light = np.empty(count, dtype=np.float64)
    zone = np.empty(count, dtype=np.uint8)
    to_light = np.empty((count, 3), dtype=np.float64)
    distance = np.empty(count, dtype=np.float64)
    out = (light, zone, to_light, distance)
    lamp = (position, axis, parallel_light, irradiance, reference_distance, cos_inner, cos_outer)
    in_bands(_direct_light, count, points, normals, *lamp, out, least=_LEAST_POINTS)
    return out


@kernel()
def _direct_light(
    low: int, high: int, points: NDArray[np.float64], normals: NDArray[np.float64],
    position: NDArray[np.float64], axis: NDArray[np.float64], parallel_light: bool, irradiance: float,
    reference_distance: float, cos_inner: float, cos_outer: float, out: tuple[NDArray[Any], ...],
) -> None:  # fmt: skip
    light, zone, to_light, distance = out
    for n in range(np.uint64(low), np.uint64(high)):
        value = irradiance
        place = _INSIDE
        if parallel_light:
            lx, ly, lz = -axis[0], -axis[1], -axis[2]
            length = np.inf
        else:
            lx, ly, lz = position[0] - points[n, 0], position[1] - points[n, 1], position[2] - points[n, 2]
            length = np.sqrt(lx * lx + ly * ly + lz * lz)
            lx, ly, lz = lx / length, ly / length, lz / length
            value *= (reference_distance / length) ** 2
            if cos_inner > -1.0:
                cosine = -(lx * axis[0] + ly * axis[1] + lz * axis[2])
                if cosine < cos_outer:
                    value, place = 0.0, DARK
                elif cosine < cos_inner:
                    share = (cosine - cos_outer) / (cos_inner - cos_outer)
                    value *= share * share * (3.0 - 2.0 * share)
                    place = _BORDER
        facing = normals[n, 0] * lx + normals[n, 1] * ly + normals[n, 2] * lz
        if facing <= 0.0:
            value, place = 0.0, DARK
        else:
            value *= facing
        light[n], zone[n], distance[n] = value, place, length
        to_light[n, 0], to_light[n, 1], to_light[n, 2] = lx, ly, lz


def behind_sphere(
    points: NDArray[np.float64],
    wanted: NDArray[np.bool_],
    centre: NDArray[np.float64],
    radius: float,
    axis: NDArray[np.float64],
    position: NDArray[np.float64] | None,
) -> NDArray[np.bool_]:
    """Return which wanted points lie in or behind a sphere, as seen from a lamp, shape (n,).

    ``points``: In mm, shape (n, 3). ``axis``: Unit vector of the light direction, shape (3,).
    ``position``: Position of the lamp in mm, shape (3,); None for parallel light.
    """
    found = np.empty(len(points), dtype=np.bool_)
    lamp = (axis, np.zeros(3) if position is None else position, position is None)
    in_bands(_behind_sphere, len(points), points, wanted, centre, radius, *lamp, found, least=_LEAST_EASY_POINTS)
    return found


@kernel()
def _behind_sphere(
    low: int, high: int, points: NDArray[np.float64], wanted: NDArray[np.bool_], centre: NDArray[np.float64],
    radius: float, axis: NDArray[np.float64], position: NDArray[np.float64], parallel_light: bool,
    found: NDArray[np.bool_],
) -> None:  # fmt: skip
    for n in range(np.uint64(low), np.uint64(high)):
        if not wanted[n]:
            found[n] = False
            continue
        dx, dy, dz = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
        if parallel_light:
            along = dx * axis[0] + dy * axis[1] + dz * axis[2]
            found[n] = along >= -radius and dx * dx + dy * dy + dz * dz - along * along <= radius * radius
            continue
        # The distance of the centre from the ray between lamp and point.
        lx, ly, lz = position[0] - points[n, 0], position[1] - points[n, 1], position[2] - points[n, 2]
        share = -(dx * lx + dy * ly + dz * lz) / (lx * lx + ly * ly + lz * lz)
        share = min(max(share, 0.0), 1.0)
        x, y, z = dx + share * lx, dy + share * ly, dz + share * lz
        found[n] = x * x + y * y + z * z <= radius * radius


def add_light(
    total: NDArray[np.float64],
    state: NDArray[np.uint64],
    light: NDArray[np.float64],
    zone: NDArray[np.uint8],
    dark: NDArray[np.bool_],
) -> None:
    """Add the irradiance of an unblocked light, and its cone zone to the state numbers, shape (n,), in place."""
    in_bands(_add_light, total.shape[0], total, state, light, zone, dark, least=_LEAST_EASY_POINTS)


@kernel()
def _add_light(
    low: int, high: int, total: NDArray[np.float64], state: NDArray[np.uint64], light: NDArray[np.float64],
    zone: NDArray[np.uint8], dark: NDArray[np.bool_],
) -> None:  # fmt: skip
    for n in range(np.uint64(low), np.uint64(high)):
        place = np.uint64(DARK) if dark[n] else np.uint64(zone[n])
        total[n] += 0.0 if dark[n] else light[n]
        state[n] = state[n] * _MIX + place


@inlined
def _joined(face: int, mixed: bool, other_face: int, other_mixed: bool) -> Any:
    """Return whether two pixel centres lie on one smooth surface; scalars avoid reference counting of arrays."""
    if face < 0 or other_face < 0:
        return False
    return face == other_face or not (mixed or other_mixed)


def uneven_pixels(
    shade: NDArray[np.float64],
    state: NDArray[np.uint64],
    face: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    steepest: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Mark pixels with non-smooth irradiance.

    The irradiance is smooth if all eight neighbours on the same surface are lit by the same lights and differ by no
    more than a limit.

    ``shade``: Irradiance, shape (height, width).
    ``state``: State numbers, shape (height, width), that differ between points lit by different lights or cone zones.
    ``face``: Face at each pixel, -1 for none, shape (height, width).
    ``mixed``: Pixels whose footprint crosses an edge, shape (height, width).
    Returns: Non-smooth pixels, and those whose state differs from a neighbour: bool, shape (height, width).
    """
    uneven = np.zeros(shade.shape, dtype=np.bool_)
    borders = np.zeros(shade.shape, dtype=np.bool_)
    pixels = (shade, state, face, mixed)
    in_bands(_uneven_pixels, shade.shape[0], *pixels, steepest, uneven, borders, least=_LEAST_ROWS)
    return uneven, borders


@kernel()
def _uneven_pixels(
    low: int, high: int, shade: NDArray[np.float64], state: NDArray[np.uint64], face: NDArray[np.int32],
    mixed: NDArray[np.bool_], steepest: float, uneven: NDArray[np.bool_], borders: NDArray[np.bool_],
) -> None:  # fmt: skip
    rows, columns = shade.shape
    for y in range(low, high):
        for x in range(columns):
            if face[y, x] < 0:
                continue
            for v in range(max(y - 1, 0), min(y + 2, rows)):
                for u in range(max(x - 1, 0), min(x + 2, columns)):
                    other = state[v, u] != state[y, x]
                    # The cheap test comes first, because neighbours rarely differ.
                    if (other or abs(shade[v, u] - shade[y, x]) > steepest) and _joined(
                        face[y, x], mixed[y, x], face[v, u], mixed[v, u]
                    ):
                        uneven[y, x] = True
                        borders[y, x] = borders[y, x] or other


def shade_image(
    albedo: NDArray[np.float32],
    shade: NDArray[np.float64],
    face: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    unknown: NDArray[np.bool_],
    uneven: NDArray[np.bool_],
    variance: float,
) -> NDArray[np.float32]:
    """Shade an image: mean albedo A of each pixel times irradiance S at its centre, with a second-order correction.

    The mean of A S over a footprint is A S + σ² (∇A . ∇S + A ΔS / 2) to second order, with mean albedo A and footprint
    variance σ². Derivatives are differences between neighbours on the same surface: central differences, of fourth
    order for A where possible, and one-sided differences at edges with smooth irradiance.

    ``albedo``: Mean albedo over each footprint, shape (height, width).
    ``unknown``: Pixels without an albedo, shape (height, width): neither shaded nor used for differences.
    Returns: Mean radiance, shape (height, width), float32.
    """
    out = albedo.copy()
    pixels = (albedo, shade, face, mixed, unknown, uneven)
    in_bands(_shade_image, shade.shape[0], *pixels, variance, out, least=_LEAST_ROWS)
    return out


@kernel()
def _shade_image(
    low: int, high: int, albedo: NDArray[np.float32], shade: NDArray[np.float64], face: NDArray[np.int32],
    mixed: NDArray[np.bool_], unknown: NDArray[np.bool_], uneven: NDArray[np.bool_], variance: float,
    out: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = shade.shape
    for y in range(low, high):
        for x in range(columns):
            if face[y, x] < 0 or unknown[y, x]:
                continue
            a, s = np.float64(albedo[y, x]), shade[y, x]
            value = a * s
            own_face, own_mixed = face[y, x], mixed[y, x]
            # Interior: both neighbours on every side have an albedo and a face and are not mixed.
            in_the_open = y >= 2 and x >= 2 and y + 2 < rows and x + 2 < columns and not own_mixed
            if in_the_open:
                for k in (-2, -1, 1, 2):
                    if unknown[y, x + k] or mixed[y, x + k] or face[y, x + k] < 0:
                        in_the_open = False
                        break
                    if unknown[y + k, x] or mixed[y + k, x] or face[y + k, x] < 0:
                        in_the_open = False
                        break
            if in_the_open:
                # Common case: all neighbours are on the same surface.
                for axis in range(2):
                    dy, dx = axis, 1 - axis
                    a0, a1 = np.float64(albedo[y - dy, x - dx]), np.float64(albedo[y + dy, x + dx])
                    s0, s1 = shade[y - dy, x - dx], shade[y + dy, x + dx]
                    slope_a, slope_s, bend = 0.5 * (a1 - a0), 0.5 * (s1 - s0), s1 - 2.0 * s + s0
                    b0, b1 = np.float64(albedo[y - 2 * dy, x - 2 * dx]), np.float64(albedo[y + 2 * dy, x + 2 * dx])
                    slope_a += (slope_a - 0.25 * (b1 - b0)) / 3.0
                    value += variance * (slope_a * slope_s + 0.5 * a * bend)
                out[y, x] = np.float32(value)
                continue
            for axis in range(2):
                dy, dx = axis, 1 - axis
                # Use neighbours inside the image that have an albedo and are on the same surface.
                v0, u0, v1, u1 = y - dy, x - dx, y + dy, x + dx
                before, after = v0 >= 0 and u0 >= 0, v1 < rows and u1 < columns
                before = before and not unknown[v0, u0] and _joined(own_face, own_mixed, face[v0, u0], mixed[v0, u0])
                after = after and not unknown[v1, u1] and _joined(own_face, own_mixed, face[v1, u1], mixed[v1, u1])
                if before and after:
                    a0, a1 = np.float64(albedo[v0, u0]), np.float64(albedo[v1, u1])
                    s0, s1 = shade[v0, u0], shade[v1, u1]
                    slope_a, slope_s, bend = 0.5 * (a1 - a0), 0.5 * (s1 - s0), s1 - 2.0 * s + s0
                    v0, u0, v1, u1 = y - 2 * dy, x - 2 * dx, y + 2 * dy, x + 2 * dx
                    within = v0 >= 0 and u0 >= 0 and v1 < rows and u1 < columns
                    within = within and not unknown[v0, u0] and not unknown[v1, u1]
                    within = within and _joined(own_face, own_mixed, face[v0, u0], mixed[v0, u0])
                    if within and _joined(own_face, own_mixed, face[v1, u1], mixed[v1, u1]):
                        slope_a += (slope_a - 0.25 * (np.float64(albedo[v1, u1]) - np.float64(albedo[v0, u0]))) / 3.0
                elif before or after:
                    way = 1 if after else -1
                    v1, u1, v2, u2 = y + way * dy, x + way * dx, y + 2 * way * dy, x + 2 * way * dx
                    # Differences must not cross a neighbour with non-smooth irradiance.
                    within = not uneven[v1, u1] and v2 >= 0 and u2 >= 0 and v2 < rows and u2 < columns
                    within = within and not unknown[v2, u2]
                    if not (within and _joined(own_face, own_mixed, face[v2, u2], mixed[v2, u2])):
                        continue
                    a1, a2 = np.float64(albedo[v1, u1]), np.float64(albedo[v2, u2])
                    s1, s2 = shade[v1, u1], shade[v2, u2]
                    slope_a, slope_s, bend = (
                        2.0 * a1 - 1.5 * a - 0.5 * a2,
                        2.0 * s1 - 1.5 * s - 0.5 * s2,
                        s2 - 2.0 * s1 + s,
                    )
                else:
                    continue
                value += variance * (slope_a * slope_s + 0.5 * a * bend)
            out[y, x] = np.float32(value)


def shadow_steps(
    face: NDArray[np.int32],
    body: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    bits: NDArray[np.uint64],
    blocked: NDArray[np.uint64],
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Find the lamps that are blocked at each pixel, and neighbours of which one is in the light, the other not.

    Between them runs the border of a shadow, although no line crosses the pixels.

    ``face``, ``body``: Face and body at each pixel, -1 for none, shape (height, width).
    ``mixed``: Pixels whose footprint crosses an edge, shape (height, width).
    ``bits``: Lamps of each face, see `FaceLight`, shape (3, m).
    ``blocked``: Blocked lamps at pixels on faces that are not decided, shape (height, width).
    Returns: Bits of the blocked lamps, for lamps behind the face those of the neighbours; and the pixels next to a
    border, shape (height, width).
    """
    dark, steps = np.zeros(face.shape, dtype=np.uint64), np.zeros(face.shape, dtype=np.bool_)
    in_bands(_shadow_steps, face.shape[0], face, body, mixed, bits, blocked, dark, steps, least=_LEAST_ROWS)
    return dark, steps


@kernel()
def _shadow_steps(
    low: int, high: int, face: NDArray[np.int32], body: NDArray[np.int32], mixed: NDArray[np.bool_],
    bits: NDArray[np.uint64], blocked: NDArray[np.uint64], dark: NDArray[np.uint64], steps: NDArray[np.bool_],
) -> None:  # fmt: skip
    rows, columns = face.shape
    for y in range(low, high):
        for x in range(columns):
            own = face[y, x]
            if own < 0:
                continue
            lit = bits[0, own] | (bits[2, own] & ~blocked[y, x])
            out = bits[1, own] | (bits[2, own] & blocked[y, x])
            beside = np.uint64(0)
            for k in range(4):
                v, u = y + (k == 1) - (k == 0), x + (k == 3) - (k == 2)
                if v < 0 or u < 0 or v >= rows or u >= columns or body[v, u] != body[y, x] or mixed[v, u]:
                    continue
                other = face[v, u]
                if other == own and bits[2, own] == 0:
                    continue
                other_out = bits[1, other] | (bits[2, other] & blocked[v, u])
                other_lit = bits[0, other] | (bits[2, other] & ~blocked[v, u])
                beside |= other_out
                if not mixed[y, x] and ((lit & other_out) | (out & other_lit)) != 0:
                    steps[y, x] = True
            dark[y, x] = out | (beside & ~lit)


def lit_means(
    radiance: NDArray[np.float32],
    face: NDArray[np.int32],
    face_light: NDArray[np.float64],
    blocked: NDArray[np.uint64],
    ambient: float,
    weights: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Average samples of flat faces, lit by the lamps that are not blocked.

    ``radiance``, ``face``: Radiance without light and face of each sample, shape (n, k).
    ``face_light``: Irradiance of the faces by each lamp, see `FaceLight`, shape (m, lamps).
    ``blocked``: Bits of the blocked lamps of each pixel, for faces where the light is negative, shape (n,).
    ``weights``: Weights of the samples, shape (k,).
    Returns: Mean radiance, shape (n,).
    """
    out = np.empty(radiance.shape[0], dtype=np.float32)
    samples = (radiance, face, face_light, blocked, ambient, weights)
    in_bands(_lit_means, radiance.shape[0], *samples, out, least=_LEAST_POINTS)
    return out


@kernel()
def _lit_means(
    low: int, high: int, radiance: NDArray[np.float32], face: NDArray[np.int32], face_light: NDArray[np.float64],
    blocked: NDArray[np.uint64], ambient: float, weights: NDArray[np.float64], out: NDArray[np.float32],
) -> None:  # fmt: skip
    samples, lamps = radiance.shape[1], face_light.shape[1]
    for n in range(np.uint64(low), np.uint64(high)):
        mean, dark = 0.0, blocked[n]
        for k in range(samples):
            light = ambient
            for lamp in range(lamps):
                value = face_light[face[n, k], lamp]
                if value >= 0.0:
                    light += value
                elif (dark >> np.uint64(lamp)) & np.uint64(1) == np.uint64(0):
                    light -= value
            mean += weights[k] * light * np.float64(radiance[n, k])
        out[n] = mean
