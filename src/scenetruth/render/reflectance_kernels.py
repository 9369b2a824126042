"""Kernels for the reflection of surfaces: GGX microfacets, Fresnel reflection, and their directional albedo."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.threads import in_bands

__all__ = ["AZIMUTHS", "COSINES", "albedo_tables", "fresnel", "reflect_ambient", "reflect_light"]

COSINES, AZIMUTHS = 64, 17
"""Nodes of the tables of directional albedo: in the root of the cosine from 0 to 1; in azimuth from 0 to 90°."""
_ROUND, _ACROSS = 48, 48  # nodes of the integrals over the visible normals: around the direction, across
_LEAST_COSINE = 1e-4  # of directions along the surface, where the model has a limit
_LEAST_POINTS = 4096

@numba.njit(cache=True, nogil=True, error_model="numpy")
def fresnel(cosine: float, index: float) -> Any:
    """Return the reflectance of a dielectric of a refractive index for unpolarised light, from outside.

    ``cosine``: Of the angle between light and normal.
    """
    inside = np.sqrt(index * index - 1.0 + cosine * cosine)
    across = (cosine - inside) / (cosine + inside)
    along = (index * index * cosine - inside) / (index * index * cosine + inside)
    return 0.5 * (across * across + along * along)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _slope(x: float, y: float, z: float, along: float, wide: float) -> Any:
    """Return Λ of Smith for a direction in the frame of the surface (Heitz 2014, eq. 86)."""
    ratio = ((along * x) ** 2 + (wide * y) ** 2) / max(z * z, 1e-300)
    return 0.5 * (np.sqrt(1.0 + ratio) - 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _facets(view: tuple[Any, ...], light: tuple[Any, ...], half: tuple[Any, ...], along: float, wide: float) -> Any:
    """Return π D G / (4 cos θ_v), the reflectance of perfect mirrors times π cos θ_l."""
    x, y, z = half[0] / along, half[1] / wide, half[2]
    spread = x * x + y * y + z * z
    shadowing = 1.0 + _slope(*view, along, wide) + _slope(*light, along, wide)
    return 1.0 / (along * wide * spread * spread * shadowing * 4.0 * view[2])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _visible_albedo(view: tuple[Any, ...], index: float, along: float, wide: float) -> Any:
    """Return the directional albedo of one reflection, by the visible normals (Dupuy and Benyoub 2023).

    ``index``: Refractive index of dielectrics; 0 for perfect mirrors; -1 for the part (1 - cos)^5 of Schlick.
    """
    length = np.sqrt((along * view[0]) ** 2 + (wide * view[1]) ** 2 + view[2] ** 2)
    vx, vy, vz = along * view[0] / length, wide * view[1] / length, view[2] / length
    own = 1.0 + _slope(*view, along, wide)
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
            part = own / (own + _slope(lx, ly, lz, along, wide))
            if index > 0.0:
                part *= fresnel(cosine, index)
            elif index < 0.0:
                part *= (1.0 - cosine) ** 5
            total += part
    return total / (_ACROSS * _ROUND)


@numba.njit(cache=True, nogil=True, error_model="numpy")
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(table: NDArray[np.float64], x: float, y: float, z: float) -> Any:
    """Return the value of a table of directional albedo for a direction in the frame of the surface."""
    place = np.sqrt(min(max(z, 0.0), 1.0)) * (COSINES - 1)
    i = min(int(place), COSINES - 2)
    level = place - i
    if AZIMUTHS == 1 or table[i, 0] == table[i, AZIMUTHS - 1]:
        return (1.0 - level) * table[i, 0] + level * table[i + 1, 0]
    turn = np.arctan2(abs(y), abs(x)) / (0.5 * np.pi) * (AZIMUTHS - 1)
    j = min(int(turn), AZIMUTHS - 2)
    turn -= j
    low = (1.0 - turn) * table[i, j] + turn * table[i, j + 1]
    high = (1.0 - turn) * table[i + 1, j] + turn * table[i + 1, j + 1]
    return (1.0 - level) * low + level * high


def reflect_light(
    lit: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]],
    frames: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    material: NDArray[np.int32],
    optics: tuple[NDArray[np.float64], NDArray[np.float64]],
    diffuse: NDArray[np.float64],
    gloss: NDArray[np.float64],
) -> None:
    """Add the light of one lamp that points reflect or transmit towards the camera, in place.

    The radiance of a point is texture x ``diffuse`` + ``gloss``, shape (n,) each.

    ``lit``: Irradiance at normal incidence, shape (n,); unit vectors towards the light, shape (n, 3); and whether a
      point is in shadow, shape (n,).
    ``frames``: Unit normals on the visible side, unit tangents, and unit vectors towards the camera, shape (n, 3) each.
    ``material``: Row of each point in ``optics``, the parameters and tables of `scene.material.pack_materials`.
    """
    in_bands(_reflect_light, len(material), *lit, *frames, material, *optics, diffuse, gloss, least=_LEAST_POINTS)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _reflect_light(
    low: int, high: int, irradiance: NDArray[np.float64], to_light: NDArray[np.float64], dark: NDArray[np.bool_],
    normals: NDArray[np.float64], tangents: NDArray[np.float64], to_camera: NDArray[np.float64],
    material: NDArray[np.int32], values: NDArray[np.float64], tables: NDArray[np.float64],
    diffuse: NDArray[np.float64], gloss: NDArray[np.float64],
) -> None:  # fmt: skip
    for n in range(low, high):
        if dark[n] or irradiance[n] == 0.0:
            continue
        m = material[n]
        index, along, wide, metal, through = values[m, 0], values[m, 1], values[m, 2], values[m, 3], values[m, 4]
        light = _in_frame(to_light[n], normals[n], tangents[n])
        incident = irradiance[n] * abs(light[2])
        if light[2] <= 0.0 and through == 0.0:
            continue
        if index <= 1.0 and metal == 0.0:
            diffuse[n] += incident * (1.0 if light[2] > 0.0 else through)
            continue
        view = _in_frame(to_camera[n], normals[n], tangents[n])
        view = (view[0], view[1], max(view[2], _LEAST_COSINE))
        coat, mirror = tables[m, 0], tables[m, 1]
        base = (1.0 - _interpolate(coat, *view)) * (1.0 - _interpolate(coat, light[0], light[1], abs(light[2])))
        base *= (1.0 - metal) / (1.0 - values[m, 5])
        if light[2] <= 0.0:
            diffuse[n] += through * incident * base
            continue
        hx, hy, hz = view[0] + light[0], view[1] + light[1], view[2] + light[2]
        size = np.sqrt(hx * hx + hy * hy + hz * hz)
        half = (hx / size, hy / size, hz / size)
        cosine = min(half[0] * view[0] + half[1] * view[1] + half[2] * view[2], 1.0)
        single = irradiance[n] * _facets(view, light, half, along, wide)
        # Light that is reflected more than once (Kulla and Conty 2017).
        lost = (1.0 - _interpolate(mirror, *view)) * (1.0 - _interpolate(mirror, *light))
        again = incident * lost / max(1.0 - values[m, 6], 1e-12)
        grazing = (1.0 - cosine) ** 5
        diffuse[n] += incident * base + metal * (single * (1.0 - grazing) + again * (1.0 - values[m, 8]))
        gloss[n] += (1.0 - metal) * (single * fresnel(cosine, index) + again * values[m, 7])
        gloss[n] += metal * (single * grazing + again * values[m, 8])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _in_frame(vector: NDArray[np.float64], normal: NDArray[np.float64], tangent: NDArray[np.float64]) -> Any:
    """Return the components of a vector along tangent, bitangent and normal."""
    x = tangent[0] * vector[0] + tangent[1] * vector[1] + tangent[2] * vector[2]
    z = normal[0] * vector[0] + normal[1] * vector[1] + normal[2] * vector[2]
    bx, by = normal[1] * tangent[2] - normal[2] * tangent[1], normal[2] * tangent[0] - normal[0] * tangent[2]
    bz = normal[0] * tangent[1] - normal[1] * tangent[0]
    return x, bx * vector[0] + by * vector[1] + bz * vector[2], z


def reflect_ambient(
    ambient: float,
    frames: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    material: NDArray[np.int32],
    optics: tuple[NDArray[np.float64], NDArray[np.float64]],
    diffuse: NDArray[np.float64],
    gloss: NDArray[np.float64],
) -> None:
    """Add the light of equal radiance from all directions, in place; arguments as for `reflect_light`."""
    in_bands(_reflect_ambient, len(material), ambient, *frames, material, *optics, diffuse, gloss, least=_LEAST_POINTS)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _reflect_ambient(
    low: int, high: int, ambient: float, normals: NDArray[np.float64], tangents: NDArray[np.float64],
    to_camera: NDArray[np.float64], material: NDArray[np.int32], values: NDArray[np.float64],
    tables: NDArray[np.float64], diffuse: NDArray[np.float64], gloss: NDArray[np.float64],
) -> None:  # fmt: skip
    for n in range(low, high):
        m = material[n]
        metal, both = values[m, 3], 1.0 + values[m, 4]
        if values[m, 0] <= 1.0 and metal == 0.0:
            diffuse[n] += ambient * both
            continue
        view = _in_frame(to_camera[n], normals[n], tangents[n])
        coat, mirror = _interpolate(tables[m, 0], *view), _interpolate(tables[m, 1], *view)
        grazing = _interpolate(tables[m, 2], *view)
        lost = 1.0 - mirror
        diffuse[n] += ambient * (1.0 - metal) * both * (1.0 - coat)
        diffuse[n] += ambient * metal * (mirror - grazing + lost * (1.0 - values[m, 8]))
        gloss[n] += ambient * ((1.0 - metal) * coat + metal * (grazing + lost * values[m, 8]))
