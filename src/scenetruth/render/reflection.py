"""Reflection by materials: gloss, metal, and light that passes sheets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import as_number
from scenetruth.raycast import RayCaster, ShadowCaster, Topology
from scenetruth.render.area_lamps import AreaLamps, SeenPoints, Surface
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lamp, Lighting
from scenetruth.scene.material import Material

__all__ = ["Reflection", "ReflectionTables", "SeenPoints", "light_of", "pack_materials"]

_MIX = np.uint64(0x9E3779B97F4A7C15)  # multiplier that combines the zones of all lights into one number
_MOST_GROUPS = 64  # number of surfaces that cast shadows up to which one search finds those above a point


class ReflectionTables(NamedTuple):
    """Materials as arrays for `reflectance_kernels`."""

    values: NDArray[np.float64]
    """For each material: refractive index, roughness along and across, metallic fraction, transmittance, mean albedo of
    the boundary, mean albedo of mirrors, and the share of light reflected by further microfacets: of the boundary,
    of black metal; and diffuse reflectance. Shape (k, 10).
    """
    tables: NDArray[np.float64]
    """Directional albedo of the boundary, of mirrors, and the part of mirrors that is weighted by (1 - cos)^5, at the
    nodes of `albedo_tables`; shape (k, 3, COSINES, AZIMUTHS).
    """


def pack_materials(materials: Sequence[Material]) -> ReflectionTables:
    """Return the parameters and tables of materials, with one row each."""
    rows = [_pack(item.refractive_index, *_roughness(item), item.metallic, *_shares(item)) for item in materials]
    return ReflectionTables(np.array([row for row, _ in rows]), np.array([table for _, table in rows]))


def _roughness(material: Material) -> tuple[float, float]:
    """Return the roughness along and across."""
    across = material.roughness
    return (across if material.roughness_along is None else material.roughness_along), across


def _shares(material: Material) -> tuple[float, float]:
    """Return the transmittance and the diffuse reflectance."""
    return as_number(material.transmittance), as_number(material.reflectance)


@lru_cache(maxsize=64)
def _pack(
    index: float, along: float, across: float, metallic: float, transmittance: float, reflectance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the row and the tables of one material."""
    from scenetruth.render.reflectance_kernels import AZIMUTHS, COSINES, albedo_tables

    values = np.array([index, along, across, metallic, transmittance, 0.0, 0.0, 0.0, 0.0, reflectance])
    tables = np.zeros((3, COSINES, AZIMUTHS))
    if index == 1.0 and metallic == 0.0:
        return values, tables
    single, mirror, grazing = (albedo_tables(kind, along, across) for kind in (index, 0.0, -1.0))
    mirror_mean = _mean(mirror)
    # Mean Fresnel reflectance of the facets, for light reflected again and again.
    cosines = (np.arange(2000) + 0.5) / 2000
    facets = (_fresnel(cosines, index), (1 - cosines) ** 5)
    means = [2 * float(np.mean(reflectance * cosines)) for reflectance in facets]
    further = [mean**2 * mirror_mean / (1 - mean * (1 - mirror_mean)) for mean in means]
    boundary = single + (1 - mirror) * further[0]
    values[5:9] = _mean(boundary), mirror_mean, *further
    return values, np.stack([boundary, mirror, grazing])


def _fresnel(cosines: NDArray[np.float64], index: float) -> NDArray[np.float64]:
    from scenetruth.render.reflectance_kernels import fresnel

    return np.array([fresnel(float(cosine), index) for cosine in cosines])


def _mean(table: NDArray[np.float64]) -> float:
    """Return the mean of a directional albedo over all directions, by cosine, as the kernels interpolate it."""
    # Between nodes of s, the root of the cosine: the integral of 4 s³ E(s); azimuths by the trapezoidal rule.
    edges = np.linspace(0, 1, len(table))
    low, high = edges[:-1], edges[1:]
    whole, first = high**4 - low**4, 4 * (high**5 - low**5) / 5
    weights = np.zeros(len(table))
    weights[:-1] += (high * whole - first) / (high - low)
    weights[1:] += (first - low * whole) / (high - low)
    azimuths = np.ones(table.shape[1])
    azimuths[[0, -1]] = 0.5
    return float(weights @ table @ azimuths / azimuths.sum())


def light_of(
    lamp: Lamp, points_mm: NDArray[np.float64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """Return the light of a lamp on points, see `shading_kernels.direct_light`."""
    from scenetruth.render.shading_kernels import DARK, direct_light

    light, zone, to_light, distance = direct_light(
        points_mm,
        normals,
        np.zeros(3) if lamp.position_mm is None else lamp.position_mm,
        lamp.axis,
        lamp.position_mm is None,
        lamp.irradiance,
        lamp.reference_distance_mm,
        lamp.cos_inner,
        lamp.cos_outer,
    )
    if lamp.beam is not None:
        share = lamp.relative_intensity(to_light)
        light *= share
        zone[share == 0] = DARK
    return light, zone, to_light, distance


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Surfaces of one material, or of all opaque materials, that cast shadows.

    ``numbers``: Index of each face of the scene among these faces, -1 for others, shape (m,).
    ``material``: Index of the material; -1 for opaque surfaces.
    """

    caster: ShadowCaster
    numbers: NDArray[np.int32]
    material: int

    @classmethod
    def of(cls, caster: RayCaster, faces: NDArray[np.int64], topology: Topology, material: int) -> _Sheet:
        numbers = np.full(len(caster.topology.faces), -1, dtype=np.int32)
        numbers[faces] = np.arange(len(faces), dtype=np.int32)
        return cls(ShadowCaster(caster.vertices_mm, topology), numbers, material)

    @cached_property
    def sphere(self) -> tuple[NDArray[np.float64], float]:
        """Centre and radius of a sphere around the surfaces, mm."""
        vertices = self.caster.vertices_mm[np.unique(self.caster.topology.faces)]
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        return centre, 1.001 * float(np.linalg.norm(vertices - centre, axis=1).max())

    def hides(
        self,
        lamp: Lamp,
        starts_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        wanted: NDArray[np.bool_],
        to_light: NDArray[np.float64],
        distance_mm: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return which wanted points lie in the shadow of these surfaces, shape (n,)."""
        from scenetruth.render.shading_kernels import behind_sphere

        hidden = np.zeros(len(faces), dtype=np.bool_)
        reached = np.flatnonzero(behind_sphere(starts_mm, wanted, *self.sphere, lamp.axis, lamp.position_mm))
        if not len(reached):
            return hidden
        some = starts_mm[reached], self.numbers[faces[reached]]
        if lamp.position_mm is None:
            hidden[reached] = self.caster.blocked_parallel(*some, np.ones(len(reached), dtype=np.bool_), -lamp.axis)
        else:
            hidden[reached] = self.caster.blocked(*some, to_light[reached], distance_mm[reached])
        return hidden


class Reflection:
    """Light that surfaces of any material reflect and transmit towards the camera."""

    def __init__(self, lighting: Lighting, world: BuiltScene, *, confirmed: bool = True) -> None:
        self._lighting = lighting
        self._confirmed = confirmed  # see `ShadowCaster.blocked_parallel`
        self._shadows: tuple[ShadowCaster, NDArray[np.uint8]] | None = None
        self._world = world
        self._tangent: tuple[RayCaster, NDArray[np.float64]] | None = None
        self._kinds: list[tuple[NDArray[np.int64], Topology, int]] | None = None
        self._sheets: tuple[RayCaster, list[_Sheet]] | None = None
        self._passing: tuple[RayCaster, dict[bytes, NDArray[np.float64]]] | None = None

    def light(
        self, caster: RayCaster, lamps: list[Lamp], place: SeenPoints, optics: ReflectionTables | None = None,
        *, centres: bool = False, states_only: bool = False,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64], NDArray[np.uint64]]:  # fmt: skip
        """Compute factors, gloss, state numbers and blocked lamps of points, see `shading.Arrived`.

        ``optics``: Parameters of the reflecting points in place of those of their materials, which cast the shadows.
        ``centres``: Whether the points are those at the pixel centres of the prepared image.
        ``states_only``: Whether factors and gloss are left at 0.
        """
        from scenetruth.render.reflectance_kernels import reflect_ambient, reflect_light

        view, surface = place.view, self._surface(caster, optics)
        _, points_mm, normals, faces = view
        factors, gloss = np.zeros((2, len(points_mm)))
        state, blocked = np.zeros((2, len(points_mm)), dtype=np.uint64)
        ambient = self._lighting.ambient_irradiance
        fine = None if states_only else self._areas.ambient(caster, ambient, lamps, place, surface)
        if fine is not None:
            factors, gloss = fine.T.copy()
        elif not states_only:
            reflect_ambient(ambient, view, surface, factors, gloss)
        through = self._optics.values[self._world.face_material[faces], 4] > 0
        for number, lamp in enumerate(lamps):
            if lamp.area is not None:
                # Without a state: borders of penumbrae are smooth.
                if states_only:
                    continue
                light = self._areas.light(caster, number, lamp, place, surface)
                factors += light[:, 0]
                gloss += light[:, 1]
                continue
            if lamp.position_mm is None:
                to_light = np.broadcast_to(-lamp.axis, points_mm.shape)
            else:
                to_light = lamp.position_mm - points_mm
                to_light /= np.linalg.norm(to_light, axis=1)[:, None]
            # At normal incidence.
            light, zone, to_light, distance = light_of(lamp, points_mm, np.ascontiguousarray(to_light))
            facing = np.einsum("nk,nk->n", normals, to_light)
            front, back = facing > 0, (facing < 0) & through
            light[~(front | back)], zone[~(front | back)] = 0.0, 0
            # Light on the other side of a sheet has zones of its own.
            zone[back & (zone > 0)] += 2
            dark = np.zeros(len(points_mm), dtype=np.bool_)
            if self._lighting.shadows:
                starts, share = np.where(front[:, None], place.starts_mm, points_mm), np.ones(len(points_mm))
                sheets, passing = self._sheets_at(caster), self._transmitted(caster, lamp)
                shades = None
                if lamp.position_mm is None and not self._confirmed and len(sheets) <= _MOST_GROUPS:
                    shades = self._shades_at(caster, sheets, starts, faces, light > 0, -lamp.axis)
                for kind, sheet in enumerate(sheets):
                    if shades is None:
                        hidden = sheet.hides(lamp, starts, faces, light > 0, to_light, distance)
                    else:
                        hidden = (shades >> np.uint64(kind)) & np.uint64(1) > 0
                    passed = 0.0 if sheet.material < 0 else float(passing[sheet.material])
                    light[hidden] *= passed
                    share[hidden] *= passed
                    dark |= hidden
                    # Points behind different sheets are in different shadows.
                    zone[hidden] = zone[hidden] * 3 + 1
                blocked |= dark.astype(np.uint64) << np.uint64(min(number, 63))
                if centres and place.pixels is not None:
                    self._areas.keep_shares(number, place.pixels, share)
            if not states_only:
                reflect_light(light, to_light, view, surface, factors, gloss)
            state = state * _MIX + zone
        return factors, gloss, state, blocked

    @cached_property
    def _areas(self) -> AreaLamps:
        values, material = self._optics.values, self._world.face_material
        glossy = (values[:, 0] > 1) | (values[:, 3] > 0)
        roughness = np.where(glossy, values[:, 1:3].min(axis=1), np.inf)
        return AreaLamps(
            self._world, lambda caster, lamp: self._transmitted(caster, lamp)[material], roughness[material],
            shadows=self._lighting.shadows,
        )  # fmt: skip

    def begin(
        self, caster: RayCaster, lamps: list[Lamp], place: SeenPoints, mixed: NDArray[np.bool_], pixel_angle: float
    ) -> None:
        """Prepare the lamps for one image, see `AreaLamps.begin`."""
        self._areas.begin(caster, lamps, place, self._surface(caster), mixed, pixel_angle)

    def steep(self) -> NDArray[np.bool_] | None:
        """Return the pixels of the prepared image at borders of sharp shadows of lamps with a size."""
        return self._areas.steep() if self._lighting.has_areas else None

    def mark_borders(self, borders: NDArray[np.bool_]) -> None:
        """Mark borders of sharp shadows in the prepared image, see `AreaLamps.mark_borders`."""
        self._areas.mark_borders(borders)

    def on_samples(
        self, caster: RayCaster, lamps: list[Lamp], origin_mm: NDArray[np.float64],
        samples: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]] | None:  # fmt: skip
        """Return factors and gloss of samples in a prepared image, see `AreaLamps.on_samples`."""
        surface = self._surface(caster)
        return self._areas.on_samples(caster, self._lighting.ambient_irradiance, lamps, origin_mm, samples, surface)

    def _surface(self, caster: RayCaster, optics: ReflectionTables | None = None) -> Surface:
        """Return tangents, materials, and tables of the faces, see `reflectance_kernels.reflect_light`."""
        return self._tangents(caster), self._world.face_material, *(optics or self._optics)

    @cached_property
    def _mean_transmittances(self) -> NDArray[np.float64]:
        """Share of the light inside each material that it transmits on average over the texture, shape (k,)."""
        shares = self._optics.values[:, 4].copy()
        for index in np.flatnonzero(shares):
            texture = self._world.bodies[self._world.materials[index][1]].texture
            shares[index] *= float(np.mean(texture.raster()))
        return shares

    def _transmitted(self, caster: RayCaster, lamp: Lamp) -> NDArray[np.float64]:
        """Return the share of a lamp's light that each material transmits, on average over texture and surface, (k,).

        Integrated over all directions, the transmitted light of a point is that which enters times the transmittance.
        """
        from scenetruth.render.reflectance_kernels import mean_entering

        if self._passing is None or self._passing[0] is not caster:
            self._passing = (caster, {})
        place = np.full(3, np.nan) if lamp.position_mm is None else np.asarray(lamp.position_mm, dtype=np.float64)
        axis = np.ascontiguousarray(lamp.axis, dtype=np.float64)
        kept, key = self._passing[1], place.tobytes() + axis.tobytes()
        if key not in kept:
            values, tables = self._optics
            found = self._mean_transmittances.copy()
            for index in np.flatnonzero((found > 0) & ((values[:, 0] > 1) | (values[:, 3] > 0))):
                faces = self._world.face_material == index
                corners = caster.vertices_mm[caster.topology.faces[faces]]
                entered = mean_entering(corners, self._tangents(caster)[faces], place, axis, tables[index])
                found[index] *= (1 - values[index, 3]) * entered
            kept[key] = found
        return kept[key]

    @cached_property
    def _optics(self) -> ReflectionTables:
        return pack_materials([material for material, _ in self._world.materials])

    def _tangents(self, caster: RayCaster) -> NDArray[np.float64]:
        """Return the directions of x on the faces, of any length, shape (m, 3)."""
        if self._tangent is None or self._tangent[0] is not caster:
            corners = caster.vertices_mm[caster.topology.faces]
            sides = corners[:, 1:] - corners[:, :1]
            chart = self._world.chart_mm
            across = chart[:, 1:] - chart[:, :1]
            # x increases along the combination of the two sides along which y of the chart does not change.
            weights = np.stack([across[:, 1, 1], -across[:, 0, 1]], axis=-1)
            weights *= np.sign(across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0])[:, None]
            found = np.einsum("mk,mkj->mj", weights, sides)
            flat = ~(np.linalg.norm(found, axis=1) > 0)
            found[flat] = sides[flat, 0]
            self._tangent = (caster, np.ascontiguousarray(found))
        return self._tangent[1]

    def _shades_at(
        self, caster: RayCaster, sheets: list[_Sheet], starts_mm: NDArray[np.float64], faces: NDArray[np.int32],
        wanted: NDArray[np.bool_], to_light: NDArray[np.float64],
    ) -> NDArray[np.uint64]:  # fmt: skip
        """Return the sheets in whose shadow under parallel light points are, one bit each from the lowest."""
        if self._shadows is None or self._shadows[0].vertices_mm is not caster.vertices_mm:
            kinds = np.zeros(len(self._world.faces), dtype=np.uint8)
            for kind, sheet in enumerate(sheets):
                kinds[sheet.numbers >= 0] = kind
            self._shadows = (ShadowCaster(caster.vertices_mm, caster.topology), kinds)
        shadows, kinds = self._shadows
        on_faces = not self._world.face_smooth.any()
        return shadows.groups_above(starts_mm, faces, wanted, to_light, kinds, on_faces=on_faces)

    def _sheets_at(self, caster: RayCaster) -> list[_Sheet]:
        """Return what casts shadows: all opaque surfaces together, and each surface that transmits light."""
        if self._sheets is None or self._sheets[0] is not caster:
            self._sheets = (caster, [_Sheet.of(caster, *part) for part in self._parts(caster)])
        return self._sheets[1]

    def _parts(self, caster: RayCaster) -> list[tuple[NDArray[np.int64], Topology, int]]:
        """Return faces, topology and material of what casts shadows, see `_Sheet`."""
        if self._kinds is None:
            world, values = self._world, self._optics.values[:, 4]
            through = values[world.face_material] > 0
            groups = [(np.flatnonzero(~through), -1)]
            groups += [(np.flatnonzero(world.face_material == n), int(n)) for n in np.flatnonzero(values > 0)]
            self._kinds = [
                (chosen, Topology.of(caster.vertices_mm, world.faces[chosen], world.crease_deg[chosen]), material)
                for chosen, material in groups
                if len(chosen)
            ]
        return self._kinds
