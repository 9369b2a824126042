"""Shading for all backends: irradiance at surface points and pixels, gloss, and light through sheets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast import Changes, Hits, RayCaster, ShadowCaster, SurfaceLines
from scenetruth.render.area_lamps import SeenPoints, largest_pixel_angle
from scenetruth.render.reflection import Reflection, ReflectionTables, light_of
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lamp, Lighting

__all__ = ["Arrived", "FaceLight", "PixelLight", "Shader"]

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
    ``gloss``: Radiance that does not depend on the texture, shape (height, width); None with matt surfaces and lamps
      without a size only.
    ``steep``: Pixels in steep penumbrae, shape (height, width); None without lamps with a size.
    """

    shade: NDArray[np.float64]
    face: NDArray[np.int32]
    mixed: NDArray[np.bool_]
    uneven: NDArray[np.bool_]
    borders: NDArray[np.bool_]
    blocked: NDArray[np.uint64]
    gloss: NDArray[np.float64] | None = None
    steep: NDArray[np.bool_] | None = None

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

    The radiance is texture x ``factors`` + ``gloss``. ``gloss`` is None with matt surfaces and lamps without a size
    only. ``state``: Numbers that differ between points lit by different lights or cone zones. ``blocked``: See
    `PixelLight`. Shape (n,) each.
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
class FaceLight:
    """Light of parallel lamps on flat faces, on the side of one viewpoint.

    ``by_lamp``: Irradiance by each lamp, shape (m, lamps): 0 in shadow, and negative where a border of a shadow may
      cross the face.
    ``total``: Irradiance by all lamps and the ambient light, as without such shadows, shape (m,).
    ``unsure``: Faces that a border may cross, shape (m,).
    ``bits``: Lamps, one bit each from the lowest, that light the face, that are blocked, and that are not decided,
      uint64, shape (3, m). Lamps behind the face have no bit.
    ``decided``: Whether shadows are decided, for all faces but those.
    ``borders``: Lines that contain the borders, None without shadows.
    ``meeting``: Faces that intersect others, shape (m,); empty if they are not determined.
    """

    by_lamp: NDArray[np.float64]
    total: NDArray[np.float64]
    unsure: NDArray[np.bool_]
    bits: NDArray[np.uint64]
    decided: bool
    borders: SurfaceLines | None
    meeting: NDArray[np.bool_]

    def without(self, faces: NDArray[np.int32], blocked: NDArray[np.uint64]) -> NDArray[np.float64]:
        """Return the irradiance of points on faces without the blocked lamps where they are not decided."""
        total = self.total[faces]
        for number, light in enumerate(self.by_lamp.T):
            out = (blocked >> np.uint64(number)) & np.uint64(1) > 0
            total += np.where(out, np.minimum(light[faces], 0.0), 0.0)
        return total


class Shader:
    """Shading of two-sided surfaces.

    The normal is oriented towards the camera. It is that of the flat triangle, or, on smooth meshes, interpolated
    between the exact normals at the corners, with an error quadratic in the triangle size.
    """

    def __init__(self, lighting: Lighting, world: BuiltScene, *, confirmed: bool = True) -> None:
        self._lighting = lighting
        self._confirmed = confirmed  # see `ShadowCaster.blocked_parallel`
        self._world = world
        self._corner_normals: tuple[float, NDArray[np.float64]] | None = None
        self._shadows: ShadowCaster | None = None
        self._lamps: tuple[float, list[Lamp]] | None = None
        self.simple = all(material.matt for material, _ in world.materials) and not lighting.has_areas
        self._reflection = Reflection(lighting, world, confirmed=confirmed)

    def arrived(
        self,
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        pixels: NDArray[np.int64] | None = None,
        mixed: NDArray[np.bool_] | None = None,
        optics: ReflectionTables | None = None,
        *,
        with_states: bool = False,
        states_only: bool = False,
    ) -> Arrived:
        """Compute the light at ray hits.

        For matt surfaces, the factors are ambient + sum of E falloff max(0, n l) over the unblocked lights; 1 without a
        hit, where gloss is 0.

        ``pixels``: Pixel of each ray, in an image whose centres have been computed before; shape (n,).
        ``mixed``: Mixed pixels, if the rays are those through the pixel centres of an image; shape (height, width).
        ``optics``: See `Reflection.light`; not with ``pixels``.
        ``with_states``: Whether state numbers are needed for samples of an image as well.
        ``states_only``: Whether only these are needed: other values may be wrong.
        """
        if pixels is not None and not self.simple and not with_states and (hits.face >= 0).all():
            origin, lamps = np.asarray(origin_mm, dtype=np.float64), self._lamps_at(t)
            quick = self._reflection.on_samples(caster, lamps, origin, (pixels, hits.face, hits.weights))
            if quick is not None:
                return self._complete(caster, t, origin, directions, hits, pixels, quick)
        return self._arrived(caster, t, origin_mm, directions, hits, pixels, mixed, optics, states_only=states_only)

    def _complete(
        self,
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        pixels: NDArray[np.int64],
        quick: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]],
    ) -> Arrived:
        """Add the samples without a value, see `Reflection.on_samples`."""
        factors, gloss, left = quick
        if len(left):
            some = Hits(hits.face[left], hits.depth[left], hits.weights[left])
            found = self._arrived(caster, t, origin_mm, directions[left], some, pixels[left], None, None)
            assert found.gloss is not None
            factors[left], gloss[left] = found.factors, found.gloss
        none = np.zeros(len(factors), dtype=np.uint64)
        return Arrived(factors, gloss, none, none)

    def _arrived(
        self,
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        pixels: NDArray[np.int64] | None,
        mixed: NDArray[np.bool_] | None,
        optics: ReflectionTables | None,
        *,
        states_only: bool = False,
    ) -> Arrived:
        """As `arrived`, for all rays."""
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
        lamps = self._lamps_at(t)
        factors, (state, blocked) = np.ones(len(directions)), np.zeros((2, len(directions)), dtype=np.uint64)
        gloss = None
        if self.simple and optics is None:
            found = self.irradiance(caster, lamps, points, normals, hits.face[seen], starts)
            factors[seen], state[seen], blocked[seen] = found
        else:
            origin = np.asarray(origin_mm, dtype=np.float64)
            hit = np.s_[:] if len(seen) == len(directions) else seen
            own = None if pixels is None else pixels[hit]
            place = SeenPoints(origin, points, normals, hits.face[hit], starts, hits.weights[hit], own)
            if mixed is not None:
                place = place._replace(pixels=seen)
                angle = largest_pixel_angle(directions, mixed.shape[1])
                self._reflection.begin(caster, lamps, place, mixed, angle)
            found_light = self._reflection.light(
                caster, lamps, place, optics, centres=mixed is not None, states_only=states_only
            )
            if len(seen) == len(directions):
                return Arrived(*found_light)
            gloss = np.zeros(len(directions))
            factors[seen], gloss[seen], state[seen], blocked[seen] = found_light
        return Arrived(factors, gloss, state, blocked)

    def on_hits(
        self,
        albedo: NDArray[np.float32],
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        face_light: FaceLight | None,
        pixels: NDArray[np.int64] | None = None,
    ) -> NDArray[np.float32]:
        """Return the radiance at ray hits, shape (n,), from the light on the faces where it is decided.

        ``pixels``: See `arrived`.
        """
        if face_light is None:
            return self.arrived(caster, t, origin_mm, directions, hits, pixels).on(albedo)
        return albedo * self.on_faces(caster, t, origin_mm, directions, hits, face_light).astype(np.float32)

    def on_faces(
        self,
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        face_light: FaceLight,
        alike: tuple[NDArray[np.int64], NDArray[np.int32]] | None = None,
    ) -> NDArray[np.float64]:
        """Return the irradiance at ray hits, 1 without a hit, where shadows are decided for all but a few faces.

        ``alike``: Pixel and cell of each ray: on a face, no shadow begins in a cell. Cells of -1 are none.
        """
        from scenetruth.render.shading_kernels import find_alike, light_of_faces

        factors: NDArray[np.float64]
        factors, where = light_of_faces(hits.face, face_light.total, face_light.unsure)
        face, one, of = hits.face[where], where, None
        if alike is not None:
            pixels, cells = alike
            chosen, of = find_alike(face, pixels[where], cells[where], len(face_light.unsure))
            one = where[chosen]
        points = origin_mm + directions[one] * hits.depth[one, None]
        blocked = self._blocked(caster, t, points, hits.face[one], face_light)
        factors[where] = face_light.without(face, blocked if of is None else blocked[of])
        return factors

    def _blocked(
        self,
        caster: RayCaster,
        t: float,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        face_light: FaceLight,
    ) -> NDArray[np.uint64]:
        """Return the blocked lamps at points on faces for which they are not decided, shape (n,)."""
        blocked = np.zeros(len(faces), dtype=np.uint64)
        for number, lamp in enumerate(self._lamps_at(t)):
            wanted = face_light.by_lamp[faces, number] < 0
            if wanted.any():
                dark = self._shadow_caster(caster).blocked_parallel(
                    points_mm, faces, wanted, -lamp.axis, confirmed=False
                )
                blocked |= dark.astype(np.uint64) << np.uint64(number)
        return blocked

    def changes(self, caster: RayCaster, t: float) -> Changes:
        """Return the function that finds where the borders in `FaceLight` are borders of shadows."""

        def changed(points_mm: NDArray[np.float64], line: NDArray[np.int64], lines: SurfaceLines) -> NDArray[np.bool_]:
            along, found = lines.ends_mm - lines.starts_mm, np.zeros(len(line), dtype=np.bool_)
            for number, lamp in enumerate(self._lamps_at(t)):
                own = np.flatnonzero(lines.label[line] == number)
                of, face = line[own], lines.face[line[own]]
                shadows, normals = self._shadow_caster(caster), caster.face_normals[face]
                found[own] = shadows.changes_across(points_mm[own], along[of], face, normals, -lamp.axis)
            return found

        return changed

    def pixels_on_faces(
        self,
        caster: RayCaster,
        t: float,
        origin_mm: NDArray[np.float64],
        directions: NDArray[np.float64],
        hits: Hits,
        body: NDArray[np.int32],
        mixed: NDArray[np.bool_],
        face_light: FaceLight,
    ) -> tuple[NDArray[np.float64], NDArray[np.uint64], NDArray[np.bool_]]:
        """Return irradiance, blocked lamps, and pixels next to a border that no line marks, shape (height, width).

        Between mixed pixels, the shadow on a face is the same along a row.
        """
        from scenetruth.render.shading_kernels import shadow_steps

        face, edges, nothing = hits.face, mixed.ravel(), hits.face < 0
        where = np.flatnonzero(face_light.unsure[face] & ~nothing)
        before = np.maximum(where - 1, 0)
        begins = (where % mixed.shape[1] == 0) | (face[before] != face[where]) | edges[before] | edges[where]
        first = where[begins]
        blocked = np.zeros(len(face), dtype=np.uint64)
        points = origin_mm + directions[first] * hits.depth[first, None]
        found = self._blocked(caster, t, points, face[first], face_light)
        blocked[where] = found[np.cumsum(begins) - 1]
        shade = face_light.total[face]
        np.putmask(shade, nothing, 1.0)
        shade[where] = face_light.without(face[where], blocked[where])
        face = face.reshape(mixed.shape)
        dark, steps = shadow_steps(
            face, body.reshape(mixed.shape), mixed, face_light.bits, blocked.reshape(mixed.shape)
        )
        return shade.reshape(mixed.shape), dark, steps

    def irradiance(
        self,
        caster: RayCaster,
        lamps: list[Lamp],
        points_mm: NDArray[np.float64],
        normals: NDArray[np.float64],
        faces: NDArray[np.int32],
        starts_mm: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.uint64], NDArray[np.uint64]]:
        """Compute irradiance, state numbers (`Arrived`) and blocked lamps (`PixelLight`) of points, shape (n,) each.

        ``points_mm``, ``normals``: Points and unit normals on the visible side, shape (n, 3) each.
        ``faces``: Face of each point, shape (n,), which casts no shadow on it.
        ``starts_mm``: Origins of the shadow rays, shape (n, 3): the points, or points above them on a smooth surface.
        """
        from scenetruth.render.shading_kernels import add_light

        total = np.full(len(points_mm), self._lighting.ambient_irradiance)
        state, blocked = np.zeros((2, len(points_mm)), dtype=np.uint64)
        for number, lamp in enumerate(lamps):
            light, zone, to_light, distance = light_of(lamp, points_mm, normals)
            dark = np.zeros(len(points_mm), dtype=np.bool_)
            if self._lighting.shadows:
                caster_of_shadows = self._shadow_caster(caster)
                if lamp.position_mm is None:
                    dark = caster_of_shadows.blocked_parallel(
                        starts_mm, faces, light > 0, -lamp.axis, confirmed=self._confirmed
                    )
                else:
                    reached = np.flatnonzero(light > 0)
                    dark[reached] = caster_of_shadows.blocked(
                        starts_mm[reached], faces[reached], to_light[reached], distance[reached]
                    )
                # Lamps beyond the 64th share a bit.
                blocked |= dark.astype(np.uint64) << np.uint64(min(number, 63))
            add_light(total, state, light, zone, dark)
        return total, state, blocked

    def face_light(self, caster: RayCaster, t: float, origin_mm: NDArray[np.float64]) -> FaceLight | None:
        """Return the light on the faces; None with lamps at a finite distance, and with more than 64 lamps.

        Next to smooth surfaces, which change the light and its shadows, shadows are decided for no face.
        """
        from scenetruth.raycast.shadow_kernels import LIT, UNSURE
        from scenetruth.render.shading_kernels import light_up_faces

        lamps = self._lamps_at(t)
        near = any(lamp.position_mm is not None for lamp in lamps)
        if not self.simple or len(lamps) > 64 or near:
            return None
        flat = not self._world.face_smooth.any()
        normals = caster.face_normals
        meeting = np.empty(0, dtype=np.bool_)
        cosines = np.empty((len(lamps), len(normals)))
        states = np.full(cosines.shape, LIT if flat else UNSURE, dtype=np.uint8)
        for number, lamp in enumerate(lamps):
            cosines[number] = normals @ lamp.axis
            if self._lighting.shadows and flat:
                shadows = self._shadow_caster(caster).on_faces(-lamp.axis)
                states[number], meeting = shadows.state, shadows.meeting
        irradiances, origin = np.array([lamp.irradiance for lamp in lamps]), np.asarray(origin_mm, dtype=np.float64)
        mesh = caster.vertices_mm, caster.topology.faces, normals
        ambient = float(self._lighting.ambient_irradiance)
        by_lamp, total, bits = light_up_faces(mesh, origin, (irradiances, cosines, states), ambient)
        lines = []
        for number, lamp in enumerate(lamps):
            if self._lighting.shadows and flat:
                shadows = self._shadow_caster(caster).on_faces(-lamp.axis)
                kept = (bits[:, shadows.face] >> np.uint64(number)).any(axis=0)
                face, label = shadows.face[kept], np.full(np.count_nonzero(kept), number)
                body = self._world.face_body[face]
                lines.append(SurfaceLines(shadows.starts_mm[kept], shadows.ends_mm[kept], face, body, label))
        unsure = bits[2] > 0
        borders = SurfaceLines(*(np.concatenate(part) for part in zip(*lines, strict=True))) if lines else None
        return FaceLight(by_lamp, total, unsure, bits, flat, borders, meeting)

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

        light = self.arrived(caster, t, origin_mm, directions, hits, mixed=mixed)
        shade, face = light.factors.reshape(mixed.shape), hits.face.reshape(mixed.shape)
        brightest = float(shade[face >= 0].max(initial=0.0))
        zones = light.state.reshape(mixed.shape)
        uneven, borders = uneven_pixels(shade, zones, face, mixed, _STEEPEST * brightest)
        steep = self._reflection.steep()
        if steep is not None:
            uneven, borders = uneven | steep, borders | steep
        gloss = None
        if light.gloss is not None:
            gloss = light.gloss.reshape(mixed.shape)
            uneven |= uneven_pixels(gloss, zones, face, mixed, _STEEPEST * max(brightest, float(gloss.max())))[0]
        if not self.simple:
            self._reflection.mark_borders(borders)
        return PixelLight(shade, face, mixed, uneven, borders, light.blocked.reshape(mixed.shape), gloss, steep)

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

    def _lamps_at(self, t: float) -> list[Lamp]:
        """Return the lamps, which several calls for one image have in common."""
        if self._lamps is None or self._lamps[0] != t:
            self._lamps = (t, self._lighting.lamps_at(t))
        return self._lamps[1]

    def use_shadows(self, shadows: ShadowCaster) -> None:
        """Use the shadows of a time that several renderers have in common, for ray casters of its vertices."""
        self._shadows = shadows

    def _shadow_caster(self, caster: RayCaster) -> ShadowCaster:
        common: ShadowCaster | None = getattr(caster, "shadows", None)
        if common is not None:
            return common
        if self._shadows is None or self._shadows.vertices_mm is not caster.vertices_mm:
            self._shadows = ShadowCaster(caster.vertices_mm, caster.topology)
        return self._shadows
