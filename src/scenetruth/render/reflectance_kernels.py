"""Kernels for the reflection of surfaces: GGX microfacets, Fresnel reflection, and their directional albedo."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel
from scenetruth.threads import in_bands

__all__ = [
    "AZIMUTHS",
    "COSINES",
    "albedo_tables",
    "entering",
    "frame_of",
    "fresnel",
    "in_frame",
    "mean_entering",
    "reflect_ambient",
    "reflect_light",
    "reflect_ray",
    "towards",
]

COSINES, AZIMUTHS = 64, 17
"""Nodes of the tables of directional albedo: in the root of the cosine from 0 to 1; in azimuth from 0 to 90°."""
_ROUND, _ACROSS = 48, 96  # nodes of the integrals over the visible normals: around the direction, across
_LEAST_COSINE = 1e-4  # of directions along the surface, where the model has a limit
_LEAST_POINTS = 4096


@kernel()
def fresnel(cosine: float, index: float) -> Any:
    """Return the reflectance of a dielectric of a refractive index for unpolarised light, from outside.

    ``cosine``: Of the angle between light and normal.
    """
    inside = np.sqrt(index * index - 1.0 + cosine * cosine)
    across = (cosine - inside) / (cosine + inside)
    along = (index * index * cosine - inside) / (index * index * cosine + inside)
    return 0.5 * (across * across + along * along)


@subkernel()
def _slope(x: float, y: float, z: float, along: float, wide: float) -> Any:
    """Return Λ of Smith for a direction in the frame of the surface (Heitz 2014, eq. 86)."""
    ratio = ((along * x) ** 2 + (wide * y) ** 2) / max(z * z, 1e-300)
    return 0.5 * (np.sqrt(1.0 + ratio) - 1.0)


@subkernel()
def _facets(view: tuple[Any, ...], light: tuple[Any, ...], half: tuple[Any, ...], along: float, wide: float) -> Any:
    """Return π D G / (4 cos θ_v), the reflectance of perfect mirrors times π cos θ_l.

    G is the product of the masking of both directions, which are taken as independent.
    """
    x, y, z = half[0] / along, half[1] / wide, half[2]
    spread = x * x + y * y + z * z
    shadowing = (1.0 + _slope(*view, along, wide)) * (1.0 + _slope(*light, along, wide))
    return 1.0 / (along * wide * spread * spread * shadowing * 4.0 * view[2])


@subkernel()
def _visible_albedo(view: tuple[Any, ...], index: float, along: float, wide: float) -> Any:
    """Return the directional albedo of one reflection, by the visible normals (Dupuy and Benyoub 2023).

    ``index``: Refractive index of dielectrics; 0 for perfect mirrors; -1 for the part (1 - cos)^5 of Schlick.
    """
    length = np.sqrt((along * view[0]) ** 2 + (wide * view[1]) ** 2 + view[2] ** 2)
    vx, vy, vz = along * view[0] / length, wide * view[1] / length, view[2] / length
    total = 0.0
    for j in range(_ACROSS):
        z = (1.0 - (j + 0.5) / _ACROSS) * (1.0 + vz) - vz
        radius = np.sqrt(max(1.0 - z * z, 0.0))
        for i in range(_ROUND):
            angle = 2.0 * np.pi * (i + 0.5) / _ROUND
            hx, hy, hz = along * (radius * np.cos(angle) + vx), wide * (radius * np.sin(angle) + vy), max(z + vz, 0.0)
            size = np.sqrt(hx * hx + hy * hy + hz * hz)
            hx, hy, hz = hx / size, hy / size, hz / size
            cosine = hx * view[0] + hy * view[1] + hz * view[2]
            lx, ly, lz = 2.0 * cosine * hx - view[0], 2.0 * cosine * hy - view[1], 2.0 * cosine * hz - view[2]
            if lz <= 0.0 or cosine <= 0.0:
                continue
            part = 1.0 / (1.0 + _slope(lx, ly, lz, along, wide))
            if index > 0.0:
                part *= fresnel(cosine, index)
            elif index < 0.0:
                part *= (1.0 - cosine) ** 5
            total += part
    return total / (_ACROSS * _ROUND)


@kernel()
def albedo_tables(index: float, along: float, wide: float) -> Any:
    """Return the directional albedo of GGX microfacets at the nodes, shape (COSINES, AZIMUTHS).

    ``index``: As for `_visible_albedo`. ``along``, ``wide``: Roughness along and across the direction of azimuth 0.
    """
    table = np.empty((COSINES, AZIMUTHS))
    for i in range(COSINES):
        z = max((i / (COSINES - 1)) ** 2, _LEAST_COSINE)
        level = np.sqrt(max(1.0 - z * z, 0.0))
        for j in range(AZIMUTHS):
            if j > 0 and along == wide:
                table[i, j] = table[i, 0]
                continue
            angle = 0.5 * np.pi * j / (AZIMUTHS - 1)
            table[i, j] = _visible_albedo((level * np.cos(angle), level * np.sin(angle), z), index, along, wide)
    return table


@subkernel()
def _table_place(table: NDArray[np.float64], direction: tuple[Any, ...]) -> Any:
    """Return the place of a direction in the frame of the surface, on either side, in a table of directional albedo.

    Cosine and azimuth, as nodes and fractions of the step to the next; -1 for the azimuth if all are equal.
    """
    x, y, z = direction
    place = np.sqrt(min(abs(z), 1.0)) * (COSINES - 1)
    i = min(int(place), COSINES - 2)
    if AZIMUTHS == 1 or table[i, 0] == table[i, AZIMUTHS - 1]:
        return i, place - i, -1, 0.0
    turn = np.arctan2(abs(y), abs(x)) / (0.5 * np.pi) * (AZIMUTHS - 1)
    j = min(int(turn), AZIMUTHS - 2)
    return i, place - i, j, turn - j


@subkernel()
def _at_place(table: NDArray[np.float64], place: tuple[Any, ...]) -> Any:
    """Return the value of a table at a place."""
    i, level, j, turn = place
    if j < 0:
        return (1.0 - level) * table[i, 0] + level * table[i + 1, 0]
    low = (1.0 - turn) * table[i, j] + turn * table[i, j + 1]
    high = (1.0 - turn) * table[i + 1, j] + turn * table[i + 1, j + 1]
    return (1.0 - level) * low + level * high


@subkernel()
def _interpolate(table: NDArray[np.float64], direction: tuple[Any, ...]) -> Any:
    """Return the value of a table of directional albedo for a direction in the frame of the surface."""
    return _at_place(table, _table_place(table, direction))


@subkernel()
def entering(tables: NDArray[np.float64], direction: tuple[Any, ...]) -> Any:
    """Return the shares of light that the boundary, and one reflection of mirrors, do not reflect."""
    place = _table_place(tables[1], direction)
    return 1.0 - _at_place(tables[0], place), 1.0 - _at_place(tables[1], place)


@kernel(error_model="numpy")
def mean_entering(
    corners: NDArray[np.float64], along: NDArray[np.float64], place: NDArray[np.float64], axis: NDArray[np.float64],
    tables: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Return the share of a lamp's light on faces, on either side, that the boundary does not reflect.

    ``corners``, ``along``: Of the faces, shape (m, 3, 3), and their directions of x, of any length, shape (m, 3).
    ``place``: Position of the lamp, or NaN for light in the direction ``axis``, shape (3,) each.
    """
    total, whole = 0.0, 0.0
    normal, away = np.empty(3), np.empty(3)
    for n in range(len(corners)):
        a, b, c = corners[n, 0], corners[n, 1], corners[n, 2]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            normal[k] = (b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i])
            away[k] = -axis[k] if np.isnan(place[k]) else place[k] - (a[k] + b[k] + c[k]) / 3.0
        area, far = np.sqrt((normal**2).sum()), np.sqrt((away**2).sum())
        if area == 0.0 or far == 0.0:
            continue
        light = in_frame(frame_of(normal / area, along[n]), away[0] / far, away[1] / far, away[2] / far)
        received = area * abs(light[2]) / (far * far)
        total += received * entering(tables, light)[0]
        whole += received
    return total / whole if whole > 0.0 else 0.0


def reflect_light(
    irradiance: NDArray[np.float64],
    to_light: NDArray[np.float64],
    view: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    surface: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
    factors: NDArray[np.float64],
    gloss: NDArray[np.float64],
) -> None:
    """Add the light of one lamp that points reflect or transmit towards the camera, in place.

    The radiance of a point is texture x ``factors`` + ``gloss``, shape (n,) each.

    ``irradiance``: At normal incidence, shape (n,). ``to_light``: Unit vectors towards the light, shape (n, 3).
    ``view``: Position of the camera, shape (3,); points and unit normals on the visible side, shape (n, 3); and face of
      each point, shape (n,).
    ``surface``: Directions of x on the faces, of any length, shape (m, 3); material of each face, shape (m,); and
      parameters and tables of the materials, `reflection.ReflectionTables`.
    """
    in_bands(_reflect_light, len(factors), irradiance, to_light, view, surface, factors, gloss, least=_LEAST_POINTS)


@kernel()
def _reflect_light(
    low: int, high: int, irradiance: NDArray[np.float64], to_light: NDArray[np.float64],
    view: tuple[NDArray[Any], ...], surface: tuple[NDArray[Any], ...], factors: NDArray[np.float64],
    gloss: NDArray[np.float64],
) -> None:  # fmt: skip
    origin, points, normals, faces = view
    tangents, materials, values, tables = surface
    for n in range(low, high):
        if irradiance[n] == 0.0:
            continue
        m = materials[faces[n]]
        frame = frame_of(normals[n], tangents[faces[n]])
        light = in_frame(frame, to_light[n, 0], to_light[n, 1], to_light[n, 2])
        eye = towards(frame, origin, points[n])
        factor, shine = reflect_ray(irradiance[n], light, eye, entering(tables[m], eye), values[m], tables[m])
        factors[n] += factor
        gloss[n] += shine


@subkernel()
def reflect_ray(
    irradiance: float, light: tuple[Any, ...], eye: tuple[Any, ...], leaving: tuple[Any, ...],
    values: NDArray[np.float64], tables: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Return factor and gloss of the light from one direction.

    ``light``, ``eye``: Unit vectors towards light and camera in the frame of the surface.
    ``leaving``: `entering` of ``eye``.
    ``values``, ``tables``: Of the material, see `reflection.ReflectionTables`.
    """
    index, along, wide, metal, through = values[0], values[1], values[2], values[3], values[4]
    incident = irradiance * abs(light[2])
    if light[2] <= 0.0 and through == 0.0:
        return 0.0, 0.0
    if index <= 1.0 and metal == 0.0:
        return incident * (values[9] if light[2] > 0.0 else through), 0.0
    into = entering(tables, light)
    base = leaving[0] * into[0]
    base *= (1.0 - metal) / (1.0 - values[5])
    if light[2] <= 0.0:
        return through * incident * base, 0.0
    hx, hy, hz = eye[0] + light[0], eye[1] + light[1], eye[2] + light[2]
    size = np.sqrt(hx * hx + hy * hy + hz * hz)
    half = (hx / size, hy / size, hz / size)
    cosine = min(half[0] * eye[0] + half[1] * eye[1] + half[2] * eye[2], 1.0)
    single = irradiance * _facets(eye, light, half, along, wide)
    # Light that is reflected more than once (Kulla and Conty 2017).
    again = incident * (leaving[1] * into[1]) / max(1.0 - values[6], 1e-12)
    grazing = (1.0 - cosine) ** 5
    factor = values[9] * incident * base + metal * (single * (1.0 - grazing) + again * (1.0 - values[8]))
    gloss = (1.0 - metal) * (single * fresnel(cosine, index) + again * values[7])
    return factor, gloss + metal * (single * grazing + again * values[8])


@subkernel()
def frame_of(normal: NDArray[np.float64], along: NDArray[np.float64]) -> Any:
    """Return tangent, bitangent and normal of a surface, with the tangent in the plane of a direction along it."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    off = nx * along[0] + ny * along[1] + nz * along[2]
    x, y, z = along[0] - off * nx, along[1] - off * ny, along[2] - off * nz
    size = max(np.sqrt(x * x + y * y + z * z), 1e-300)
    x, y, z = x / size, y / size, z / size
    return (x, y, z), (ny * z - nz * y, nz * x - nx * z, nx * y - ny * x), (nx, ny, nz)


@subkernel()
def in_frame(frame: tuple[Any, ...], x: float, y: float, z: float) -> Any:
    """Return the components of a vector in a frame."""
    a, b, c = frame
    return a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z


@subkernel()
def towards(frame: tuple[Any, ...], origin: NDArray[np.float64], point: NDArray[np.float64]) -> Any:
    """Return the unit vector from a point to the camera in a frame; along the surface at least."""
    dx, dy, dz = origin[0] - point[0], origin[1] - point[1], origin[2] - point[2]
    size = np.sqrt(dx * dx + dy * dy + dz * dz)
    x, y, z = in_frame(frame, dx / size, dy / size, dz / size)
    return x, y, max(z, _LEAST_COSINE)


def reflect_ambient(
    ambient: float,
    view: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    surface: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
    factors: NDArray[np.float64],
    gloss: NDArray[np.float64],
) -> None:
    """Add the light of equal radiance from all directions, in place; arguments as for `reflect_light`."""
    if ambient > 0.0:
        in_bands(_reflect_ambient, len(factors), ambient, view, surface, factors, gloss, least=_LEAST_POINTS)


@kernel()
def _reflect_ambient(
    low: int, high: int, ambient: float, view: tuple[NDArray[Any], ...], surface: tuple[NDArray[Any], ...],
    factors: NDArray[np.float64], gloss: NDArray[np.float64],
) -> None:  # fmt: skip
    origin, points, normals, faces = view
    tangents, materials, values, tables = surface
    for n in range(low, high):
        m = materials[faces[n]]
        metal, both = values[m, 3], values[m, 9] + values[m, 4]
        if values[m, 0] <= 1.0 and metal == 0.0:
            factors[n] += ambient * both
            continue
        seen = towards(frame_of(normals[n], tangents[faces[n]]), origin, points[n])
        coat, mirror = _interpolate(tables[m, 0], seen), _interpolate(tables[m, 1], seen)
        grazing, lost = _interpolate(tables[m, 2], seen), 1.0 - mirror
        factors[n] += ambient * (1.0 - metal) * both * (1.0 - coat)
        factors[n] += ambient * metal * (mirror - grazing + lost * (1.0 - values[m, 8]))
        gloss[n] += ambient * ((1.0 - metal) * coat + metal * (grazing + lost * values[m, 8]))
