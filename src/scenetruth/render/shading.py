"""Shading for all backends: irradiance at surface points and pixels, gloss, and light through sheets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast import Hits, RayCaster, ShadowCaster
from scenetruth.render.reflection import Reflection, SeenPoints
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lamp, Lighting

__all__ = ["Arrived", "PixelLight", "Shader"]


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
        self.matt = all(material.matt for material, _ in world.materials)
        self._reflection = Reflection(lighting, world)

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
            place = SeenPoints(origin, points, normals, hits.face[seen], starts)
            factors[seen], gloss[seen], state[seen], blocked[seen] = self._reflection.light(caster, lamps, place)
        return Arrived(factors, gloss, state, blocked)

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
