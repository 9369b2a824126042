"""Light of sampled surface points by the materials and lamps of a scene, and the errors caused by highlights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.surface_geometry import ImageTimes
from scenetruth.bound.unknowns import WindowUnknowns
from scenetruth.raycast import Hits, RayCaster, Topology
from scenetruth.render.area_lamps import SeenPoints
from scenetruth.render.reflection import Reflection
from scenetruth.resources import ObjectWorkload
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.material import MATT

__all__ = ["HighlightWindows", "SurfaceLight", "TextureStatistics"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SMOOTH_COS = np.cos(np.deg2rad(30.0))  # between faces of a coarse mesh that belong to one smooth surface
# Nodes along each side of a window: of the light, and of its products with the waves of the texture.
_NODES, _FINE = 9, 25
_CUT = 2.0  # reach of windows in standard deviations, as in the methods
_NYQUIST = 0.5  # in periods per step
_LEAST_CHANGE = 0.05  # standard deviations of the noise, below which a change of light is neglected
_POINTS_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class HighlightWindows:
    """Light in windows around n points: at nodes of the window, in i images.

    ``offsets_px``: Nodes along one axis. ``weights``: Of the nodes, 0 beyond the segment of the point, shape (n, y, x).
    ``factor``, ``gloss``: Radiance is texture x factor + gloss, shape (i, n, y, x).
    """

    chosen: NDArray[np.int64]
    offsets_px: Array
    weights: Array
    factor: Array
    gloss: Array

    def errors(self, count: int, shown: Mask, seen: TextureStatistics, change: Array, model: WindowUnknowns) -> Array:
        """Return mean products of what changes of light add to the normal equations of windows, in units of the noise.

        Returns: Products by pairs of parameters of a window, shape (parameters, parameters, ``count``).

        ``shown``: Images that show the points, shape (i, count). ``change``: Derivatives of the images by the fields
        of a point for unit gradients along x and y, less their mean, shape (2, fields, i, count).
        """
        found = np.zeros((model.parameters, model.parameters, count))
        with np.errstate(invalid="ignore", divide="ignore"):
            for first in range(0, len(self.chosen), _POINTS_AT_ONCE):
                own = slice(first, first + _POINTS_AT_ONCE)
                points = self.chosen[own]
                found[..., points] = self._errors(own, shown[:, points], seen.at(points), change[..., points], model)
        return np.nan_to_num(found)

    def _errors(self, own: slice, shown: Mask, seen: TextureStatistics, change: Array, model: WindowUnknowns) -> Array:
        step = self.offsets_px[1] - self.offsets_px[0]
        weights = self.weights[own]
        light = (seen.mean[:, None, None] * self.factor[:, own] + self.gloss[:, own]) * seen.gain[:, None, None]
        visible = shown[..., None, None]
        mean = (light * visible).sum(axis=0) / np.maximum(visible.sum(axis=0), 1)
        off = np.where(visible, light - mean, 0.0)
        # A gain and an offset of each image are unknown.
        total = weights.sum(axis=(1, 2))
        off = off - ((weights * off).sum(axis=(2, 3)) / total)[..., None, None]
        level = mean - ((weights * mean).sum(axis=(1, 2)) / total)[:, None, None]
        energy = (weights * level**2).sum(axis=(1, 2)) / total + seen.variance.sum(axis=1)
        share = (weights * level * off).sum(axis=(2, 3)) / total / np.maximum(energy, 1e-300)
        off = (off - share[..., None, None] * level) / seen.noise[:, None, None]
        if not np.abs(off * (weights > 0)).max() > _LEAST_CHANGE:
            return np.zeros((model.parameters, model.parameters, len(weights)))
        driven = np.einsum("kfin,inyx->nkfyx", change, off)
        slopes = np.stack(np.gradient(mean, step, axis=(2, 1)), axis=1) / seen.noise[:, None, None, None]
        at = self.offsets_px
        powers = [model.get_powers(p) for p in range(model.parameters)]
        fields = [model.get_field(p) for p in range(model.parameters)]
        grids = np.stack([at[None, :] ** across * at[:, None] ** down for across, down in powers])
        # The gradient of the light itself is that of a texture that does not move with the surface.
        pulled = np.einsum("nyx,nkyx,nkfyx->nfyx", weights, slopes, driven)[:, fields]
        vectors = step**2 * np.einsum("pyx,npyx->np", grids, pulled)
        squares = np.einsum("np,nq->pqn", vectors, vectors)
        return np.asarray(squares + self._of_texture(weights, driven[:, :, fields], powers, seen))

    def _of_texture(
        self, weights: Array, driven: Array, powers: Sequence[tuple[int, int]], seen: TextureStatistics
    ) -> Array:
        """Return the mean products for random textures: waves of the texture that the change of light resembles."""
        from scipy.interpolate import make_interp_spline

        fine = np.linspace(self.offsets_px[0], self.offsets_px[-1], _FINE)
        step = fine[1] - fine[0]
        spread = make_interp_spline(self.offsets_px, np.eye(_NODES), k=3)(fine)
        smooth = spread @ (weights[:, None, None] * driven) @ spread.T
        grids = np.stack([fine[None, :] ** across * fine[:, None] ** down for across, down in powers])
        smooth = (smooth * grids) * step**2
        ways = 2 * np.pi * seen.frequency
        along, down = (np.exp(1j * ways[..., k, None] * fine) for k in range(2))
        waves = smooth @ along.swapaxes(1, 2)[:, None, None]
        waves = np.einsum("nkpyw,nwy->nkpw", waves, down)
        amplitude = np.sqrt(seen.variance)[..., None] * seen.response / seen.noise[:, None, None]
        amplitude = amplitude * (np.abs(seen.frequency) * step < _NYQUIST).all(axis=-1)[..., None]
        found = np.einsum("nkpw,nwk->npw", waves, amplitude)
        return np.asarray(np.einsum("npw,nqw->pqn", found, found.conj()).real)


@dataclass(frozen=True, eq=False)
class TextureStatistics:
    """Texture of points in grey values: see `ImagedTexture`; ``mean`` of the texture, ``gain`` of grey by radiance."""

    mean: Array
    gain: Array
    noise: Array
    frequency: Array
    variance: Array
    response: Array

    def at(self, points: NDArray[np.int64]) -> TextureStatistics:
        """Return the statistics of some of the points."""
        return TextureStatistics(*(each[points] for each in vars(self).values()))


class SurfaceLight:
    """Light that coarse meshes of the objects reflect and transmit, without shadows, as in rendered images."""

    def __init__(self, scene: Scene, parts: Sequence[ObjectWorkload], folder: Path = Path()) -> None:
        known = [part for part in parts if part.sketch is not None]
        items = [
            part.item.model_copy(update={"material": MATT}) if part.item.material.from_file else part.item
            for part in known
        ]
        meshes = {part.item.name: part.sketch for part in known if part.sketch is not None}
        plain = scene.model_copy(update={"objects": tuple(items), "plants": ()})
        self._scene = scene
        self._world = build_scene(plain, folder, painted=False, meshes=meshes)
        self._reflection = Reflection(scene.lighting.model_copy(update={"shadows": False}), self._world)
        self._moments: dict[float, tuple[Array, Array]] = {}
        self._windows: dict[tuple[object, ...], HighlightWindows] = {}
        self.glossy = np.array([item.material.glossy for item in items])

    def at(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """Return factors and gloss of the points at positions from the principal point in the reference image.

        The radiance of a point is texture x factor + gloss, NaN beyond the surfaces.
        """
        hits, bright = self._hits(x_px, y_px), self._scene.lighting.brightness(0.0)
        factor, gloss = (np.where(hits.face >= 0, bright * each, np.nan) for each in self._light(hits, 0.0, 0.0, 0.0))
        return factor, gloss

    def windows(
        self, places: tuple[Array, Array], inside: Mask, body: NDArray[np.int64], views: ImageTimes, sigma_px: float
    ) -> HighlightWindows:
        """Return the light in windows around points of glossy surfaces, in all images.

        ``places``: x and y from the principal point. ``inside``: Whether the `nodes` of a window are on the segment
        of its point, shape (n, nodes). ``body``: Object of each point.
        """
        key = (sigma_px, *(each.tobytes() for each in (*places, views.s, views.s_y, views.t)))
        if key not in self._windows:
            chosen = np.flatnonzero(self.glossy[body])
            offsets = self.nodes(sigma_px)
            line = np.unique(offsets[:, 0])
            x, y = (each[chosen, None] + offsets[:, k] for k, each in enumerate(places))
            hits = self._hits(x.ravel(), y.ravel())
            hit = self._world.face_body[np.maximum(hits.face, 0)].reshape(x.shape)
            own = inside[chosen] & (hits.face.reshape(x.shape) >= 0) & (hit == body[chosen, None])
            weights = own * np.exp(-0.5 * (offsets**2).sum(axis=1) / sigma_px**2)
            light = [self._light(hits, *place) for place in zip(views.s, views.s_y, views.t, strict=True)]
            shape = (len(chosen), _NODES, _NODES)
            factor, gloss = (np.stack([each[k].reshape(shape) for each in light]) for k in range(2))
            self._windows = {key: HighlightWindows(chosen, line, weights.reshape(shape), factor, gloss)}
        return self._windows[key]

    @staticmethod
    def nodes(sigma_px: float) -> Array:
        """Return the offsets of the nodes of a window along x and y, shape (nodes, 2), x fastest."""
        line = np.linspace(-_CUT * sigma_px, _CUT * sigma_px, _NODES)
        across, down = np.meshgrid(line, line)
        return np.stack([across.ravel(), down.ravel()], axis=-1)

    def _hits(self, x_px: Array, y_px: Array) -> Hits:
        focal = self._scene.camera.focal_px
        directions = np.column_stack([x_px / focal, y_px / focal, np.ones_like(x_px)])
        return self._caster.cast(np.zeros(3), directions)

    def _light(self, hits: Hits, s: float, s_y: float, t: float) -> tuple[Array, Array]:
        """Return factors and gloss of surface points for the camera at a position and a time; 0 without a point."""
        corners, normals = self._moment(t)
        seen = np.flatnonzero(hits.face >= 0)
        face, weights = hits.face[seen], hits.weights[seen]
        share = np.column_stack([1.0 - weights.sum(axis=1), weights])
        points, normal = (np.einsum("nk,nkc->nc", share, each[face]) for each in (corners, normals))
        baseline = self._scene.stage.baseline_mm
        origin = np.array([s * baseline, s_y * baseline, 0.0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        normal *= np.where(((origin - points) * normal).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        factor, gloss = np.zeros((2, len(hits.face)))
        place = SeenPoints(origin, points, normal, face, points)
        found = self._reflection.light(self._caster, self._scene.lighting.lamps_at(t), place)
        factor[seen], gloss[seen] = found[:2]
        return factor, gloss

    def _moment(self, t: float) -> tuple[Array, Array]:
        """Return positions and smooth normals at the corners of faces, (m, 3, 3) each, at a time in frames."""
        if t not in self._moments:
            vertices = np.concatenate([body.positions_at(t) for body in self._world.bodies])
            self._moments[t] = vertices[self._world.faces], self._corner_normals(vertices)
        return self._moments[t]

    def _corner_normals(self, vertices_mm: Array) -> Array:
        """Return normals at the corners of faces, averaged over the faces of a smooth surface that meet there."""
        corners = vertices_mm[self._world.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        unit = normals / size
        one, other = self._meeting
        near = (unit[one // 3] * unit[other // 3]).sum(axis=1)
        # The orientation of faces is arbitrary.
        near = np.where(np.abs(near) > _SMOOTH_COS, np.sign(near), 0.0)
        found = np.zeros((3 * len(unit), 3))
        np.add.at(found, one, near[:, None] * normals[other // 3])
        return np.asarray(found.reshape(-1, 3, 3) / size[:, None])

    @cached_property
    def _meeting(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of face corners at one vertex, each with itself as well."""
        vertex = self._world.faces.ravel()
        order = np.argsort(vertex, kind="stable")
        starts = np.flatnonzero(np.r_[True, np.diff(vertex[order]) > 0])
        each = np.diff(np.r_[starts, len(vertex)])
        count, start = np.repeat(each, each), np.repeat(starts, each)
        one = np.repeat(order, count)
        within = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
        return one, order[np.repeat(start, count) + within]

    @cached_property
    def _caster(self) -> RayCaster:
        vertices = np.concatenate([body.positions_at(0.0) for body in self._world.bodies])
        return RayCaster(vertices, Topology.of(vertices, self._world.faces, self._world.crease_deg))
