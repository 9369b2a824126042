"""Light with steps inside pixels: facets, whose areas are exact, and borders of light and shadow."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast import Hits
from scenetruth.render.border_areas import grid_offsets, measure_areas
from scenetruth.render.footprint_averages import EXACT, SAMPLES_PER_PIECE, FootprintRenderer, ImageCanvas
from scenetruth.render.footprint_rules import FINE, WIDE, raster_of
from scenetruth.render.raycast_backend import RayView
from scenetruth.render.sampling_rules import WIDE_ORDERS
from scenetruth.render.shading import Arrived

__all__ = ["SteppedLightRenderer", "errors_above", "step_errors"]

_STEP_ERRORS = (np.nan, 0.090, 0.053, 0.037, 0.021, 0.014)  # of the filter, and of 2 x 2 to 8 x 8 Gauss points
_WIDE_STEP_ERRORS = {5: 0.027, 6: 0.021, 7: 0.017}  # of those of `WIDE_ORDERS` with fewer points
_LARGEST = 5  # error of a pixel relative to the RMS error of an image
_FINEST = 5  # the last Gauss rule
_FEW_FACES = 6  # facets in a pixel up to which borders between them are followed
_FINER = 3  # factor of the cells in pixels with several borders
_CELLS = 4  # cells along a side of pixels that the border of a shadow crosses, at the default error
_AREA_ERROR = 0.02  # error of the area next to a border without bisections


def errors_above(squares: NDArray[np.float64], error: float, count: int) -> NDArray[np.bool_]:
    """Return which squared errors are too large, so that the RMS of the others over a number of pixels is an error.

    No other error exceeds five times this RMS.
    """
    limit = (_LARGEST * error) ** 2
    if squares.sum() <= count * error**2 and squares.max(initial=0.0) <= limit:
        return np.zeros(len(squares), dtype=np.bool_)
    # Those below the mean of all that are allowed are kept in any case, and need not be sorted.
    small = squares <= count * error**2 / len(squares)
    ascending = np.sort(squares[~small])
    kept = int(np.searchsorted(np.cumsum(ascending), count * error**2 - squares[small].sum(), side="right"))
    if kept < len(ascending):
        limit = min(limit, float(ascending[kept - 1]) if kept else float(squares[small].max(initial=-1.0)))
    return np.asarray(squares > limit)


@lru_cache(maxsize=1)
def step_errors() -> NDArray[np.float64]:
    """Return the errors of the area on one side of a line across a pixel by the rules, shape (256,).

    RMS at random places and angles; of the rules with many samples, an upper limit.
    """
    errors = np.full(256, _STEP_ERRORS[-1])
    errors[: len(_STEP_ERRORS)] = _STEP_ERRORS
    for number, order in enumerate(WIDE_ORDERS, start=WIDE):
        errors[number] = _WIDE_STEP_ERRORS.get(order, errors[number])
    return errors


def _grown(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the marked pixels with all their neighbours, shape (height, width)."""
    rows = np.pad(pixels, 1)
    rows = rows[:-2] | rows[1:-1] | rows[2:]
    return np.asarray(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])


def _with_face(states: NDArray[np.uint64], face: NDArray[np.int32]) -> NDArray[np.uint64]:
    """Return numbers that differ between states and between faces."""
    return np.asarray((states << np.uint64(24)) ^ (states >> np.uint64(40)) ^ face.astype(np.uint64))


class SteppedLightRenderer(FootprintRenderer):
    """Renderer that resolves steps of the light in pixels on one surface."""

    _steps: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    _squares: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def _average(
        self,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
    ) -> None:
        """Render pixels on one surface by the rule of each, and where the light has steps, by areas of equal light."""
        if self._shader is not None and not canvas.bare:
            pixels = self._average_steps(view, canvas, pixels, rules, mixed)
        super()._average(view, canvas, pixels, rules, mixed)

    def _average_steps(
        self,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
    ) -> NDArray[np.int64]:
        """Render the pixels in which the light has steps, and return the others.

        Borders of light and shadow divide pixels into areas that bisection finds, and facets divide them into polygons.
        """
        light = canvas.light
        at_once = SAMPLES_PER_PIECE // 128
        if light is not None:
            # Shadows may end between the centres of pixels.
            across = pixels[_grown(light.borders).ravel()[pixels]]
            for first in range(0, len(across), at_once):
                self._average_borders(view, canvas, across[first : first + at_once], rules, mixed)
            pixels = pixels[~canvas.lit[pixels]]
            if light.steep is not None:
                # Penumbrae vary within facets.
                rest, pixels = pixels[light.steep.ravel()[pixels]], pixels[~light.steep.ravel()[pixels]]
            else:
                rest = pixels[:0]
        else:
            rest = pixels[:0]
        stepped = pixels[self._stepped(view, canvas, pixels, rules)]
        for first in range(0, len(stepped), at_once):
            self._average_facets(view, canvas, stepped[first : first + at_once], rules, mixed)
        return np.concatenate([rest, pixels[~canvas.lit[pixels]]])

    def _stepped(
        self, view: RayView, canvas: ImageCanvas, pixels: NDArray[np.int64], rules: NDArray[np.uint8]
    ) -> NDArray[np.bool_]:
        """Return the pixels whose facets may be lit so differently that the rules of their textures are too coarse."""
        face, rule, body = view.rays.face[pixels], np.maximum(rules.ravel()[pixels], 1), view.body[pixels]
        # Textures with steps have many samples, or are exact together with facets.
        coarse = (rule < FINE) | self._smooth_textures[body]
        if canvas.by_lamp is None:
            if canvas.light is not None:
                # These would have few samples in spite of their texture.
                coarse |= canvas.light.uneven.ravel()[pixels]
            bent = self._kinked(view.caster)
            neighbours = view.mesh.neighbours
            return np.asarray(coarse & (bent | ((neighbours >= 0) & bent[neighbours]).any(axis=1))[face])
        errors = self._light_errors(view, canvas.by_lamp)[face] * step_errors()[rule] ** 2
        exact = [not item.texture.cubic and raster_of(item.texture) is not None for item in self._world.bodies]
        if any(exact):
            # Together with facets, these textures are exact.
            coarse &= ~np.array(exact)[body] | (rule < EXACT)
        return errors_above(np.where(coarse, errors, 0.0), self._image_error, int(np.count_nonzero(view.body >= 0)))

    def _light_errors(self, view: RayView, by_lamp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the squared steps of the radiance between the facets in a pixel, see `_lamp_steps`, shape (m,)."""
        # Once for an image.
        if self._squares is None or self._squares[0] is not by_lamp:
            shown = np.bincount(view.body + 1, minlength=len(self._world.bodies) + 1)[1:]
            # Edges in a pixel, on average, of triangles of equal size.
            count = np.array([len(item.mesh.faces) for item in self._world.bodies])
            edges = 3 * np.sqrt(count / np.maximum(shown, 1))
            self._squares = (by_lamp, self._lamp_steps(view, by_lamp) * edges[self._world.face_body])
        return self._squares[1]

    def _lamp_steps(self, view: RayView, by_lamp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the steps of the radiance between facets, see `face_steps`; shadows begin along other lines."""
        # Twice for an image.
        if self._steps is None or self._steps[0] is not by_lamp:
            self._steps = (by_lamp, self._compute_lamp_steps(view, by_lamp))
        return self._steps[1]

    def _compute_lamp_steps(self, view: RayView, by_lamp: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `_lamp_steps`."""
        light = np.abs(by_lamp)
        if view.face_light is not None:
            for number in range(light.shape[1]):
                light[(view.face_light.bits[1] >> np.uint64(number)) & np.uint64(1) > 0, number] = np.nan
        light[self._world.face_smooth] = np.nan
        from scenetruth.render.shading_kernels import face_steps

        steps = face_steps(light, self._facets(view.caster)[1])
        return np.asarray(steps * (self._levels**2)[self._world.face_body])

    def _average_facets(
        self,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
    ) -> None:
        """Render pixels that show several facets, whose light is constant or linear on each."""
        from scenetruth.raycast.face_part_kernels import divide_pixels
        from scenetruth.raycast.pixel_ray_kernels import sample_directions

        divided, beside, parts = divide_pixels(view.mesh, view.rays, pixels)
        own = pixels[parts.owner]
        tested = np.flatnonzero(beside[parts.owner])
        directions = sample_directions(view.rays, own[tested], parts.offsets[tested])
        hits = view.caster.cast_in_pixels(view.rays.origin, directions, own[tested])
        divided[parts.owner[tested[hits.face != parts.face[tested]]]] = False
        # Pixels that cannot be divided show many facets, or other bodies that protrude.
        undivided = pixels[~divided]
        coarse = step_errors()[rules.ravel()[undivided]] > _STEP_ERRORS[_FINEST]
        rules.ravel()[undivided[coarse]] = _FINEST
        divided &= np.bincount(parts.owner, minlength=len(pixels)) > 1
        some = divided[parts.owner]
        owner, own, face = (np.cumsum(divided) - 1)[parts.owner[some]], own[some], parts.face[some]
        if canvas.by_lamp is not None:
            by_lamp, blocked = canvas.by_lamp[face], canvas.blocked[own]
            factors = np.full(len(face), self._lighting.ambient_irradiance)
            for number, part in enumerate(by_lamp.T):
                dark = (blocked >> np.uint64(number)) & np.uint64(1) > 0
                factors += np.where(dark, np.maximum(part, 0.0), np.abs(part))
            light = Arrived(factors, None, blocked, blocked)
        else:
            assert self._shader is not None
            directions = sample_directions(view.rays, own, parts.offsets[some])
            hits = Hits(face, parts.depth[some], parts.weights[some])
            light = self._shader.arrived(view.caster, view.t, view.rays.origin, directions, hits, own)
        self._light_up(
            view, canvas, pixels[divided], (owner, parts.area[some], face, parts.uv[some]), light, rules, mixed
        )

    def _average_borders(
        self,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
        cells: int | None = None,
    ) -> None:
        """Render pixels that borders of light and shadow cross.

        ``cells``: Along a side of the pixels, by default as many as the stated error requires.
        """
        again = cells is None
        if cells is None:
            # The error of curved borders decreases with the square of the number of cells.
            cells = int(np.clip(np.rint(_CELLS * np.sqrt(1e-4 / self._image_error)), 2, 12))
        rounds = int(np.clip(np.ceil(np.log2(_AREA_ERROR / self._image_error)), 3, 16))
        offsets = grid_offsets(cells)
        owner = np.repeat(np.arange(len(pixels)), len(offsets))
        hits, light = self._samples(view, pixels[owner], np.tile(offsets, (len(pixels), 1)))
        shape = (len(pixels), len(offsets))
        face, blocked, states = hits.face.reshape(shape), light.blocked.reshape(shape), light.state.reshape(shape)
        order = np.argsort(face, axis=1, kind="stable")
        ordered, along = np.take_along_axis(face, order, axis=1), np.take_along_axis(states, order, axis=1)
        same = ordered[:, 1:] == ordered[:, :-1]
        bent = self._kinked(view.caster)[face[:, 0]]
        few = bent & (np.count_nonzero(~same, axis=1) < _FEW_FACES)
        # Borders within facets; those along edges divide pixels into facets.
        crossed = (same & (along[:, 1:] != along[:, :-1])).any(axis=1)
        many = bent & ~few
        crossed[many] = (blocked[many] != blocked[many, :1]).any(axis=1)
        crossed &= (ordered[:, 0] >= 0) & ((states != states[:, :1]).any(axis=1))
        if again and crossed.any():
            # Several borders, which may cross or run next to each other, need more cells.
            every = np.sort(np.where(few[:, None], _with_face(states, face), states), axis=1)
            several = crossed & (np.count_nonzero(every[:, 1:] != every[:, :-1], axis=1) > 1)
            at_once = max(1, SAMPLES_PER_PIECE // (_FINER * cells + 1) ** 2)
            for first in range(0, np.count_nonzero(several), at_once):
                some = pixels[several][first : first + at_once]
                self._average_borders(view, canvas, some, rules, mixed, _FINER * cells)
            crossed &= ~several
        own, some, few = pixels[crossed], crossed[owner], few[crossed]

        def state_of(hits: Hits, light: Arrived, number: NDArray[np.int64]) -> NDArray[np.uint64]:
            # A few facets are areas of their own.
            with_face = _with_face(light.state, hits.face)
            return np.where(few[number], with_face, light.state)

        def state_at(number: NDArray[np.int64], places: NDArray[np.float64]) -> NDArray[np.uint64]:
            return state_of(*self._samples(view, own[number], places, states_only=True), number)

        hits = Hits(hits.face[some], hits.depth[some], hits.weights[some])
        light = Arrived(*(None if item is None else item[some] for item in light))  # type: ignore[arg-type]
        owner = np.repeat(np.arange(len(own)), len(offsets))
        nodes = state_of(hits, light, owner).reshape(-1, cells + 1, cells + 1)
        areas = measure_areas(nodes, state_at, rounds).ravel()
        parts = (owner, areas, hits.face, hits.interpolate_corners(view.mesh.uv))
        self._light_up(view, canvas, own, parts, light, rules, mixed)

    def _samples(
        self, view: RayView, pixels: NDArray[np.int64], offsets: NDArray[np.float64], *, states_only: bool = False
    ) -> tuple[Hits, Arrived]:
        """Return hits and light of samples, with the pixel of each, ascending, and its offset.

        ``states_only``: See `Shader.arrived`.
        """
        from scenetruth.raycast.pixel_ray_kernels import sample_directions

        assert self._shader is not None
        directions = sample_directions(view.rays, pixels, offsets)
        hits = view.caster.cast_in_pixels(view.rays.origin, directions, pixels)
        place = (view.caster, view.t, view.rays.origin, directions, hits, pixels)
        return hits, self._shader.arrived(*place, with_states=True, states_only=states_only)

    def _light_up(
        self,
        view: RayView,
        canvas: ImageCanvas,
        pixels: NDArray[np.int64],
        parts: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]],
        light: Arrived,
        rules: NDArray[np.uint8],
        mixed: NDArray[np.bool_],
    ) -> None:
        """Render pixels by the mean of their texture and parts with light.

        The mean light multiplies the mean of the texture, by the rule of the pixel; only the product of deviations is
        a sum over parts.

        ``parts``: Index of the pixel, area in px², face and texture coordinates of each part.
        """
        if not len(pixels):
            return
        owner, areas, face, uv = parts
        # No samples are shared with the image.
        bare = replace(
            canvas, image=np.empty_like(canvas.image), lit=np.zeros_like(canvas.lit), light=None, by_lamp=None,
            samples=[], large=[], bare=True,
        )  # fmt: skip
        self._average(view, bare, pixels, rules, mixed)
        self._trace_samples(view, bare)
        texture = np.empty(len(owner), dtype=np.float32)
        self._look_up(self._world.face_body[face], np.arange(len(owner)), uv, texture)
        mean = np.bincount(owner, areas * light.factors, minlength=len(pixels))
        apart = areas * (light.factors - mean[owner]) * texture
        if light.gloss is not None:
            apart += areas * light.gloss
        canvas.image[pixels] = mean * bare.image[pixels] + np.bincount(owner, apart, minlength=len(pixels))
        canvas.lit[pixels] = True
