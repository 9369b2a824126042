"""Means over pixel footprints on one surface, by the rule of each pixel, and samples that are traced."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import BandFraction
from scenetruth.camera import Camera
from scenetruth.raycast import Hits, RayCaster, Topology
from scenetruth.render.footprint_rules import all_rules, raster_of, rule_table
from scenetruth.render.raycast_backend import RaycastRenderer, RayView, SharedSurfaces
from scenetruth.render.sampling_rules import (
    Rule,
    compute_longest_steps,
    compute_rule_errors,
    gauss_rule,
    square_rule,
)
from scenetruth.render.shading import PixelLight
from scenetruth.scene.built_scene import BuiltScene, SceneBody
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.texture import SurfaceTexture

if TYPE_CHECKING:
    from scenetruth.render.footprint_kernels import Raster

__all__ = ["EXACT", "SAMPLES_PER_PIECE", "FootprintRenderer", "ImageCanvas"]

_ORDER = 4  # order of the rules across the borders of shadows
_HIGHLIGHTS = (6, 16)  # orders of the rules across highlights, until two agree
_PIXELS_PER_LARGE_FACE = 100  # pixels per face of a body from which most of them lie inside a face
_PIXELS_PER_PIECE = 1 << 16
SAMPLES_PER_PIECE = 1 << 19
"""Maximum number of samples that are computed together."""
_FACTORS = (3.0, 2.5, 2.0, 1.6, 1.3)  # errors of single pixels that are tried, relative to the RMS error of an image
_SAME_DIRECTION = 1 - 1e-12  # cosine above which flat faces are lit equally
EXACT = 3
"""Rule whose cost is that of exact means of bilinear textures."""


@dataclass(frozen=True, eq=False)
class ImageCanvas:
    """Image in progress, in row-major order.

    ``image``: Radiance. ``albedo``: Mean radiance without light, or that of the pixel centre.
    ``lit``: Averaged pixels whose radiance is in ``image`` already; of the others, ``albedo`` is the mean.
    ``light``: Illumination at the pixel centres, None without light.
    ``by_lamp``: Irradiance of each face by each lamp, see `FaceLight`; None if it depends on more.
    ``shade``, ``blocked``: Irradiance and blocked lamps at the pixel centres, if ``by_lamp`` is given.
    """

    image: NDArray[np.float32]
    albedo: NDArray[np.float32]
    lit: NDArray[np.bool_]
    light: PixelLight | None
    by_lamp: NDArray[np.float64] | None
    shade: NDArray[np.float64]
    blocked: NDArray[np.uint64]
    samples: list[
        tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]
    ]
    """Samples to be traced together: pixels; number of samples of each; and of all samples offsets, weights and cells.

    Cells are numbered in each pixel: in them, no surface ends and no shadow begins within a face; -1 for none.
    """
    large: list[tuple[NDArray[np.int64], Rule]]
    """Pixels to be traced by a rule, with too many samples to be kept."""
    bare: bool = False
    """Whether the image shows the textures without light."""

    def trace_later(self, pixels: NDArray[np.int64], rule: Rule) -> None:
        """Add the samples of a rule in pixels."""
        if not len(pixels):
            return
        offsets, weights = rule
        self.lit[pixels] = True
        if len(pixels) * len(weights) > SAMPLES_PER_PIECE:
            self.large.append((pixels, rule))
            return
        counts = np.full(len(pixels), len(weights))
        cells = np.full(len(pixels) * len(weights), -1, dtype=np.int32)
        many = np.tile(offsets, (len(pixels), 1)), np.tile(weights, len(pixels)), cells
        self.samples.append((pixels, counts, *many))


def _level(texture: SurfaceTexture) -> float:
    """Return the mean radiance of a texture at some places."""
    number = np.arange(64) + 0.5
    return float(np.mean(texture.radiance(np.column_stack([number / 64, (number * 0.618034) % 1.0]))))


class FootprintRenderer(RaycastRenderer):
    """Renderer by ray casting whose pixels have rules of their own."""

    _confirmed = False

    def __init__(
        self,
        world: BuiltScene,
        camera: Camera,
        background: BandFraction = 0.0,
        lighting: Lighting | None = None,
        topology: Topology | None = None,
        *,
        image_error: float = 1e-4,
        surfaces: SharedSurfaces | None = None,
    ) -> None:
        super().__init__(world, camera, background, _ORDER, lighting, topology, surfaces=surfaces)
        self._image_error = image_error
        textures = [body.texture for body in world.bodies]
        self._longest = compute_longest_steps(textures, image_error)
        self._longer = [compute_longest_steps(textures, factor * image_error) for factor in _FACTORS]
        self._rule_errors = compute_rule_errors(textures)
        # Textures whose spectrum ends.
        self._smooth_textures = np.array([texture.cubic for texture in textures])
        shapes = np.array([body.texture.shape for body in world.bodies], dtype=np.float64)
        self._texels = np.ascontiguousarray(shapes[:, ::-1])
        self._levels = np.array([_level(body.texture) for body in world.bodies])
        self._crease_cosine = np.cos(np.deg2rad(world.crease_deg.reshape(len(world.faces), -1).max(axis=1)))
        self._bent: tuple[RayCaster, NDArray[np.bool_], NDArray[np.int32]] | None = None

    def _look_up(
        self, body: NDArray[np.int32], where: NDArray[np.int64], uv: NDArray[np.float64], out: NDArray[np.float32]
    ) -> None:
        """Write the radiance without light at texture coordinates, for the indices ``where`` on the bodies there."""
        for first in range(0, len(where), _PIXELS_PER_PIECE):
            piece = where[first : first + _PIXELS_PER_PIECE]
            own_body = body[piece]
            order = np.argsort(own_body.astype(np.uint8) if len(self._world.bodies) < 256 else own_body, kind="stable")
            bounds = np.searchsorted(own_body[order], np.arange(len(self._world.bodies) + 1))
            for index in range(len(self._world.bodies)):
                self._look_up_on(index, piece[order[bounds[index] : bounds[index + 1]]], uv, out)

    def _look_up_on(
        self, index: int, own: NDArray[np.int64], uv: NDArray[np.float64], out: NDArray[np.float32]
    ) -> None:
        """As `_look_up`, on one body."""
        from scenetruth.render.footprint_kernels import sample_raster

        texture = self._world.bodies[index].texture
        raster = raster_of(texture)
        if raster is not None:
            sample_raster(raster, uv, own, out)
        elif len(own):
            out[own] = texture.radiance(uv[own])

    def _look_up_hits(self, hits: Hits, uv: NDArray[np.float64], out: NDArray[np.float32]) -> None:
        """Write the radiance without light at hits, from texture coordinates at the face corners."""
        from scenetruth.render.footprint_kernels import sample_hits, sort_by_body

        order, bounds = sort_by_body(hits.face, self._world.face_body, len(self._world.bodies))
        for index, item in enumerate(self._world.bodies):
            own = order[bounds[index] : bounds[index + 1]]
            if not len(own):
                continue
            raster = raster_of(item.texture)
            if raster is not None:
                sample_hits(raster, uv, hits.face, hits.weights, own, out)
            else:
                some = Hits(hits.face[own], hits.depth[own], hits.weights[own])
                out[own] = item.texture.radiance(some.interpolate_corners(uv))

    def _kinked(self, caster: RayCaster) -> NDArray[np.bool_]:
        """Return whether a face is shaded flat and not parallel to all its neighbours, shape (m,)."""
        return self._facets(caster)[0]

    def _facets(self, caster: RayCaster) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
        """Return the faces of `_kinked`, and the neighbours of each across edges that are not sharp, else -1."""
        if self._bent is None or self._bent[0] is not caster:
            neighbours, normals = caster.topology.face_neighbours, caster.face_normals
            cosine = np.einsum("mk,msk->ms", normals, normals[neighbours])
            turned = (np.abs(cosine) < _SAME_DIRECTION) & (neighbours >= 0)
            crease = np.minimum(self._crease_cosine[neighbours], self._crease_cosine[:, None])
            joined = np.where(np.abs(cosine) < crease, np.int32(-1), neighbours)
            self._bent = (caster, turned.any(axis=1) & ~self._world.face_smooth, joined)
        return self._bent[1:]

    def _average(
        self,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
    ) -> None:
        """Render pixels on one surface by the rule of each."""
        image, light, shape = canvas.image, canvas.light, mixed.shape
        if light is not None:
            # Light that is not smooth is evaluated at every sample: equally spaced across borders.
            uneven, borders = light.uneven.ravel()[pixels], light.borders.ravel()[pixels]
            self._average_samples(view, canvas, pixels[borders], self._mixed)
            some = pixels[uneven & ~borders]
            self._average_samples(view, canvas, some, self._smooth)
            for order in _HIGHLIGHTS if light.gloss is not None else ():
                # Until two rules agree, because highlights may be smaller than pixels.
                before = image[some]
                self._average_samples(view, canvas, some, square_rule(*gauss_rule(order)))
                some = some[np.abs(image[some] - before) > self._image_error]
            pixels = pixels[~uneven]
        # The rule at pixel centres is for pixels that can be filtered; the first Gauss rule replaces it.
        chosen, body = np.maximum(rules.ravel()[pixels], 1), view.body[pixels]
        canvas.lit[pixels] = False
        count = len(self._world.bodies)
        by_body = np.argsort(body.astype(np.uint8) if count < 256 else body, kind="stable")
        bounds = np.searchsorted(body[by_body], np.arange(count + 1))
        for index, item in enumerate(self._world.bodies):
            if bounds[index] == bounds[index + 1]:
                continue
            own = by_body[bounds[index] : bounds[index + 1]]
            raster = raster_of(item.texture)
            faceted = self._shader is not None and not (item.mesh.smooth or canvas.bare)
            if raster is not None and not (faceted and canvas.by_lamp is None):
                self._average_body(raster, item, view, canvas, pixels[own], chosen[own], faceted=faceted)
                continue
            for number, rule in enumerate(all_rules(), start=1):
                some = pixels[own[chosen[own] == number]]
                if len(some):
                    self._average_by(rule, view, canvas, some, index)
        some = pixels[~canvas.lit[pixels]]
        if light is None:
            image[some] = canvas.albedo[some]
        elif len(some):
            # All Gauss rules have the variance of the pixel.
            image[some] = light.on(canvas.albedo.reshape(shape), mixed, 1 / 12).ravel()[some]

    def _average_samples(self, view: RayView, canvas: ImageCanvas, pixels: NDArray[np.int64], rule: Rule) -> None:
        """Render pixels by samples with the light of each."""
        at_once = max(1, SAMPLES_PER_PIECE // len(rule[1]))
        for first in range(0, len(pixels), at_once):
            piece = pixels[first : first + at_once]
            arrived, canvas.image[piece] = self._walk(view, piece, *rule)
            if not arrived.all():
                canvas.image[piece[~arrived]] = 0.0
            canvas.trace_later(piece[~arrived], rule)

    def _average_body(
        self,
        raster: Raster,
        item: SceneBody,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        chosen: NDArray[np.uint8],
        *,
        faceted: bool,
    ) -> None:
        """Average pixels of one body by the rule of each: the image on lit facets, elsewhere the albedo."""
        from scenetruth.raycast.hit_kernels import footprint_forms
        from scenetruth.render.bilinear_mean_kernels import average_bilinear
        from scenetruth.render.footprint_kernels import Footprints, LampLight, average_footprints

        first, count, offsets, weights = rule_table()
        meeting = np.empty(0, dtype=np.bool_) if view.face_light is None else view.face_light.meeting

        def light_on(pixels: NDArray[np.int64]) -> LampLight:
            if not faceted or canvas.by_lamp is None:
                return LampLight(np.empty((0, 0)), np.empty(0, dtype=np.uint64), 0.0)
            return LampLight(canvas.by_lamp, canvas.blocked[pixels], self._lighting.ambient_irradiance)

        if not raster.cubic and len(many := np.flatnonzero(chosen >= EXACT)):
            own = pixels[many]
            footprints = Footprints(own, first[:0], count[:0], offsets, weights, meeting)
            done, means = average_bilinear(view.mesh, view.rays, footprints, raster, light_on(own))
            (canvas.image if faceted else canvas.albedo)[own[done]] = means[done]
            canvas.lit[own[done]] = faceted
            rest = np.ones(len(pixels), dtype=np.bool_)
            rest[many[done]] = False
            pixels, chosen = pixels[rest], chosen[rest]
        if len(pixels) > _PIXELS_PER_LARGE_FACE * len(item.mesh.faces):
            # Most pixels are inside large faces: without walks.
            for number, rule in enumerate(all_rules(), start=1):
                own = np.flatnonzero(chosen == number)
                at_once = max(1, min(_PIXELS_PER_PIECE, SAMPLES_PER_PIECE // len(rule[1])))
                for start in range(0, len(own), at_once):
                    piece = own[start : start + at_once]
                    forms, whole = footprint_forms(view.mesh, view.rays, pixels[piece], float(np.abs(rule[0]).max()))
                    inside = pixels[piece[whole]]
                    canvas.albedo[inside] = item.texture.mean_radiance(forms[whole], *rule)
                    if faceted:
                        canvas.image[inside], canvas.lit[inside] = canvas.albedo[inside] * canvas.shade[inside], True
                    chosen[piece[whole]] = 0
            pixels, chosen = pixels[chosen > 0], chosen[chosen > 0]
        footprints = Footprints(pixels, first[chosen], count[chosen], offsets, weights, meeting)
        arrived, means = average_footprints(view.mesh, view.rays, footprints, raster, light_on(pixels))
        (canvas.image if faceted else canvas.albedo)[pixels] = means
        canvas.lit[pixels] = faceted
        for number, rule in enumerate(all_rules(), start=1):
            lost = pixels[~arrived & (chosen == number)]
            if len(lost):
                canvas.trace_later(lost, rule)

    def _average_by(
        self, rule: Rule, view: RayView, canvas: ImageCanvas, pixels: NDArray[np.int64], index: int
    ) -> None:
        """Average pixels of one body by a rule, as `_average_body`, with any texture and light."""
        from scenetruth.raycast.hit_kernels import walk_footprints
        from scenetruth.render.shading_kernels import lit_means

        offsets, weights = rule
        at_once = max(1, min(_PIXELS_PER_PIECE, SAMPLES_PER_PIECE // len(weights)))
        item = self._world.bodies[index]
        faceted = self._shader is not None and not (item.mesh.smooth or canvas.bare)
        for start in range(0, len(pixels), at_once):
            piece = pixels[start : start + at_once]
            if faceted and canvas.by_lamp is None:
                arrived, canvas.image[piece] = self._walk(view, piece, *rule)
                canvas.lit[piece] = True
                canvas.trace_later(piece[~arrived], rule)
                continue
            arrived, face, _depth, _weights, uv = walk_footprints(view.mesh, view.rays, piece, offsets, places=False)
            canvas.trace_later(piece[~arrived], rule)
            piece, face, uv = piece[arrived], face[arrived], uv[arrived]
            radiance = item.texture.radiance(uv.reshape(-1, 2)).reshape(face.shape)
            if faceted and canvas.by_lamp is not None:
                blocked, ambient = canvas.blocked[piece], self._lighting.ambient_irradiance
                canvas.image[piece] = lit_means(radiance, face, canvas.by_lamp, blocked, ambient, weights)
                canvas.lit[piece] = True
            else:
                canvas.albedo[piece] = np.einsum("ps,s->p", radiance, weights)

    def _trace_samples(
        self, view: RayView, canvas: ImageCanvas, wanted: NDArray[np.bool_] | None = None
    ) -> list[tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]]:
        """Trace the samples in several pixels together, because each call has to sort the faces.

        Returns: Pixel, face, and light of a texture of mean radiance, of the samples in wanted pixels.
        """
        from scenetruth.render.footprint_kernels import add_samples, order_samples

        found: list[tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]] = []
        for pixels, (offsets, weights) in canvas.large:
            at_once = max(1, SAMPLES_PER_PIECE // len(weights))
            for first in range(0, len(pixels), at_once):
                piece = pixels[first : first + at_once]
                if canvas.bare:
                    many = np.tile(offsets, (len(piece), 1))
                    none = np.empty(0, dtype=np.int32)
                    radiance, *_ = self._radiance(view, np.repeat(piece, len(weights)), many, none, bare=True)
                    canvas.image[piece] = radiance.reshape(len(piece), -1) @ weights
                else:
                    canvas.image[piece] = self._trace(view, piece, offsets, weights)
        if not canvas.samples:
            return found
        pixels, counts, offsets, weights, cells = (np.concatenate(part) for part in zip(*canvas.samples, strict=True))
        # In the order of the pixels.
        order, starts = np.argsort(pixels, kind="stable"), np.cumsum(counts) - counts
        owner, offsets, weights, cells = order_samples(order, pixels, starts, counts, offsets, weights, cells)
        pixels, counts = pixels[order], counts[order]
        ends, first = np.cumsum(counts), 0
        while first < len(pixels):
            start = ends[first] - counts[first]
            last = max(int(np.searchsorted(ends, start + SAMPLES_PER_PIECE, side="right")), first + 1)
            piece, here = pixels[first:last], slice(start, ends[last - 1])
            own = owner[here]
            radiance, face, light, gloss = self._radiance(view, own, offsets[here], cells[here], bare=canvas.bare)
            canvas.image[piece] = add_samples(counts[first:last], radiance, weights[here])
            if wanted is not None:
                some = np.flatnonzero(wanted[own] & (face >= 0))
                met = face[some]
                level = self._levels[self._world.face_body[met]] * light[some]
                found.append((own[some], met, level if gloss is None else level + gloss[some]))
            first = last
        return found

    def _radiance(
        self,
        view: RayView,
        pixels: NDArray[np.int64],
        offsets: NDArray[np.float64],
        cells: NDArray[np.int32],
        *,
        bare: bool = False,
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64] | None]:
        """Return the radiance of samples, with the pixel and the offset of each, by tracing.

        ``cells``: Cell of each sample, see `ImageCanvas.samples`; none if there are no cells.
        ``bare``: Whether to leave the light out. Returns the face, the factor of the texture, and gloss, as well.
        """
        from scenetruth.raycast.pixel_ray_kernels import sample_directions

        directions = sample_directions(view.rays, pixels, offsets)
        hits = view.caster.cast_in_pixels(view.rays.origin, directions, pixels)
        radiance = np.full(len(directions), self._background, dtype=np.float32)
        self._look_up_hits(hits, view.mesh.uv, radiance)
        if self._shader is None or bare:
            return radiance, hits.face, np.ones(len(radiance)), None
        rays = (view.rays.origin, directions)
        if view.face_light is not None:
            alike = (pixels, cells) if len(cells) else None
            factors = self._shader.on_faces(view.caster, view.t, *rays, hits, view.face_light, alike)
            return radiance * factors.astype(np.float32), hits.face, factors, None
        light = self._shader.arrived(view.caster, view.t, *rays, hits, pixels)
        return light.on(radiance), hits.face, light.factors, light.gloss
