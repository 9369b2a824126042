"""Ray casting with as many samples per pixel as texture and edges require, within a stated error."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.raycast import (
    Changes,
    FirstFaces,
    ImageRays,
    MixedPixels,
    RayCaster,
    SurfaceLines,
    TexturedMesh,
    find_mixed_pixels,
    places_in_pixels,
)
from scenetruth.render.footprint_averages import ImageCanvas
from scenetruth.render.footprint_rules import (
    ALONE,
    BLOCK,
    FINE,
    UNCUT,
    WIDE,
    bend_errors,
    block_bends,
    cell_orders,
    gauss_tables,
)
from scenetruth.render.raycast_backend import RayView, RepeatingRayCaster, visible_uv
from scenetruth.render.sampling_rules import (
    FILTER_TAPS,
    GAUSS_ORDERS,
    WIDE_ORDERS,
    compute_widest_steps,
    lattice_rule,
    step_indices,
)
from scenetruth.render.stepped_light import SteppedLightRenderer, errors_above, step_errors
from scenetruth.scene.texture import SurfaceTexture, TintedTexture

__all__ = ["AdaptiveRenderer"]

_CROWDED = 521  # samples of the lattice for mixed pixels that are not cut along their edges
_PIXELS_PER_PIECE = 1 << 16
_CUT_ERROR = 0.05  # RMS error of the area on one side of a line across a pixel that is cut along others
_AREA_ERROR = 0.25  # the same by n x n Gauss points, times n^1.4, as `stepped_light` states it for n = 2 to 8
_EDGES_CUT = 3  # edges between facets in a mixed pixel, on average
_EVERY = 4  # rows and columns from one to the next of the pixels of which the error of an image is determined
_FEW_LOWERED = 0.1  # fraction of the pixels up to which no coarser rules are chosen, because the choice takes longer
_MANY_ORDER = 7  # Gauss points per pixel along each axis from which areas are fine enough without cuts
_LEAST_ORDER = 2  # Gauss points per pixel along each axis in mixed pixels
_FINE_ORDER = 16  # Gauss points per pixel along each axis across shadows in mixed pixels


class _Cut(NamedTuple):
    """Mixed pixels that are cut, with the arguments of `edge_cell_kernels.cut_pixels`.

    ``open``: Pixels in which surfaces may end inside a cell, because they are not cut along all edges.
    """

    pixels: NDArray[np.int64]
    starts: NDArray[np.int64]
    ends: NDArray[np.float64]
    orders: NDArray[np.int64]
    open: NDArray[np.bool_]

    def samples(
        self,
        some: NDArray[np.int64],
        found: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
        """Return the samples of some of the pixels as in `ImageCanvas`, from the results of `cut_pixels`."""
        firsts, offsets, weights, cells = found
        counts = np.diff(firsts)
        cells[np.repeat(self.open[some], counts)] = -1
        return self.pixels[some], counts, offsets, weights, cells


class AdaptiveRenderer(SteppedLightRenderer):
    """Renderer by ray casting that adapts the samples of every pixel to texture and edges.

    Where the texture is coarse enough and the surface smooth, samples at pixel centres are filtered
    (`sampling_rules.FILTER_TAPS`); elsewhere the order of the Gauss rule follows from the texture step per pixel.
    Pixels crossed by edges are cut along them. For bilinear textures, which may have steps, the rule follows from the
    range of the texture in each pixel, and pixels with steps get a lattice of samples.

    Flat faces in parallel light are in the light or in shadow as a whole, or are cut along the borders of shadows.

    ``image_error``: RMS error of the radiance by which the rules are chosen.
    """

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
        wanted = self._surfaces.hits.expects(t, camera, viewpoint)
        edges = self._find_mixed(caster, viewpoint, body.reshape(shape), lines, changes, apart=wanted)
        if edges.surfaces is not None:
            self._surfaces.hits.keep(t, camera, viewpoint, FirstFaces(hits.face, edges.surfaces))
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
        uv = visible_uv(world, caster, origin)
        mesh = TexturedMesh(caster.vertices_mm, world.faces, caster.topology.face_neighbours, world.face_body, uv)
        rays = ImageRays(origin, directions, across, down, hits.face, camera.width)
        view = RayView(caster, t, mesh, rays, body, faces if decided else None)

        place = hits.interpolate_corners(uv)
        albedo = np.full(len(body), self._background, dtype=np.float32)
        rules, steps = choose_rules(
            place.reshape(*shape, 2), body.reshape(shape), edges.mixed, self._texels, self._longest
        )
        self._use_allowed_error(rules, steps, view, None if faces is None else faces.by_lamp)
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
        canvas = ImageCanvas(
            image, albedo, np.zeros(len(body), dtype=np.bool_), light, by_lamp, shade.ravel(), blocked.ravel(), [], []
        )
        self._average(view, canvas, left, rules, edges.mixed)
        cut = self._cut(view, canvas, edges, rules)
        traced = self._trace_samples(view, canvas, edges.mixed.ravel() if self._shader is not None else None)
        if traced and len(cut.pixels):
            pixel, face, lit = zip(*traced, strict=True)
            self._cut_again(view, canvas, cut, *map(np.concatenate, (pixel, face, lit)))
        return image.reshape(shape) * np.float32(self._lighting.brightness(t))

    def _find_mixed(
        self,
        caster: RayCaster,
        viewpoint: Viewpoint,
        body: NDArray[np.int32],
        lines: SurfaceLines | None,
        changes: Changes | None,
        *,
        apart: bool,
    ) -> MixedPixels:
        """Return the mixed pixels, which bands with the same lines have in common."""

        def find() -> MixedPixels:
            return find_mixed_pixels(caster, viewpoint, self._camera, body, lines, changes, apart=apart)

        if not isinstance(caster, RepeatingRayCaster):
            return find()
        parts = () if lines is None else (lines.starts_mm, lines.ends_mm, lines.face, lines.label)
        found: MixedPixels = caster.again("mixed pixels", find, viewpoint.position_mm, body, *parts)
        # Bands mark further pixels.
        return replace(found, mixed=found.mixed.copy(), bare=found.bare.copy())

    def _use_allowed_error(
        self,
        rules: NDArray[np.uint8],
        steps: NDArray[np.float32],
        view: RayView,
        by_lamp: NDArray[np.float64] | None,
    ) -> None:
        """Change the rules for textures whose spectrum ends to coarser rules, up to the error of the whole image.

        The rule of a pixel is seldom at its limit, so that the RMS error over the pixels of an image is far smaller.
        Rules that are too coarse for the light on facets remain.

        ``by_lamp``: See `ImageCanvas`.
        """
        limits = [np.where(self._smooth_textures[:, None], longest, -1.0) for longest in self._longer]

        def find_lowered(
            pixels: NDArray[np.int64], longest: NDArray[np.float64]
        ) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
            """Return which of some pixels may have the next coarser rule, and this rule."""
            lower = rules.ravel()[pixels] - 1
            short = steps.ravel()[pixels] <= longest.ravel().take(view.body[pixels] * longest.shape[1] + lower)
            pixels, lower = pixels[short], lower[short]
            if by_lamp is not None:
                light = self._light_errors(view, by_lamp)[view.rays.face[pixels]]
                fine = light * step_errors()[lower] ** 2 <= self._image_error**2
                pixels, lower = pixels[fine], lower[fine]
            return pixels, lower

        flat, width = rules.ravel(), rules.shape[1]
        some = np.arange(0, rules.shape[0], _EVERY)[:, None] * width + np.arange(0, width, _EVERY)
        some = some.ravel()
        some = some[view.body[some] >= 0]
        own = some[flat[some] <= FINE]
        own = own[np.isfinite(steps.ravel()[own]) & self._smooth_textures[view.body[own]]]
        fine = own[flat[own] > 1]
        if len(find_lowered(fine, limits[0])[0]) <= _FEW_LOWERED * len(fine):
            return
        index, squares = step_indices(steps.ravel()[own]), self._rule_errors**2
        rule = flat[own]
        for longest in limits:
            lowered, lower = find_lowered(fine, longest)
            chosen = np.minimum(rule, FINE - 1)
            chosen[np.searchsorted(own, lowered)] = lower
            found = squares[view.body[own], chosen, index]
            found[(rule == FINE) & (chosen == FINE - 1)] = self._image_error**2
            # The light on facets has errors of its own.
            if found.sum() <= self._image_error**2 / 2 * len(some):
                lowered, lower = find_lowered(np.flatnonzero((flat > 1) & (flat <= FINE)), longest)
                flat[lowered] = lower
                return

    def _choose_for_bends(
        self, rules: NDArray[np.uint8], steps: NDArray[np.float32], place: NDArray[np.float64], body: NDArray[np.int32]
    ) -> None:
        """Change the rules for textures without an end of their spectrum, by the bends of the texture in each pixel."""
        from scenetruth.render.pixel_filter_kernels import NO_RULE, texture_ranges

        fine, large = np.flatnonzero(rules == FINE), np.flatnonzero((rules == FINE - 1) | (rules == FINE - 2))
        alone = np.flatnonzero(rules == FINE - 1)
        alone = alone[np.isinf(steps[alone])]
        rules[fine] = FINE + 1
        fine, large = fine[steps[fine] < np.inf], large[steps[large] < np.inf]
        for index, item in enumerate(self._world.bodies):
            tinted = item.texture if isinstance(item.texture, TintedTexture) else TintedTexture(item.texture, 1.0)
            factor = max(tinted.factor, 1.0)
            if item.texture.cubic:
                rules[alone[body[alone] == index]] = ALONE
                every = np.concatenate([fine[body[fine] == index], large[body[large] == index]])
                if len(every):
                    self._choose_wide(rules, steps, every, tinted.untinted, factor, float(self._longest[index, -3]))
                continue
            every = np.flatnonzero((body == index) & (rules != NO_RULE))
            bends = block_bends(tinted.untinted)
            straight = np.zeros_like(bends)
            for first in range(0, len(every), _PIXELS_PER_PIECE):
                pixels = every[first : first + _PIXELS_PER_PIECE]
                uv, step = place[pixels], steps[pixels].astype(np.float64)
                if item.texture.tiled:
                    uv -= np.floor(uv)
                places = (uv * self._texels[index] - 0.5) / BLOCK
                rough = factor * texture_ranges(straight, bends, item.texture.tiled, places, step / BLOCK)
                # The slope per pixel changes by a bend times the step. Both axes, and several bends, add at random.
                bend = rough * np.clip(step, 0, 1e9) * np.sqrt(2 * np.clip(step, 1.0, 1e9))
                chosen = np.full(len(pixels), bend_errors()[-1][0], dtype=np.uint8)
                for rule, error in reversed(bend_errors()):
                    chosen[bend * error <= self._image_error] = rule
                rules[pixels] = chosen

    def _choose_wide(
        self, rules: NDArray[np.uint8], steps: NDArray[np.float32], pixels: NDArray[np.int64], texture: SurfaceTexture,
        factor: float, least: float,
    ) -> None:  # fmt: skip
        """Change the rules of pixels with many texels of a texture."""
        limits = compute_widest_steps(texture, self._image_error / factor, least, float(steps[pixels].max()))
        orders = np.full(FINE + 2, np.inf)
        orders[1:FINE] = GAUSS_ORDERS
        before = orders[rules[pixels]]
        for number, limit in reversed(list(enumerate(limits.tolist(), start=WIDE))):
            rules[pixels[(steps[pixels] <= limit) & (before > WIDE_ORDERS[number - WIDE])]] = number

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

    def _cut(self, view: RayView, canvas: ImageCanvas, edges: MixedPixels, rules: NDArray[np.uint8]) -> _Cut:
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
        largest = self._largest_orders(rules).ravel()
        uncut = (counts > MOST_EDGES) | (edges.bare.ravel() & (counts == 0)) | (largest == UNCUT)
        canvas.trace_later(np.flatnonzero(edges.mixed.ravel() & uncut), lattice_rule(_CROWDED))
        pixels, ends = np.flatnonzero(edges.mixed.ravel() & ~uncut), ends[~uncut[owners]]
        starts = np.concatenate([[0], np.cumsum(counts[pixels])])
        orders = np.maximum(largest[pixels], _LEAST_ORDER).astype(np.int64)
        cut = _Cut(pixels, starts, ends, orders, (many | edges.bare.ravel())[pixels])
        samples = cut_pixels(ends, starts, orders, *gauss_tables(_FINE_ORDER))
        canvas.samples.append(cut.samples(np.arange(len(pixels)), samples))
        return cut

    def _cut_again(
        self,
        view: RayView,
        canvas: ImageCanvas,
        cut: _Cut,
        pixel: NDArray[np.int64],
        face: NDArray[np.int64],
        light: NDArray[np.float64],
    ) -> None:
        """Cut mixed pixels along the edges between differently lit facets as well, with more samples across shadows.

        ``pixel``, ``face``, ``light``: Of the samples in mixed pixels, see `_trace_samples`.
        """
        from scenetruth.raycast.edge_cell_kernels import MOST_CUTS, cut_pixels
        from scenetruth.render.shading_kernels import face_steps, mean_by_owner

        error, count, faces = self._image_error, len(cut.pixels), len(view.mesh.faces)
        # Pixels with many texels have enough samples for areas without cuts.
        areas = np.where(cut.orders >= _MANY_ORDER, _AREA_ERROR * cut.orders.astype(np.float64) ** -1.4, _CUT_ERROR)
        surface, bent = int(np.count_nonzero(view.body >= 0)), self._kinked(view.caster)
        number = np.full(len(canvas.image), -1, dtype=np.int64)
        number[cut.pixels] = np.arange(count)
        owner = number[pixel]
        within: NDArray[np.float64] = np.zeros(count)
        if view.face_light is not None and canvas.by_lamp is not None:
            # Pixels are cut along the borders of shadows, so that the light is constant on every facet.
            squares = _EDGES_CUT * mean_by_owner(owner, face, self._lamp_steps(view, canvas.by_lamp), count)
            again = np.flatnonzero(errors_above(areas**2 * squares, error, surface))
            if not len(again):
                return
            wanted = np.zeros(count, dtype=np.bool_)
            wanted[again] = True
            chosen = np.flatnonzero((owner >= 0) & wanted[owner])
            owner, face = np.divmod(np.unique(owner[chosen] * faces + face[chosen]), faces)
        else:
            chosen = np.flatnonzero(owner >= 0)
            pairs, of = np.unique(owner[chosen] * faces + face[chosen], return_inverse=True)
            owner, face = np.divmod(pairs, faces)
            lowest, highest = np.full(len(pairs), np.inf), np.full(len(pairs), -np.inf)
            np.minimum.at(lowest, of, light[chosen])
            np.maximum.at(highest, of, light[chosen])
            # Shadows and highlights within a facet.
            within = np.bincount(owner, (highest - lowest) ** 2, minlength=count).astype(np.float64)
            seen = np.bincount(face, minlength=faces)
            own = np.bincount(face, (lowest + highest) / 2, minlength=faces) / np.where(bent & (seen > 0), seen, np.nan)
            around = np.bincount(owner, face_steps(own[:, None], self._facets(view.caster)[1])[face], minlength=count)
            again = np.flatnonzero(errors_above(areas**2 * (within + around), error, surface))
        if not len(again):
            return
        orders = cut.orders.copy()
        orders[areas * np.sqrt(within) > error] = _FINE_ORDER
        place = np.full(count, -1, dtype=np.int64)
        place[again] = np.arange(len(again))
        facets = (place[owner] >= 0) & bent[face]
        owner, ends = self._facet_edges(view, cut.pixels, owner[facets], face[facets])
        old = np.repeat(np.arange(count), np.diff(cut.starts))
        kept = place[old] >= 0
        number = np.bincount(owner, minlength=count) + np.bincount(old, minlength=count)
        # With too many facets, steps between them are small.
        crowded = number > MOST_CUTS
        orders[crowded] = _FINE_ORDER
        fits = ~crowded[owner]
        owner = np.concatenate([place[old[kept]], place[owner[fits]]])
        ends = np.concatenate([cut.ends[kept], ends[fits]])
        order = np.argsort(owner, kind="stable")
        starts = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(again)))])
        samples = cut_pixels(ends[order], starts, orders[again], *gauss_tables(_FINE_ORDER))
        canvas.samples[:] = [cut.samples(again, samples)]
        canvas.large.clear()
        self._trace_samples(view, canvas)

    def _facet_edges(
        self, view: RayView, pixels: NDArray[np.int64], owner: NDArray[np.int64], face: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the edges of faces in pixels: index of the pixel, and ends as in `MixedPixels`.

        ``owner``, ``face``: Index of the pixel among ``pixels`` and face, shape (n,) each.
        """
        corners, neighbours, origin = view.mesh.faces[face], view.mesh.neighbours[face], view.rays.origin
        pairs = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        # Edges without a second face are silhouettes.
        inner = (neighbours >= 0).ravel()
        vertices = len(view.mesh.vertices)
        owner = np.repeat(owner, 3)[inner]
        keys = (owner * vertices + pairs[inner, 0]) * vertices + pairs[inner, 1]
        keys = np.unique(keys)
        rest, second = np.divmod(keys, vertices)
        owner, one = np.divmod(rest, vertices)
        own = pixels[owner]
        rays, ends = view.rays, view.mesh.vertices[np.stack([one, second], axis=1)] - origin
        multiple, places = places_in_pixels(rays.directions, (rays.across, rays.down), rays.width, own, ends)
        front = (multiple > 0).all(axis=1)
        return owner[front], places[front].reshape(-1, 4)

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

    def _largest_orders(self, rules: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the highest order of cells of every pixel and its neighbours."""
        padded = np.pad(cell_orders()[rules], 1)
        rows = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
        return np.asarray(np.maximum(np.maximum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:]))
