"""Ray casting with as many samples per pixel as texture and edges require, within a stated error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import BandFraction
from scenetruth.camera import Camera, Viewpoint
from scenetruth.raycast import (
    Changes,
    ImageRays,
    MixedPixels,
    RayCaster,
    SurfaceLines,
    TexturedMesh,
    Topology,
    find_mixed_pixels,
)
from scenetruth.render.raycast_backend import RaycastRenderer, RayView, RepeatingRayCaster, visible_uv
from scenetruth.render.sampling_rules import (
    FILTER_TAPS,
    GAUSS_ORDERS,
    Rule,
    compute_longest_steps,
    even_rule,
    gauss_rule,
    lattice_rule,
    square_rule,
)
from scenetruth.render.shading import PixelLight
from scenetruth.scene.built_scene import BuiltScene, SceneBody
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.texture import Picture, SurfaceTexture, TintedTexture

if TYPE_CHECKING:
    from scenetruth.render.footprint_kernels import Raster

__all__ = ["AdaptiveRenderer"]

_ORDER = 4  # order of the rules across the borders of shadows
_LATTICES = (67, 257, 1021)  # samples of the lattices for textures with steps
_CROWDED = 521  # samples of the lattice for mixed pixels that are not cut along their edges
_FINE = 1 + len(GAUSS_ORDERS)  # index of the first lattice among the rules; the first rule is the filter
_PIXELS_PER_LARGE_FACE = 100  # pixels per face of a body from which most of them lie inside a face
_PIXELS_PER_PIECE, _SAMPLES_PER_PIECE = 1 << 16, 1 << 19
_SAME_DIRECTION = 1 - 1e-12  # cosine above which flat faces are lit equally
_EXACT = 3  # rule whose cost is that of exact means of bilinear textures
_SQUARES = (16, 32)  # orders of the equally spaced rules for bilinear textures
_BLOCK = 8  # texels along a side of the blocks whose bends are kept
_BAND = 64 * _BLOCK  # rows of a texture whose bends are computed together


@lru_cache(maxsize=1)
def _rules() -> list[Rule]:
    """Return the rules from the first Gauss rule on."""
    gauss = [square_rule(*gauss_rule(order)) for order in GAUSS_ORDERS]
    return [*gauss, *map(lattice_rule, _LATTICES), *(square_rule(*even_rule(order)) for order in _SQUARES)]


@lru_cache(maxsize=1)
def _bend_errors() -> list[tuple[int, float]]:
    """Return the rules for bilinear textures, with the error of each at a unit change of the slope.

    A bilinear texture is bent at the lines through texel centres. The error is the RMS over the places of one such
    line along an axis of the pixel.
    """
    bends = (np.arange(4096) + 0.5) / 4096 - 0.5
    ramps = [*map(gauss_rule, GAUSS_ORDERS), *map(even_rule, _SQUARES)]
    numbers = [*range(1, _FINE), *range(_FINE + len(_LATTICES), _FINE + len(_LATTICES) + len(_SQUARES))]
    exact = (0.5 - bends) ** 2 / 2
    return [
        (number, float(np.sqrt(np.mean((np.maximum(nodes - bends[:, None], 0) @ weights - exact) ** 2))))
        for number, (nodes, weights) in zip(numbers, ramps, strict=True)
    ]


@lru_cache(maxsize=1)
def _rule_table() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return first sample and number of samples of every rule, from an empty one, and all offsets and weights."""
    count = np.array([0, *(len(weights) for _, weights in _rules())])
    ordered = []
    for offsets, weights in _rules():
        # Rows of samples in turn to the right and to the left, so that walks seldom change faces.
        row = np.floor((offsets[:, 1] + 0.5) * np.sqrt(len(weights))).astype(np.int64)
        order = np.lexsort((np.where(row % 2, -offsets[:, 0], offsets[:, 0]), row))
        ordered.append((offsets[order], weights[order]))
    offsets, weights = (np.concatenate(part) for part in zip(*ordered, strict=True))
    return np.cumsum(count) - count, count, offsets, weights


def _raster_of(texture: SurfaceTexture) -> Raster | None:
    """Return the raster of a texture whose radiance is its interpolation, else None."""
    from scenetruth.render.footprint_kernels import Raster

    if isinstance(texture, TintedTexture):
        found = _raster_of(texture.untinted)
        factor = texture.factor
        return None if found is None else found._replace(gain=found.gain * factor, mean=found.mean * factor)
    if isinstance(texture, Picture):
        return Raster(texture.values, False, texture.tiled, 1.0, 0.0)
    coefficients = getattr(texture, "coefficients", None)
    if coefficients is None:
        return None
    gain, mean = getattr(texture, "std", 1.0), getattr(texture, "mean", 0.0)
    return Raster(coefficients, True, True, float(gain), float(mean))


_bends: WeakKeyDictionary[SurfaceTexture, NDArray[np.float32]] = WeakKeyDictionary()


def _block_bends(texture: SurfaceTexture) -> NDArray[np.float32]:
    """Return the RMS second differences of a bilinear texture in blocks of `_BLOCK` texels, along the worse axis."""
    found = _bends.get(texture)
    if found is None:
        values, parts = texture.raster(), []
        rows, columns = values.shape

        def inside(index: NDArray[np.int64], size: int) -> NDArray[np.int64]:
            return index % size if texture.tiled else np.clip(index, 0, size - 1)

        across = inside(np.arange(-1, columns + 1), columns)
        for first in range(0, rows, _BAND):
            band = values[inside(np.arange(first - 1, min(first + _BAND, rows) + 1), rows)]
            wide = band[1:-1, across]
            bends = np.abs(wide[:, 2:] - 2 * wide[:, 1:-1] + wide[:, :-2])
            np.maximum(bends, np.abs(band[2:] - 2 * band[1:-1] + band[:-2]), out=bends)
            parts.append(_blocks_along(np.square(bends).T, tiled=texture.tiled).T)
        squares = _blocks_along(np.concatenate(parts), tiled=texture.tiled)
        found = _bends[texture] = np.sqrt(np.ascontiguousarray(squares))
    return found


def _blocks_along(values: NDArray[np.float32], *, tiled: bool) -> NDArray[np.float32]:
    """Return the means of blocks along the first axis, each with the first value of the next block.

    Between texels of two blocks, the texture is interpolated.
    """
    size = len(values)
    count = -(-size // _BLOCK)
    index = np.arange(count * _BLOCK + 1)
    padded = values[index % size if tiled else np.minimum(index, size - 1)]
    inside = padded[:-1].reshape(count, _BLOCK, -1).sum(axis=1)
    blocks = (inside + padded[_BLOCK::_BLOCK]) / (_BLOCK + 1)
    if tiled and size % _BLOCK:
        # Beyond the border, blocks do not begin at multiples of their size.
        blocks = np.maximum(np.maximum(np.roll(blocks, 1, axis=0), blocks), np.roll(blocks, -1, axis=0))
    return np.asarray(blocks)


@lru_cache(maxsize=1)
def _gauss_tables() -> Rule:
    """Return nodes and weights along one axis of all orders, shape (orders, most)."""
    nodes, weights = np.zeros((2, GAUSS_ORDERS[-1] + 1, GAUSS_ORDERS[-1]))
    for order in range(1, GAUSS_ORDERS[-1] + 1):
        nodes[order, :order], weights[order, :order] = gauss_rule(order)
    return nodes, weights


@dataclass(frozen=True, eq=False)
class _Canvas:
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
    samples: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]]
    """Samples to be traced together: pixels; number of samples of each; offsets; and weights of all samples."""
    large: list[tuple[NDArray[np.int64], Rule]]
    """Pixels to be traced by a rule, with too many samples to be kept."""

    def trace_later(self, pixels: NDArray[np.int64], rule: Rule) -> None:
        """Add the samples of a rule in pixels."""
        if not len(pixels):
            return
        offsets, weights = rule
        self.lit[pixels] = True
        if len(pixels) * len(weights) > _SAMPLES_PER_PIECE:
            self.large.append((pixels, rule))
            return
        counts = np.full(len(pixels), len(weights))
        self.samples.append((pixels, counts, np.tile(offsets, (len(pixels), 1)), np.tile(weights, len(pixels))))


class AdaptiveRenderer(RaycastRenderer):
    """Renderer by ray casting that adapts the samples of every pixel to texture and edges.

    Where the texture is coarse enough and the surface smooth, samples at pixel centres are filtered
    (`sampling_rules.FILTER_TAPS`); elsewhere the order of the Gauss rule follows from the texture step per pixel.
    Pixels crossed by edges are cut along them. For bilinear textures, which may have steps, the rule follows from the
    range of the texture in each pixel, and pixels with steps get a lattice of samples.

    Flat faces in parallel light are in the light or in shadow as a whole, or are cut along the borders of shadows.

    ``image_error``: RMS error of the radiance by which the rules are chosen.
    """

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
    ) -> None:
        super().__init__(world, camera, background, _ORDER, lighting, topology)
        self._image_error = image_error
        self._longest = compute_longest_steps([body.texture for body in world.bodies], image_error)
        shapes = np.array([body.texture.shape for body in world.bodies], dtype=np.float64)
        self._texels = np.ascontiguousarray(shapes[:, ::-1])
        self._bent: tuple[RayCaster, NDArray[np.bool_]] | None = None

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image at time t from a viewpoint, see `Renderer.render`."""
        from scenetruth.render.pixel_filter_kernels import choose_rules, filter_samples

        camera, world, caster = self._camera, self._world, self._caster_at(t)
        origin, shape = viewpoint.position_mm, (camera.height, camera.width)
        directions, across, down = (
            viewpoint.directions_to_world(item) for item in (self._directions, self._across, self._down)
        )
        hits = caster.cast(origin, directions, grid_width=camera.width)
        body = np.where(hits.face >= 0, world.face_body[hits.face], -1).astype(np.int32)
        faces = None if self._shader is None else self._shader.face_light(caster, t, origin)
        decided = faces is not None and faces.decided
        lines = faces.borders if faces is not None and decided else None
        changes = None if self._shader is None else self._shader.changes(caster, t)
        edges = self._find_mixed(caster, viewpoint, body.reshape(shape), lines, changes)
        light, shade, blocked = None, np.empty(0), np.empty(0, dtype=np.uint64)
        if self._shader is not None:
            if faces is not None and decided:
                shade, blocked, bare = self._shader.pixels_on_faces(
                    caster, t, origin, directions, hits, body, edges.mixed, faces
                )
                # Faces between which a shadow begins.
                edges.mixed[bare], edges.bare[bare] = True, True
            else:
                light = self._shader.on_pixels(caster, t, origin, directions, hits, edges.mixed)
                shade, blocked = light.shade, light.blocked
        uv = visible_uv(world, caster.vertices_mm, origin)
        mesh = TexturedMesh(caster.vertices_mm, world.faces, caster.topology.face_neighbours, world.face_body, uv)
        rays = ImageRays(origin, directions, across, down, hits.face, camera.width)
        view = RayView(caster, t, mesh, rays, body, faces if decided else None)

        place = hits.interpolate_corners(uv)
        albedo = np.full(len(body), self._background, dtype=np.float32)
        rules, steps = choose_rules(
            place.reshape(*shape, 2), body.reshape(shape), edges.mixed, self._texels, self._longest
        )
        self._choose_for_bends(rules.ravel(), steps.ravel(), place, body)
        # Only these pixels are filtered.
        self._look_up(body, np.flatnonzero(rules == 0), place, albedo)
        # Large images: arrays of float64 are freed as soon as possible.
        del place, steps, hits
        usable, samples = rules == 0, albedo
        if self._shader is not None:
            usable &= ~self._kinks(view).reshape(shape)
            if light is not None:
                usable &= ~light.uneven
            samples = albedo * shade.ravel().astype(np.float32)
            if light is not None and light.gloss is not None:
                samples += light.gloss.ravel().astype(np.float32)
        means, done = filter_samples(samples.reshape(shape), usable, body.reshape(shape), FILTER_TAPS)
        image = means.ravel()
        left = np.flatnonzero((body >= 0) & ~(done | edges.mixed).ravel())
        by_lamp = None if faces is None else faces.by_lamp
        canvas = _Canvas(
            image, albedo, np.zeros(len(body), dtype=np.bool_), light, by_lamp, shade.ravel(), blocked.ravel(), [], []
        )
        self._average(view, canvas, left, rules, edges.mixed)
        self._cut(view, canvas, edges, rules)
        self._trace_samples(view, canvas)
        return image.reshape(shape) * np.float32(self._lighting.brightness(t))

    def _find_mixed(
        self,
        caster: RayCaster,
        viewpoint: Viewpoint,
        body: NDArray[np.int32],
        lines: SurfaceLines | None,
        changes: Changes | None,
    ) -> MixedPixels:
        """Return the mixed pixels, which bands with the same lines have in common."""

        def find() -> MixedPixels:
            return find_mixed_pixels(caster, viewpoint, self._camera, body, lines, changes)

        if not isinstance(caster, RepeatingRayCaster):
            return find()
        parts = () if lines is None else (lines.starts_mm, lines.ends_mm, lines.face, lines.label)
        found: MixedPixels = caster.again("mixed pixels", find, viewpoint.position_mm, body, *parts)
        # Bands mark further pixels.
        return replace(found, mixed=found.mixed.copy(), bare=found.bare.copy())

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
        raster = _raster_of(texture)
        if raster is not None:
            sample_raster(raster, uv, own, out)
        elif len(own):
            out[own] = texture.radiance(uv[own])

    def _choose_for_bends(
        self, rules: NDArray[np.uint8], steps: NDArray[np.float32], place: NDArray[np.float64], body: NDArray[np.int32]
    ) -> None:
        """Change the rules for textures without an end of their spectrum, by the bends of the texture in each pixel."""
        from scenetruth.render.pixel_filter_kernels import NO_RULE, texture_ranges

        np.putmask(rules, (rules == _FINE), _FINE + 1)
        for index, item in enumerate(self._world.bodies):
            if item.texture.cubic:
                continue
            every = np.flatnonzero((body == index) & (rules != NO_RULE))
            tinted = item.texture if isinstance(item.texture, TintedTexture) else TintedTexture(item.texture, 1.0)
            bends = _block_bends(tinted.untinted)
            straight, factor = np.zeros_like(bends), max(tinted.factor, 1.0)
            for first in range(0, len(every), _PIXELS_PER_PIECE):
                pixels = every[first : first + _PIXELS_PER_PIECE]
                uv, step = place[pixels], steps[pixels].astype(np.float64)
                if item.texture.tiled:
                    uv -= np.floor(uv)
                places = (uv * self._texels[index] - 0.5) / _BLOCK
                rough = factor * texture_ranges(straight, bends, item.texture.tiled, places, step / _BLOCK)
                # The slope per pixel changes by a bend times the step. Both axes, and several bends, add at random.
                bend = rough * np.clip(step, 0, 1e9) * np.sqrt(2 * np.clip(step, 1.0, 1e9))
                chosen = np.full(len(pixels), _bend_errors()[-1][0], dtype=np.uint8)
                for rule, error in reversed(_bend_errors()):
                    chosen[bend * error <= self._image_error] = rule
                rules[pixels] = chosen

    def _kinks(self, view: RayView) -> NDArray[np.bool_]:
        """Return the pixels next to another face of a surface that is shaded flat, unless both are parallel."""
        shape = (-1, view.rays.width)
        kinked = self._kinked(view.caster)
        if not kinked.any():
            return np.zeros(len(view.body), dtype=np.bool_)
        face = view.rays.face.reshape(shape)
        found = np.zeros(face.shape, dtype=np.bool_)
        for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            differs = face[one] != face[other]
            found[one] |= differs
            found[other] |= differs
        return np.asarray(found.ravel() & (view.rays.face >= 0) & kinked[view.rays.face])

    def _kinked(self, caster: RayCaster) -> NDArray[np.bool_]:
        """Return whether a face is shaded flat and not parallel to all its neighbours, shape (m,)."""
        if self._bent is None or self._bent[0] is not caster:
            neighbours, normals = caster.topology.face_neighbours, caster.face_normals
            cosine = np.einsum("mk,msk->ms", normals, normals[neighbours])
            turned = (np.abs(cosine) < _SAME_DIRECTION) & (neighbours >= 0)
            self._bent = (caster, turned.any(axis=1) & ~self._world.face_smooth)
        return self._bent[1]

    def _average(
        self,
        view: RayView,
        canvas: _Canvas,
        pixels: NDArray[np.int64],
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
    ) -> None:
        """Render pixels on one surface by the rule of each."""
        image, light, shape = canvas.image, canvas.light, mixed.shape
        if light is not None:
            # Light that is not smooth is evaluated at every sample: equally spaced across borders.
            uneven, borders = light.uneven.ravel()[pixels], light.borders.ravel()[pixels]
            for some, rule in ((pixels[uneven & ~borders], self._smooth), (pixels[borders], self._mixed)):
                arrived = np.empty(0, dtype=np.bool_)
                for first in range(0, len(some), _SAMPLES_PER_PIECE // _ORDER**2):
                    piece = some[first : first + _SAMPLES_PER_PIECE // _ORDER**2]
                    arrived, image[piece] = self._walk(view, piece, *rule)
                    canvas.trace_later(piece[~arrived], rule)
            pixels = pixels[~uneven]
        # The rule at pixel centres is for pixels that can be filtered; the first Gauss rule replaces it.
        chosen, body = np.maximum(rules.ravel()[pixels], 1), view.body[pixels]
        canvas.lit[pixels] = False
        for index, item in enumerate(self._world.bodies):
            own = body == index
            if not own.any():
                continue
            raster = _raster_of(item.texture)
            faceted = self._shader is not None and not item.mesh.smooth
            if raster is not None and not (faceted and canvas.by_lamp is None):
                self._average_body(raster, item, view, canvas, pixels[own], chosen[own], faceted=faceted)
                continue
            for number, rule in enumerate(_rules(), start=1):
                some = pixels[own & (chosen == number)]
                if len(some):
                    self._average_by(rule, view, canvas, some, index)
        some = pixels[~canvas.lit[pixels]]
        if light is None:
            image[some] = canvas.albedo[some]
        elif len(some):
            # All Gauss rules have the variance of the pixel.
            image[some] = light.on(canvas.albedo.reshape(shape), mixed, 1 / 12).ravel()[some]

    def _average_body(
        self,
        raster: Raster,
        item: SceneBody,
        view: RayView,
        canvas: _Canvas,
        pixels: NDArray[np.int64],
        chosen: NDArray[np.uint8],
        *,
        faceted: bool,
    ) -> None:
        """Average pixels of one body by the rule of each: the image on lit facets, elsewhere the albedo."""
        from scenetruth.raycast.hit_kernels import footprint_forms
        from scenetruth.render.bilinear_mean_kernels import average_bilinear
        from scenetruth.render.footprint_kernels import Footprints, LampLight, average_footprints

        first, count, offsets, weights = _rule_table()
        meeting = np.empty(0, dtype=np.bool_) if view.face_light is None else view.face_light.meeting

        def light_on(pixels: NDArray[np.int64]) -> LampLight:
            if not faceted or canvas.by_lamp is None:
                return LampLight(np.empty((0, 0)), np.empty(0, dtype=np.uint64), 0.0)
            return LampLight(canvas.by_lamp, canvas.blocked[pixels], self._lighting.ambient_irradiance)

        if not raster.cubic and len(many := np.flatnonzero(chosen >= _EXACT)):
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
            for number, rule in enumerate(_rules(), start=1):
                own = np.flatnonzero(chosen == number)
                at_once = max(1, min(_PIXELS_PER_PIECE, _SAMPLES_PER_PIECE // len(rule[1])))
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
        for number, rule in enumerate(_rules(), start=1):
            lost = pixels[~arrived & (chosen == number)]
            if len(lost):
                canvas.trace_later(lost, rule)

    def _average_by(self, rule: Rule, view: RayView, canvas: _Canvas, pixels: NDArray[np.int64], index: int) -> None:
        """Average pixels of one body by a rule, as `_average_body`, with any texture and light."""
        from scenetruth.raycast.hit_kernels import walk_footprints
        from scenetruth.render.shading_kernels import lit_means

        offsets, weights = rule
        at_once = max(1, min(_PIXELS_PER_PIECE, _SAMPLES_PER_PIECE // len(weights)))
        item = self._world.bodies[index]
        faceted = self._shader is not None and not item.mesh.smooth
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

    def _cut(self, view: RayView, canvas: _Canvas, edges: MixedPixels, rules: NDArray[np.uint8]) -> None:
        """Place samples in mixed pixels, cut along their edges."""
        from scenetruth.raycast.edge_cell_kernels import MOST_EDGES, cut_pixels

        size = len(canvas.image)
        # Hidden edges matter where they meet the edge that hides them: unless there are too many, they cut as well.
        many = np.bincount(edges.pixels, minlength=size) > MOST_EDGES
        used = np.flatnonzero(edges.seen | ~many[edges.pixels])
        where, ends = self._intersections(view, np.flatnonzero(edges.bare))
        owners = np.concatenate([edges.pixels[used], where])
        order = np.argsort(owners, kind="stable")
        owners, ends = owners[order], np.concatenate([edges.ends[used], ends])[order]
        counts = np.bincount(owners, minlength=size)
        largest = self._largest_rules(rules).ravel()
        uncut = (counts > MOST_EDGES) | (edges.bare.ravel() & (counts == 0)) | (largest >= _FINE)
        canvas.trace_later(np.flatnonzero(edges.mixed.ravel() & uncut), lattice_rule(_CROWDED))
        pixels, ends = np.flatnonzero(edges.mixed.ravel() & ~uncut), ends[~uncut[owners]]
        starts = np.concatenate([[0], np.cumsum(counts[pixels])])
        # Gauss points per pixel: one less per axis than inside surfaces, because cells are smaller than pixels.
        orders = np.array([2, 2, 2, 3, 4, 4])[largest[pixels]]
        firsts, offsets, weights = cut_pixels(ends, starts, orders, *_gauss_tables())
        canvas.samples.append((pixels, np.diff(firsts), offsets, weights))

    def _trace_samples(self, view: RayView, canvas: _Canvas) -> None:
        """Trace the samples in several pixels together, because each call has to sort the faces."""
        for pixels, (offsets, weights) in canvas.large:
            at_once = max(1, _SAMPLES_PER_PIECE // len(weights))
            for first in range(0, len(pixels), at_once):
                piece = pixels[first : first + at_once]
                canvas.image[piece] = self._trace(view, piece, offsets, weights)
        pixels, counts, offsets, weights = (np.concatenate(part) for part in zip(*canvas.samples, strict=True))
        # In the order of the pixels.
        order, starts = np.argsort(pixels, kind="stable"), np.cumsum(counts) - counts
        pixels, counts = pixels[order], counts[order]
        ends = np.cumsum(counts)
        number = np.repeat(starts[order] - (ends - counts), counts) + np.arange(len(weights))
        offsets, weights = offsets[number], weights[number]
        first = 0
        while first < len(pixels):
            start = ends[first] - counts[first]
            last = max(int(np.searchsorted(ends, start + _SAMPLES_PER_PIECE, side="right")), first + 1)
            piece, here = pixels[first:last], slice(start, ends[last - 1])
            owner = np.repeat(np.arange(len(piece)), counts[first:last])
            radiance = self._radiance(view, piece[owner], offsets[here])
            canvas.image[piece] = np.bincount(owner, radiance * weights[here], minlength=len(piece))
            first = last

    def _intersections(self, view: RayView, pixels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the lines along which two bodies intersect, with the pixel and the ends of each as in `MixedPixels`.

        The line follows from the planes of the faces at the centres of the pixel and of a neighbour.
        """
        width, size = view.rays.width, len(view.body)
        face, origin, normals = view.rays.face, view.rays.origin, view.caster.face_normals
        columns = pixels % width
        other = np.full(len(pixels), -1, dtype=np.int64)
        own_body = view.body[pixels]
        for step, inside in (
            (1, columns < width - 1),
            (-1, columns > 0),
            (width, pixels + width < size),
            (-width, pixels >= width),
        ):
            beside = np.where(inside, pixels + step, pixels)
            another = (view.body[beside] >= 0) & (view.body[beside] != own_body)
            other = np.where((other < 0) & another, beside, other)
        found = (other >= 0) & (own_body >= 0)
        pixels, other = pixels[found], other[found]
        corners = view.caster.vertices_mm[view.caster.topology.faces[:, 0]]

        def inverse_depth(of: NDArray[np.int64]) -> NDArray[np.float64]:
            normal = normals[face[of]]
            return np.asarray(normal / np.einsum("nk,nk->n", normal, corners[face[of]] - origin)[:, None])

        apart = inverse_depth(pixels) - inverse_depth(other)
        across, down = (item[pixels] if len(item) > 1 else item for item in (view.rays.across, view.rays.down))
        at_centre = np.einsum("nk,nk->n", apart, view.rays.directions[pixels])
        right, below = (apart * across).sum(axis=1), (apart * down).sum(axis=1)
        squared = np.maximum(right**2 + below**2, 1e-300)
        middle = -(at_centre / squared)[:, None] * np.column_stack([right, below])
        # Two pixels along the line in both directions cover the pixel.
        along = 2 / np.sqrt(squared)[:, None] * np.column_stack([-below, right])
        return pixels, np.hstack([middle - along, middle + along])

    def _largest_rules(self, rules: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the finest rule of every pixel and its neighbours."""
        from scenetruth.render.pixel_filter_kernels import NO_RULE

        padded = np.pad(np.where(rules == NO_RULE, 0, rules), 1).astype(np.uint8)
        rows = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
        return np.asarray(np.maximum(np.maximum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:]))

    def _radiance(self, view: RayView, pixels: NDArray[np.int64], offsets: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the radiance of samples, with the pixel and the offset of each, by tracing."""
        from scenetruth.raycast.pixel_ray_kernels import sample_directions

        directions = sample_directions(view.rays, pixels, offsets)
        hits = view.caster.cast_in_pixels(view.rays.origin, directions, pixels)
        uv, body = hits.interpolate_corners(view.mesh.uv), self._world.face_body[hits.face]
        radiance = np.full(len(directions), self._background, dtype=np.float32)
        self._look_up(body, np.flatnonzero(hits.face >= 0), uv, radiance)
        if self._shader is not None:
            rays = (view.rays.origin, directions)
            return self._shader.on_hits(radiance, view.caster, view.t, *rays, hits, view.face_light, pixels)
        return radiance
