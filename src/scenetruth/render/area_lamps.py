"""Light of lamps with a size on the points that a camera sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast import RayCaster
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lamp

if TYPE_CHECKING:
    from scenetruth.raycast.surface_tree_kernels import SurfaceTree

__all__ = ["AreaLamps", "SeenPoints", "largest_pixel_angle", "pack_lamp"]

Surface = tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]
Seen = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]
_INTERPOLATED = 2e-3  # largest error of interpolated shares of light at the nearest pixels
_STEEP = 0.12  # difference of shares of neighbours, from which every sample has its own
_BEND = 1e-4  # relative error of the light that is interpolated between the corners of a face
_APART = 6.0  # pixels between two surfaces, in depth
_SPARE = 1.5  # margin of the size of pixels


class SeenPoints(NamedTuple):
    """Points of surfaces that a camera sees.

    ``origin_mm``: Position of the camera, shape (3,).
    ``points_mm``, ``normals``: Points and unit normals on the visible side, shape (n, 3) each.
    ``faces``: Face of each point, shape (n,).
    ``starts_mm``: Origins of the shadow rays on the visible side, see `shading_kernels.smooth_points`, shape (n, 3).
    ``weights``: Weights of the second and third corner, shape (n, 2); None if they are not given.
    ``pixels``: Pixel of each point in the image that `AreaLamps.begin` prepared, shape (n,); None outside images.
    """

    origin_mm: NDArray[np.float64]
    points_mm: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int32]
    starts_mm: NDArray[np.float64]
    weights: NDArray[np.float64] | None = None
    pixels: NDArray[np.int64] | None = None

    @property
    def view(self) -> Seen:
        """Camera, points, normals and faces, as kernels take them."""
        return self.origin_mm, self.points_mm, self.normals, self.faces

    def some(self, chosen: NDArray[np.int64]) -> SeenPoints:
        """Return some of the points."""
        return SeenPoints(
            self.origin_mm,
            self.points_mm[chosen],
            self.normals[chosen],
            self.faces[chosen],
            self.starts_mm[chosen],
            None if self.weights is None else self.weights[chosen],
            None if self.pixels is None else self.pixels[chosen],
        )


def pack_lamp(lamp: Lamp) -> NDArray[np.float64]:
    """Return a lamp with a size as an array for `area_lamp_kernels`."""
    from scenetruth.render.area_lamp_kernels import POLAR, RECTANGLE, SPHERE

    area = lamp.area
    assert area is not None
    assert lamp.position_mm is not None
    shape = {"round": POLAR, "rectangle": RECTANGLE, "sphere": SPHERE}[area.shape]
    return np.concatenate(
        [[shape], lamp.position_mm, area.across, area.down, lamp.axis, area.sizes_mm, [area.radiance]]
    )


@dataclass(frozen=True, eq=False)
class _View:
    """One image: the lamps, and the shares of their light that reach the pixels.

    ``packed``, ``depths``: For each lamp, `pack_lamp` and the optical depth of each face, or None without a size.
    ``body``, ``distance_mm``: Body and distance from the camera at each pixel, shape (height, width).
    ``pixel_angle``: Largest angle between neighbouring pixels. ``knowledge``: See `apply_shares`.
    ``shares``: Of factor and gloss, for each lamp, shape (lamps, height, width, 2).
    ``centres``: Pixels without knowledge whose shares hold at the centre and close to it, shape (height, width).
    ``corner_light``: Light of each lamp without shadows, and ambient light, at the corners of faces, NaN if it is not
    computed, shape (lamps + 1, m, 3, 2). ``fine``: Faces on which it can be interpolated, shape (m,).
    ``done``: Faces for which nothing is left to compute, shape (lamps + 1, m).
    """

    caster: RayCaster
    origin_mm: NDArray[np.float64]
    packed: list[NDArray[np.float64] | None]
    depths: list[NDArray[np.float64] | None]
    body: NDArray[np.int32]
    distance_mm: NDArray[np.float64]
    pixel_angle: float
    knowledge: NDArray[np.uint8]
    shares: NDArray[np.float64]
    centres: NDArray[np.bool_]
    corner_light: NDArray[np.float64]
    fine: NDArray[np.bool_]
    done: NDArray[np.bool_]


class AreaLamps:
    """Light of lamps with a size, and, within images, of all lamps at the corners of faces.

    Without shadows, it follows from closed forms or sums over the lamp: at each point, or at the corners of faces that
    are small enough. Shadows are computed as shares of this light: in each image, at as many pixels as interpolation
    requires.
    """

    def __init__(
        self, world: BuiltScene, transmitted: Callable[[RayCaster, Lamp], NDArray[np.float64]],
        roughness: NDArray[np.float64], *, shadows: bool,
    ) -> None:  # fmt: skip
        """Set up lamps; ``transmitted``: Returns the share of a lamp's light that each face transmits, shape (m,).

        ``roughness``: Of each face, infinite without gloss, shape (m,).
        """
        self._world = world
        self._transmitted = transmitted
        self._roughness = roughness
        self._shadows = shadows
        self._tree: tuple[RayCaster, SurfaceTree] | None = None
        self._sides: tuple[RayCaster, NDArray[np.float64], NDArray[np.float64]] | None = None
        self._view: _View | None = None

    def begin(
        self, caster: RayCaster, lamps: list[Lamp], place: SeenPoints, surface: Surface, mixed: NDArray[np.bool_],
        pixel_angle: float,
    ) -> None:  # fmt: skip
        """Prepare an image.

        ``place``: Points at the pixel centres. ``mixed``: Pixels whose footprint crosses an edge, shape (height,
        width). ``pixel_angle``: Largest angle between neighbouring pixels.
        """
        from scenetruth.render.lamp_lattice_kernels import CLEAR, UNKNOWN

        world, shape = self._world, mixed.shape
        assert place.pixels is not None
        packed = [None if lamp.area is None else pack_lamp(lamp) for lamp in lamps]
        body = np.full(mixed.size, -1, dtype=np.int32)
        body[place.pixels] = world.face_body[place.faces]
        distance = np.full(mixed.size, np.nan)
        distance[place.pixels] = np.linalg.norm(place.points_mm - place.origin_mm, axis=1)
        fine = self._fine_faces(caster, place.origin_mm, lamps)
        view = _View(
            caster,
            place.origin_mm,
            packed,
            [None if lamp.area is None or not self._shadows else self._depths(caster, lamp) for lamp in lamps],
            body.reshape(shape),
            distance.reshape(shape),
            pixel_angle,
            np.full(shape, CLEAR, dtype=np.uint8),
            np.ones((len(lamps), *shape, 2)),
            np.zeros(shape, dtype=np.bool_),
            np.full((len(lamps) + 1, len(world.face_body), 3, 2), np.nan),
            fine,
            np.tile(~fine, (len(lamps) + 1, 1)),
        )
        if self._shadows:
            view.knowledge[mixed] = UNKNOWN
            if any(lamp.area is not None for lamp in lamps):
                self._find_shares(view, place, surface, mixed)
        self._view = view

    def keep_shares(self, number: int, pixels: NDArray[np.int64], shares: NDArray[np.float64]) -> None:
        """Keep the shares of a lamp without a size at the pixel centres of the image, shape (n,)."""
        if self._view is not None:
            self._view.shares[number].reshape(-1, 2)[pixels] = shares[:, None]

    def mark_borders(self, borders: NDArray[np.bool_]) -> None:
        """Mark where shares of lamps without a size may differ in a pixel: at borders and next to them.

        ``borders``: Pixels whose centre and that of a neighbour are lit differently, shape (height, width).
        """
        from scipy import ndimage

        from scenetruth.render.lamp_lattice_kernels import STEEP, UNKNOWN

        if self._view is not None and self._shadows and any(packed is None for packed in self._view.packed):
            knowledge = self._view.knowledge
            # Shadows may end between the centres of pixels.
            around = ndimage.binary_dilation(borders, np.ones((3, 3)))
            knowledge[around & (knowledge != UNKNOWN)] = STEEP

    def steep(self) -> NDArray[np.bool_]:
        """Return the pixels of the image next to which the shares are very different, shape (height, width)."""
        from scenetruth.render.lamp_lattice_kernels import STEEP

        assert self._view is not None
        return np.asarray(self._view.knowledge == STEEP)

    def light(
        self, caster: RayCaster, number: int, lamp: Lamp, place: SeenPoints, surface: Surface
    ) -> NDArray[np.float64]:
        """Return factor and gloss by one of the lamps at points, shape (n, 2)."""
        view = self._view_of(caster, place.origin_mm)
        light = self._without_shadows(view, number, lamp, place, surface)
        if self._shadows:
            self._shade(view, caster, number, lamp, place, surface, light)
        return light

    def ambient(
        self, caster: RayCaster, ambient: float, lamps: list[Lamp], place: SeenPoints, surface: Surface
    ) -> NDArray[np.float64] | None:
        """Return factors and gloss by ambient light, shape (n, 2); None if the image is not prepared."""
        view = self._view_of(caster, place.origin_mm)
        if view is None or place.weights is None:
            return None
        number = len(view.packed)
        return self._interpolated(view, number, place, self._computation(number, ambient, lamps, surface))

    def _view_of(self, caster: RayCaster, origin_mm: NDArray[np.float64]) -> _View | None:
        """Return the prepared image if it is that of a camera position."""
        view = self._view
        if view is None or not (view.caster is caster and np.array_equal(view.origin_mm, origin_mm)):
            return None
        return view

    def _compute_corners(
        self, view: _View, number: int, faces: NDArray[np.int32], compute: Callable[[Seen], NDArray[np.float64]]
    ) -> None:
        """Compute the light at the corners of the faces for which it is missing."""
        corner_light = view.corner_light[number]
        found = np.zeros(len(view.fine), dtype=np.bool_)
        found[faces] = True
        missing = np.flatnonzero(found & ~view.done[number]).astype(np.int32)
        if len(missing):
            view.done[number, missing] = True
            caster = view.caster
            corners, normals = caster.vertices_mm[caster.topology.faces[missing]], caster.face_normals[missing]
            towards = np.einsum("nk,nk->n", normals, view.origin_mm - corners[:, 0])
            normals *= np.where(towards > 0, 1.0, -1.0)[:, None]
            corner_light[missing] = compute((view.origin_mm, corners, normals, missing))

    def _interpolated(
        self, view: _View, number: int, place: SeenPoints, compute: Callable[[Seen], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Return light from the corners of faces where it can be interpolated, and as computed elsewhere."""
        from scenetruth.render.lamp_lattice_kernels import mix_light

        self._compute_corners(view, number, place.faces, compute)
        light = np.empty((len(place.faces), 2))
        assert place.weights is not None
        mix_light(view.corner_light[number], place.faces, place.weights, light)
        other = np.flatnonzero(~view.fine[place.faces])
        if len(other):
            light[other] = compute(place.some(other).view)
        return light

    def _fine_faces(self, caster: RayCaster, origin_mm: NDArray[np.float64], lamps: list[Lamp]) -> NDArray[np.bool_]:
        """Return the flat faces that are small, compared with their distance from camera and lamps, shape (m,)."""
        if self._sides is None or self._sides[0] is not caster:
            corners = caster.vertices_mm[caster.topology.faces]
            sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
            self._sides = (caster, sides, corners[:, 0].copy())
        _, longest, centres = self._sides
        nearest = np.linalg.norm(centres - origin_mm, axis=1)
        for lamp in lamps:
            if lamp.position_mm is None:
                continue
            reach = 0.0
            if lamp.area is not None:
                sizes = lamp.area.sizes_mm
                reach = float(np.hypot(*sizes)) if lamp.area.shape == "rectangle" else sizes[1]
            nearest = np.minimum(nearest, np.linalg.norm(centres - lamp.position_mm, axis=1) - reach)
        with np.errstate(divide="ignore"):
            bend = (longest / np.maximum(nearest - longest, 1e-3 * longest)) ** 2 / 8 * (1 + 4 / self._roughness**2)
        return np.asarray((bend < _BEND) & (nearest > longest) & ~self._world.face_smooth)

    def on_samples(
        self, caster: RayCaster, ambient: float, lamps: list[Lamp], origin_mm: NDArray[np.float64],
        samples: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]], surface: Surface,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]] | None:  # fmt: skip
        """Return factors and gloss of samples of the prepared image, and the samples that this leaves out.

        ``samples``: Pixel, face, and weights of the second and third corner, shapes (n,), (n,) and (n, 2).
        Returns None without lamps, with lamps without a size whose light differs by direction, and outside the image.
        """
        from scenetruth.render.lamp_lattice_kernels import light_samples

        view = self._view_of(caster, origin_mm)
        if view is None or not lamps or any(lamp.area is None and lamp.directed for lamp in lamps):
            return None
        for number in range(len(view.packed) + 1):
            self._compute_corners(view, number, samples[1], self._computation(number, ambient, lamps, surface))
        return light_samples(
            samples, view.corner_light, self._world.face_body, view.body.ravel(), view.knowledge.ravel(),
            view.shares.reshape(len(lamps), -1, 2),
        )  # fmt: skip

    def _computation(
        self, number: int, ambient: float, lamps: list[Lamp], surface: Surface
    ) -> Callable[[Seen], NDArray[np.float64]]:
        """Return the function that computes the light of one of the lamps, or the ambient light after the last.

        It takes points, shape (n, 3), or the corners of faces, shape (n, 3, 3), and returns factors and gloss.
        """
        from scenetruth.render.area_lamp_kernels import unshaded_corners, unshaded_light
        from scenetruth.render.reflectance_kernels import reflect_ambient

        if number < len(lamps) and lamps[number].area is None:
            return lambda seen: _sharp_light(lamps[number], seen, surface)
        if number < len(lamps):
            packed = pack_lamp(lamps[number])
            return lambda seen: (unshaded_corners if seen[1].ndim == 3 else unshaded_light)(packed, seen, surface)

        def compute(seen: Seen) -> NDArray[np.float64]:
            many = _single_points(seen)
            factors, gloss = np.zeros((2, len(many[1])))
            reflect_ambient(ambient, many, surface, factors, gloss)
            return np.stack([factors, gloss], axis=-1).reshape(*seen[1].shape[:-1], 2)

        return compute

    def _without_shadows(
        self, view: _View | None, number: int, lamp: Lamp, place: SeenPoints, surface: Surface
    ) -> NDArray[np.float64]:
        """Return the light without shadows, shape (n, 2)."""
        compute = self._computation(0, 0.0, [lamp], surface)
        if view is None or place.weights is None:
            return compute(place.view)
        return self._interpolated(view, number, place, compute)

    def _shade(
        self, view: _View | None, caster: RayCaster, number: int, lamp: Lamp, place: SeenPoints, surface: Surface,
        light: NDArray[np.float64],
    ) -> None:  # fmt: skip
        """Multiply light by the shares that reach points, in place, shape (n, 2)."""
        from scenetruth.render.lamp_lattice_kernels import apply_shares

        def exact(chosen: NDArray[np.int64]) -> NDArray[np.float64]:
            some = place.some(chosen)
            known = None if view is None else view.depths[number]
            depths = self._depths(caster, lamp) if known is None else known
            return self._exact_shares(caster, pack_lamp(lamp), depths, some, surface, np.zeros(len(chosen)))[0][:, :2]

        if view is None or place.pixels is None:
            light *= exact(np.arange(len(place.faces)))
            return
        bodies = self._world.face_body[place.faces]
        shares = view.shares[number]
        kind = apply_shares(
            place.pixels, bodies, view.body.ravel(), view.knowledge.ravel(), shares.reshape(-1, 2), light
        )
        left = np.flatnonzero(kind)
        if not len(left):
            return
        kind, near = kind[left], np.ones((len(left), 2))
        other = np.flatnonzero(kind == 1)
        if len(other):
            # One value for the samples of a body in a pixel with about the same normal: that in their middle.
            chosen = left[other]
            keys = place.pixels[chosen] * len(self._world.bodies) + bodies[chosen]
            facing = np.rint(2 * place.normals[chosen]).astype(np.int64) + 2
            keys = keys * 125 + facing @ np.array([25, 5, 1])
            _, owner, count = np.unique(keys, return_inverse=True, return_counts=True)
            points = place.points_mm[chosen]
            middle = np.column_stack([np.bincount(owner, column) for column in points.T]) / count[:, None]
            apart_from_middle = np.sum((points - middle[owner]) ** 2, axis=1)
            leaders = chosen[np.lexsort((apart_from_middle, owner))[np.cumsum(count) - count]]
            near[other] = self._shares_near(view, number, place.some(leaders), surface)[owner]
        single = np.flatnonzero(kind == 2)
        near[single] = exact(left[single])
        light[left] *= near

    def _shares_near(self, view: _View, number: int, place: SeenPoints, surface: Surface) -> NDArray[np.float64]:
        """Return shares at points in pixels without knowledge: those of centres on the same surface, or exact."""
        packed, depths, shares = view.packed[number], view.depths[number], view.shares[number]
        assert depths is not None
        assert packed is not None
        assert place.pixels is not None
        bodies, distance = self._world.face_body[place.faces], np.linalg.norm(place.points_mm - place.origin_mm, axis=1)
        apart, row_major = _APART * view.pixel_angle, place.pixels
        found: NDArray[np.float64] = shares.reshape(-1, 2)[row_major]
        close = np.abs(view.distance_mm.ravel()[row_major] - distance) < apart * distance
        other = np.flatnonzero(~(view.centres.ravel()[row_major] & (view.body.ravel()[row_major] == bodies) & close))
        exact, _ = self._exact_shares(view.caster, packed, depths, place.some(other), surface, np.zeros(len(other)))
        found[other] = exact[:, :2]
        return found

    def _find_shares(self, view: _View, place: SeenPoints, surface: Surface, mixed: NDArray[np.bool_]) -> None:
        """Fill in the shares of the light that reach the pixels."""
        from scipy import ndimage

        label = ndimage.label(~mixed & (view.body >= 0))[0].astype(np.int32)
        number_of = np.full(mixed.size, -1, dtype=np.int64)
        number_of[place.pixels] = np.arange(len(place.faces))
        towards = view.origin_mm - place.points_mm
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.maximum(np.einsum("nk,nk->n", towards, place.normals) / distance, 0.1)
        size = _SPARE * view.pixel_angle * distance / cosine
        for number, packed in enumerate(view.packed):
            if packed is not None:
                self._refine(view, number, packed, place, surface, label, number_of, size)
        unknown = np.flatnonzero(mixed & (view.body >= 0))
        for number, packed in enumerate(view.packed):
            if packed is not None:
                near = self._shares_near(view, number, place.some(number_of[unknown]), surface)
                view.shares[number].reshape(-1, 2)[unknown] = near
        view.centres.ravel()[unknown] = True

    def _refine(
        self, view: _View, number: int, packed: NDArray[np.float64], place: SeenPoints, surface: Surface,
        label: NDArray[np.int32], number_of: NDArray[np.int64], size: NDArray[np.float64],
    ) -> None:  # fmt: skip
        """Fill in the shares of the light of one lamp, from coarse to fine."""
        from scenetruth.render.area_lamp_kernels import CERTAIN
        from scenetruth.render.lamp_lattice_kernels import (
            CLEAR,
            COARSEST,
            EXACT,
            LEVELS,
            STEEP,
            SURE,
            UNKNOWN,
            find_bends,
            predict_level,
        )

        values, depths, shape = view.shares[number], view.depths[number], label.shape
        assert depths is not None
        known, error = np.zeros(shape, dtype=np.uint8), np.full(shape, np.inf)
        first = np.zeros(shape, dtype=np.bool_)
        first[::COARSEST, ::COARSEST] = label[::COARSEST, ::COARSEST] > 0
        values[first] = np.nan
        computed = np.zeros(label.size, dtype=np.bool_)

        def compute(pixels: NDArray[np.int64], step: int) -> None:
            """Compute shares at pixels of a level, and their differences from interpolation."""
            chosen = number_of[pixels]
            # Up to the middle between pixels with values.
            near = 0.75 * step * size[chosen]
            found, state = self._exact_shares(view.caster, packed, depths, place.some(chosen), surface, near)
            predicted = values.reshape(-1, 2)[pixels]
            weights = np.minimum(found[:, 3] / np.maximum(found[:, 2], 1e-300), 1.0)
            differs = np.abs(found[:, 0] - predicted[:, 0]) + weights * np.abs(found[:, 1] - predicted[:, 1])
            error.ravel()[pixels] = np.where(np.isnan(differs), np.inf, differs)
            values.reshape(-1, 2)[pixels] = found[:, :2]
            known.ravel()[pixels] = np.where(state == CERTAIN, SURE, EXACT)
            computed[pixels] = True

        for step, diagonal in ((COARSEST, False), *LEVELS):
            wanted = first
            if step < COARSEST:
                wanted = predict_level(step, diagonal, label, known, values, error, _INTERPOLATED)
            compute(np.flatnonzero(wanted), step)
        # Interpolated values next to bends, and around those of them that differ from the computed values.
        pixels = np.flatnonzero(find_bends(label, known, values, _INTERPOLATED))
        while len(pixels := pixels[~computed[pixels]]):
            compute(pixels, 1)
            rows, columns = np.divmod(pixels[error.ravel()[pixels] > _INTERPOLATED], shape[1])
            around = [
                v * shape[1] + u
                for v in (np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, shape[0] - 1))
                for u in (np.maximum(columns - 1, 0), columns, np.minimum(columns + 1, shape[1] - 1))
            ]
            pixels = np.unique(np.concatenate(around))
            pixels = pixels[known.ravel()[pixels] == EXACT]
        apart = np.zeros(shape, dtype=np.bool_)
        for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            differ = (np.abs(values[one] - values[other]) > _STEEP).any(axis=-1)
            differ &= (label[one] == label[other]) & (label[one] > 0)
            apart[one] |= differ
            apart[other] |= differ
        own = np.where(known == SURE, CLEAR, EXACT)
        view.knowledge[:] = np.where(apart | (view.knowledge == STEEP), STEEP, np.minimum(view.knowledge, own))
        view.knowledge[known == UNKNOWN] = UNKNOWN

    def _depths(self, caster: RayCaster, lamp: Lamp) -> NDArray[np.float64]:
        """Return the optical depth of each face in the light of a lamp, shape (m,)."""
        from scenetruth.render.lamp_shadow_kernels import OPAQUE

        with np.errstate(divide="ignore"):
            return np.minimum(-np.log(self._transmitted(caster, lamp)), OPAQUE)

    def _exact_shares(
        self, caster: RayCaster, packed: NDArray[np.float64], depths: NDArray[np.float64], place: SeenPoints,
        surface: Surface, near: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:  # fmt: skip
        """Compute shares at points, see `area_lamp_kernels.lamp_shares`."""
        from scenetruth.raycast.surface_tree_kernels import build_tree
        from scenetruth.render.area_lamp_kernels import lamp_shares

        if self._tree is None or self._tree[0] is not caster:
            corners = caster.vertices_mm[caster.topology.faces]
            self._tree = (caster, build_tree(corners, caster.topology.face_neighbours, self._world.face_body))
        return lamp_shares(packed, self._tree[1], depths, place.view, (place.starts_mm, near), surface)


def _single_points(seen: Seen) -> Seen:
    """Return the corners of faces, shape (n, 3, 3), as single points; points remain."""
    origin, points, normals, faces = seen
    if points.ndim == 2:
        return seen
    return origin, points.reshape(-1, 3), np.repeat(normals, 3, axis=0), np.repeat(faces, 3)


def _sharp_light(lamp: Lamp, seen: Seen, surface: Surface) -> NDArray[np.float64]:
    """Return factor and gloss by a lamp without a size, without shadows; NaN on faces with the lamp in their plane."""
    from scenetruth.render.reflectance_kernels import reflect_light
    from scenetruth.render.shading_kernels import direct_light

    many = _single_points(seen)
    _, points, normals, _ = many
    if lamp.position_mm is None:
        to_light = np.tile(-lamp.axis, (len(points), 1))
    else:
        to_light = lamp.position_mm - points
        to_light /= np.linalg.norm(to_light, axis=1)[:, None]
    place = np.zeros(3) if lamp.position_mm is None else lamp.position_mm
    cone = (lamp.cos_inner, lamp.cos_outer)
    given = (place, lamp.axis, lamp.position_mm is None, lamp.irradiance, lamp.reference_distance_mm, *cone)
    # At normal incidence.
    light, _, to_light, _ = direct_light(points, to_light, *given)
    if lamp.beam is not None:
        light *= lamp.relative_intensity(to_light)
    factors, gloss = np.zeros((2, len(points)))
    reflect_light(light, to_light, many, surface, factors, gloss)
    found = np.stack([factors, gloss], axis=-1).reshape(*seen[1].shape[:-1], 2)
    if seen[1].ndim == 3:
        front = (np.einsum("nk,nk->n", normals, to_light) > 0).reshape(-1, 3)
        found[front.any(axis=1) != front.all(axis=1)] = np.nan
    return found


def largest_pixel_angle(directions: NDArray[np.float64], width: int) -> float:
    """Return the largest angle between neighbouring pixels of the middle row and column."""
    height = len(directions) // width
    grid = directions.reshape(height, width, 3)
    angles = [0.0]
    for line in (grid[height // 2], grid[:, width // 2]):
        unit = line / np.linalg.norm(line, axis=1, keepdims=True)
        angles.append(float(np.linalg.norm(np.diff(unit, axis=0), axis=1).max(initial=0.0)))
    return max(angles)
