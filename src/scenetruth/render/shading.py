"""Shading for all backends: irradiance at surface points and pixels, gloss, and light through sheets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast import Hits, RayCaster, ShadowCaster, Topology
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lamp, Lighting
from scenetruth.scene.material import Optics, pack_materials

__all__ = ["Arrived", "PixelLight", "Shader"]

_MIX = np.uint64(0x9E3779B97F4A7C15)  # multiplier that combines the zones of all lights into one number

# Pixel difference, as a fraction of the brightest pixel, above which every sample is shaded separately.
_STEEPEST = 0.05


@dataclass(frozen=True, eq=False)
class PixelLight:
    """Illumination of the surface points at the pixel centres of one image.

    ``shade``: Irradiance that the texture reflects, shape (height, width); 1 without a surface.
    ``face``: Face index, shape (height, width), -1 for none.
    ``mixed``: Pixels whose footprint crosses an edge, shape (height, width).
    ``uneven``: Pixels with non-smooth irradiance, shape (height, width): at its borders, or at steep gradients.
    ``borders``: Pixels at the borders of shadows and light cones, shape (height, width).
    ``blocked``: Lamps that do not reach the point because of a shadow, one bit each from the lowest, uint64, shape
      (height, width).
    ``gloss``: Radiance that does not depend on the texture, shape (height, width); None if all surfaces are matt.
    """

    shade: NDArray[np.float64]
    face: NDArray[np.int32]
    mixed: NDArray[np.bool_]
    uneven: NDArray[np.bool_]
    borders: NDArray[np.bool_]
    blocked: NDArray[np.uint64]
    gloss: NDArray[np.float64] | None = None

    def on(self, albedo: NDArray[np.float32], unknown: NDArray[np.bool_], variance_px2: float) -> NDArray[np.float32]:
        """Shade an image of the mean albedo over the pixel footprints, shape (height, width)."""
        from scenetruth.render.shading_kernels import shade_image

        shaded: NDArray[np.float32] = shade_image(
            albedo, self.shade, self.face, self.mixed, unknown, self.uneven, variance_px2
        )
        if self.gloss is not None:
            shaded += self.mean_gloss(unknown, variance_px2)
        return shaded

    def mean_gloss(self, unknown: NDArray[np.bool_], variance_px2: float) -> NDArray[np.float32]:
        """Return the mean gloss over the pixel footprints; 0 for unknown pixels and without a surface."""
        from scenetruth.render.shading_kernels import shade_image

        if self.gloss is None:
            return np.zeros(self.face.shape, dtype=np.float32)
        seen = (self.face >= 0) & ~unknown
        white = np.ascontiguousarray(seen, dtype=np.float32)
        return shade_image(white, self.gloss, self.face, self.mixed, unknown, self.uneven, variance_px2)


class Arrived(NamedTuple):
    """Light that arrives at points and leaves them towards the camera.

    The radiance is texture x ``factors`` + ``gloss``. ``gloss`` is None if all surfaces are matt. ``state``: Numbers
    that differ between points lit by different lights or cone zones. ``blocked``: See `PixelLight`. Shape (n,) each.
    """

    factors: NDArray[np.float64]
    gloss: NDArray[np.float64] | None
    state: NDArray[np.uint64]
    blocked: NDArray[np.uint64]

    def on(self, albedo: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the radiance of the points, shape (n,)."""
        lit: NDArray[np.float32] = albedo * self.factors.astype(np.float32)
        return lit if self.gloss is None else lit + self.gloss.astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Surfaces that cast shadows of one transmittance.

    ``numbers``: Index of each face of the scene among these faces, -1 for others, shape (m,).
    """

    caster: ShadowCaster
    numbers: NDArray[np.int32]
    transmittance: float

    @classmethod
    def of(cls, caster: RayCaster, faces: NDArray[np.int64], topology: Topology, transmittance: float) -> _Sheet:
        numbers = np.full(len(caster.topology.faces), -1, dtype=np.int32)
        numbers[faces] = np.arange(len(faces), dtype=np.int32)
        return cls(ShadowCaster(caster.vertices_mm, topology), numbers, transmittance)

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
        own = self.numbers[faces]
        if lamp.position_mm is None:
            return self.caster.blocked_parallel(starts_mm, own, wanted, -lamp.axis)
        hidden = np.zeros(len(faces), dtype=np.bool_)
        reached = np.flatnonzero(wanted)
        hidden[reached] = self.caster.blocked(starts_mm[reached], own[reached], to_light[reached], distance_mm[reached])
        return hidden


class Shader:
    """Shading of two-sided surfaces.

    The normal is oriented towards the camera. It is that of the flat triangle, or, on smooth meshes, interpolated
    between the exact normals at the corners, with an error quadratic in the triangle size.
    """

    def __init__(self, lighting: Lighting, world: BuiltScene) -> None:
        self._lighting = lighting
        self._world = world
        self._corner_normals: tuple[float, NDArray[np.float64]] | None = None
        self._shadows: ShadowCaster | None = None
        self._tangent: tuple[RayCaster, NDArray[np.float64]] | None = None
        self._kinds: list[tuple[NDArray[np.int64], Topology, float]] | None = None
        self._sheets: tuple[RayCaster, list[_Sheet]] | None = None
        self.matt = all(body.material.matt for body in world.bodies)

    def arrived(
        self, caster: RayCaster, t: float, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], hits: Hits
    ) -> Arrived:
        """Compute the light at ray hits.

        For matt surfaces, the factors are ambient + sum of E falloff max(0, n l) over the unblocked lights; 1 without a
        hit, where gloss is 0.
        """
        from scenetruth.render.shading_kernels import facing_points

        seen = np.flatnonzero(hits.face >= 0)
        points, normals = facing_points(
            np.asarray(origin_mm, dtype=np.float64),
            np.ascontiguousarray(directions),
            hits.depth,
            hits.face,
            seen,
            caster.face_normals,
        )
        starts = self._smooth(caster, t, points, normals, hits, seen) if self._world.face_smooth.any() else points
        lamps = self._lighting.lamps_at(t)
        factors, (state, blocked) = np.ones(len(directions)), np.zeros((2, len(directions)), dtype=np.uint64)
        gloss = None
        if self.matt:
            found = self.irradiance(caster, lamps, points, normals, hits.face[seen], starts)
            factors[seen], state[seen], blocked[seen] = found
        else:
            gloss = np.zeros(len(directions))
            origin = np.asarray(origin_mm, dtype=np.float64)
            factors[seen], gloss[seen], state[seen], blocked[seen] = self._reflected(
                caster, lamps, origin, points, normals, hits.face[seen], starts
            )
        return Arrived(factors, gloss, state, blocked)

    def _reflected(
        self,
        caster: RayCaster,
        lamps: list[Lamp],
        origin_mm: NDArray[np.float64],
        points_mm: NDArray[np.float64],
        normals: NDArray[np.float64],
        faces: NDArray[np.int32],
        starts_mm: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64], NDArray[np.uint64]]:
        """Compute factors, gloss, state numbers and blocked lamps of points on surfaces of any material.

        Arguments as for `irradiance`; ``origin_mm``: position of the camera.
        """
        from scenetruth.render.reflectance_kernels import reflect_ambient, reflect_light
        from scenetruth.render.shading_kernels import direct_light

        material = self._world.face_body[faces]
        view = (origin_mm, points_mm, normals, faces)
        surface = (self._tangents(caster), self._world.face_body, *self._optics)
        factors, gloss = np.zeros((2, len(points_mm)))
        state, blocked = np.zeros((2, len(points_mm)), dtype=np.uint64)
        reflect_ambient(self._lighting.ambient or 0.0, view, surface, factors, gloss)
        through = self._optics.values[material, 4] > 0
        for number, lamp in enumerate(lamps):
            if lamp.position_mm is None:
                to_light = np.broadcast_to(-lamp.axis, points_mm.shape)
            else:
                to_light = lamp.position_mm - points_mm
                to_light /= np.linalg.norm(to_light, axis=1)[:, None]
            # At normal incidence.
            light, zone, to_light, distance = direct_light(
                points_mm,
                np.ascontiguousarray(to_light),
                np.zeros(3) if lamp.position_mm is None else lamp.position_mm,
                lamp.axis,
                lamp.position_mm is None,
                lamp.irradiance,
                lamp.reference_distance_mm,
                lamp.cos_inner,
                lamp.cos_outer,
            )
            facing = np.einsum("nk,nk->n", normals, to_light)
            front, back = facing > 0, (facing < 0) & through
            light[~(front | back)], zone[~(front | back)] = 0.0, 0
            # Light on the other side of a sheet has zones of its own.
            zone[back & (zone > 0)] += 2
            dark = np.zeros(len(points_mm), dtype=np.bool_)
            if self._lighting.shadows:
                from_where = np.where(front[:, None], starts_mm, points_mm)
                for sheet in self._sheets_at(caster):
                    hidden = sheet.hides(lamp, from_where, faces, light > 0, to_light, distance)
                    light[hidden] *= sheet.transmittance
                    dark |= hidden
                    # Points behind different sheets are in different shadows.
                    zone[hidden] = zone[hidden] * 3 + 1
                blocked |= dark.astype(np.uint64) << np.uint64(min(number, 63))
            reflect_light(light, to_light, view, surface, factors, gloss)
            state = state * _MIX + zone
        return factors, gloss, state, blocked

    @cached_property
    def _optics(self) -> Optics:
        return pack_materials([body.material for body in self._world.bodies])

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

    def _sheets_at(self, caster: RayCaster) -> list[_Sheet]:
        """Return what casts shadows: all opaque surfaces together, and each surface that transmits light."""
        if self._sheets is None or self._sheets[0] is not caster:
            self._sheets = (caster, [_Sheet.of(caster, *part) for part in self._parts(caster)])
        return self._sheets[1]

    def _parts(self, caster: RayCaster) -> list[tuple[NDArray[np.int64], Topology, float]]:
        """Return faces, topology and transmittance of what casts shadows."""
        if self._kinds is None:
            world, values = self._world, self._optics.values[:, 4]
            through = values[world.face_body] > 0
            groups = [(np.flatnonzero(~through), 0.0)]
            for index in np.flatnonzero(values > 0):
                texture = world.bodies[index].texture
                mean = float(np.mean(texture.raster()))
                groups.append((np.flatnonzero(world.face_body == index), mean * float(values[index])))
            self._kinds = [
                (chosen, Topology.of(caster.vertices_mm, world.faces[chosen], world.crease_deg[chosen]), share)
                for chosen, share in groups
                if len(chosen)
            ]
        return self._kinds

    def irradiance(
        self,
        caster: RayCaster,
        lamps: list[Lamp],
        points_mm: NDArray[np.float64],
        normals: NDArray[np.float64],
        faces: NDArray[np.int32],
        starts_mm: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.uint64], NDArray[np.uint64]]:
        """Compute irradiance, state numbers (`factors`) and blocked lamps (`PixelLight`) of points, shape (n,) each.

        ``points_mm``, ``normals``: Points and unit normals on the visible side, shape (n, 3) each.
        ``faces``: Face of each point, shape (n,), which casts no shadow on it.
        ``starts_mm``: Origins of the shadow rays, shape (n, 3): the points, or points above them on a smooth surface.
        """
        from scenetruth.render.shading_kernels import add_light, direct_light

        total = np.full(len(points_mm), self._lighting.ambient or 0.0)
        state, blocked = np.zeros((2, len(points_mm)), dtype=np.uint64)
        for number, lamp in enumerate(lamps):
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
            dark = np.zeros(len(points_mm), dtype=np.bool_)
            if self._lighting.shadows:
                caster_of_shadows = self._shadow_caster(caster)
                if lamp.position_mm is None:
                    dark = caster_of_shadows.blocked_parallel(starts_mm, faces, light > 0, -lamp.axis)
                else:
                    reached = np.flatnonzero(light > 0)
                    dark[reached] = caster_of_shadows.blocked(
                        starts_mm[reached], faces[reached], to_light[reached], distance[reached]
                    )
                # Lamps beyond the 64th share a bit.
                blocked |= dark.astype(np.uint64) << np.uint64(min(number, 63))
            add_light(total, state, light, zone, dark)
        return total, state, blocked

    def face_light(self, caster: RayCaster, t: float, origin_mm: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the irradiance of flat faces on the side of a point by each lamp without shadows, shape (m, lamps).

        None if lamps at a finite distance, or more than 64, make it depend on more than the face.
        """
        lamps = self._lighting.lamps_at(t)
        if not self.matt or len(lamps) > 64 or any(lamp.position_mm is not None for lamp in lamps):
            return None
        normals = caster.face_normals
        corners = caster.vertices_mm[caster.topology.faces[:, 0]]
        side = np.where(np.einsum("mk,mk->m", normals, origin_mm - corners) > 0, 1.0, -1.0)
        facing = [-(normals @ lamp.axis) * side for lamp in lamps]
        light = [lamp.irradiance * np.maximum(cosine, 0.0) for lamp, cosine in zip(lamps, facing, strict=True)]
        return np.ascontiguousarray(np.array(light).reshape(len(lamps), -1).T)

    def on_pixels(
        self,
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        mixed: NDArray[np.bool_],
    ) -> PixelLight:
        """Return the illumination of the pixels of one image with mixed pixels, shape (height, width)."""
        from scenetruth.render.shading_kernels import uneven_pixels

        light = self.arrived(caster, t, origin_mm, directions, hits)
        shade, face = light.factors.reshape(mixed.shape), hits.face.reshape(mixed.shape)
        brightest = float(shade[face >= 0].max(initial=0.0))
        zones = light.state.reshape(mixed.shape)
        uneven, borders = uneven_pixels(shade, zones, face, mixed, _STEEPEST * brightest)
        gloss = None
        if light.gloss is not None:
            gloss = light.gloss.reshape(mixed.shape)
            uneven |= uneven_pixels(gloss, zones, face, mixed, _STEEPEST * max(brightest, float(gloss.max())))[0]
        return PixelLight(shade, face, mixed, uneven, borders, light.blocked.reshape(mixed.shape), gloss)

    def _smooth(
        self,
        caster: RayCaster,
        t: float,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        hits: Hits,
        seen: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        """Replace normals by those of smooth surfaces, in place, and return the origins of the shadow rays."""
        from scenetruth.render.shading_kernels import smooth_points

        if self._corner_normals is None or self._corner_normals[0] != t:
            self._corner_normals = (t, self._world.corner_normals_at(t))
        starts: NDArray[np.float64] = smooth_points(
            points,
            normals,
            hits.face[seen].astype(np.int64),
            np.ascontiguousarray(hits.weights[seen]),
            caster.vertices_mm[caster.topology.faces],
            self._corner_normals[1],
            self._world.face_smooth,
        )
        return starts

    def _shadow_caster(self, caster: RayCaster) -> ShadowCaster:
        if self._shadows is None or self._shadows.vertices_mm is not caster.vertices_mm:
            self._shadows = ShadowCaster(caster.vertices_mm, caster.topology)
        return self._shadows
