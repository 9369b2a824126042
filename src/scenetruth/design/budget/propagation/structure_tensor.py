"""The structure tensor, linear in what is wrong with the images: regressions in a window, at each registration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.budget.propagation.base import Errors, along_and_down
from scenetruth.design.budget.sight import Disturbance, Sight
from scenetruth.estimators.structure_tensor.filters import PAPER, gaussian_window
from scenetruth.estimators.structure_tensor.rig import rig_of
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings

__all__ = ["TensorPropagation"]

Map = NDArray[np.float64]
Single = NDArray[np.float32]

_OFFSETS = (0, -1, 1, -2, 2)
"""What registrations differ in from the nearest whole disparity."""


class _Moments(NamedTuple):
    """A window's weights along one axis, times the powers 0 to 2 of the distance."""

    one: Map
    first: Map
    second: Map

    def mean(self, image: Map, power_x: int = 0, power_y: int = 0) -> Map:
        """Return the mean over windows around all pixels."""
        return along_and_down(image, self[power_x], self[power_y])


@dataclass(frozen=True, eq=False)
class _Registered:
    """Images at one registration, smoothed along s.

    Parameters
    ----------
    gradients
        Of the texture as each camera shows it, along x and y, shape (s, 2, y, x).
    along, down
        Their means with the weights of S.
    beside
        What the divergence term has besides its coordinates in the window: - w Σ S_s s ∂I_s/∂x at the whole disparity
        w. With some disparity left, motion in depth shows in its change too.
    inverse
        Of the normal matrix of shift along x and y, and divergence, shape (3, 3, y, x).
    """

    gradients: Single
    along: Map
    down: Map
    beside: Map
    inverse: Map


class TensorPropagation:
    """The structure tensor around its estimate of ideal images.

    Along s, its derivative filter D and smoothing filter S turn shifts δ of the images into a shift Σ D_s δ_s per step;
    along t the same, averaged over the window B_t. In the window over x and y, least squares of what a shift and a
    change of grey values e make of the texture, p = ∇T · δ - S e, give the errors of (v_x, v_y, v_z) over s and of flow
    and divergence over t. The divergence is that of the one of five whole disparities where its variance is least; what
    the nearest one leaves of the disparity itself, at most half a pixel, is left out for disparity and flow. That the
    tensor's are total least squares matters at second order only.

    Parameters
    ----------
    sight
        The scene.
    settings
        Of the method.
    """

    name = "structure_tensor"

    def __init__(self, sight: Sight, settings: StructureTensorSettings) -> None:
        self._sight = sight
        self._positions = np.array([sight.steps(s) for s in sight.s])
        rig = rig_of(self._positions, len(sight.t), settings)
        frames = [t for t in sight.t if -rig.before <= t < rig.frames - rig.before]
        over_t, window_t = rig.over_t, rig.window_t
        self._smoothing, derivative = rig.over_s.smoothing, rig.over_s.derivative
        by_s = np.outer(derivative, np.convolve(over_t.smoothing, window_t))
        by_t = np.outer(self._smoothing, np.convolve(over_t.derivative, window_t))
        self._images = [(m, s, t, by_s[m, n], by_t[m, n]) for m, s in enumerate(sight.s) for n, t in enumerate(frames)]
        self._sees = rig.sees_depth, rig.sees_motion
        window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
        at = np.arange(len(window), dtype=np.float64) - len(window) // 2
        self._window = _Moments(window, window * at, window * at**2)
        offsets = _OFFSETS if all(self._sees) else _OFFSETS[:1]
        # The first is exact; then those at whole disparities.
        self._registered = [self._at(None), *map(self._at, offsets)]
        self._offsets = (0, *offsets)
        variances = np.stack([one.inverse[2, 2] for one in self._registered[1:]])
        self._chosen = 1 + np.argmin(np.nan_to_num(variances, nan=1e300), axis=0)
        # Registrations that nothing is taken from are not asked.
        self._used = [k for k in range(len(self._registered)) if k == 0 or (self._chosen == k).any()]

    def respond(self, disturbance: Disturbance) -> Errors:
        """Return the errors that a disturbance causes; see `Propagation`."""
        shape = self._sight.texture.shape
        seen = np.zeros((len(self._registered), 2, *shape))
        greys = np.zeros_like(seen)
        for m, s, t, by_s, by_t in self._images:
            change = disturbance(s, t)
            if change is None:
                continue
            x, y, grey = change
            for axis, weight in enumerate((by_s, by_t)):
                for k in (self._used if axis else [0]) if weight else []:
                    if not _is_nothing(x) or not _is_nothing(y):
                        g_x, g_y = self._registered[k].gradients[m]
                        seen[k, axis] += weight * (g_x * x + g_y * y)
                    if not _is_nothing(grey):
                        # Grey values are read so far beside the points that they belong to.
                        beside = round(self._offsets[k] * self._positions[m])
                        greys[k, axis] += weight * np.roll(np.asarray(grey), beside, axis=-1)
        for k in self._used:
            for axis in (0, 1) if k == 0 else (1,):
                seen[k, axis] -= along_and_down(greys[k, axis], PAPER.smoothing, PAPER.smoothing)
        over_s = self._fitted(self._registered[0], seen[0, 0])
        over_t = [
            self._fitted(one, seen[k, 1]) if k in self._used else np.zeros((3, *shape))
            for k, one in enumerate(self._registered)
        ]
        # Images move by - d for a step along s.
        return self._errors(
            -over_s[0], over_t[0][0], over_t[0][1], self._of_chosen([one[2] for one in over_t], self._chosen)
        )

    def own(self) -> dict[str, Errors]:
        """Return what slopes of the surface, and what its curvature, leave where the images are ideal."""
        chosen = self._sure_of_ideal() if all(self._sees) else self._chosen
        both, tilted = self._left(chosen, tangent=False), self._left(chosen, tangent=True)
        return {"slope": tilted, "curvature": {name: both[name] - tilted[name] for name in both}}

    def _moving(self, one: _Registered) -> Map:
        """Return what the true motion looks like at a registration."""
        u, v = np.nan_to_num(self._sight.flow)
        points = self._sight.points
        # A camera to the right sees a point nearer to its own axis, from which all expands.
        return np.asarray(one.along * u + one.down * v - points.d * points.q[2] / points.focal * self._lever(one))

    def _sure_of_ideal(self) -> NDArray[np.int64]:
        """Return the registrations whose error bars of the divergence are least with ideal images."""
        bars = []
        for one in self._registered[1:]:
            seen = self._moving(one)
            fitted, right = self._fitted(one, seen), self._right(one, seen)
            residual = self._window.mean(seen * seen) - (fitted * right).sum(axis=0)
            bars.append(np.maximum(residual, 0.0) * one.inverse[2, 2])
        return np.asarray(1 + np.argmin(np.nan_to_num(np.stack(bars), nan=1e300), axis=0))

    def _left(self, which: NDArray[np.int64], *, tangent: bool) -> Errors:
        """Return the errors with ideal images; with the surface's tangent plane in the place of the surface."""
        sight, points = self._sight, self._sight.points
        divergence = -points.d * points.q[2] / points.focal
        found = []
        for one in self._registered:
            g_x, g_y, mean = one.along, one.down, self._window.mean
            if not tangent:
                u, v = np.nan_to_num(sight.flow)
                over_s, over_t = self._fitted(one, g_x * points.d), self._fitted(one, self._moving(one))
                found.append((over_s[0] - points.d, over_t - np.stack([u, v, divergence])))
                continue
            rights = np.zeros((2, 3, *g_x.shape))
            for power, slopes in (((1, 0), self._slopes(0)), ((0, 1), self._slopes(1))):
                for along, slope_s, slope_t in ((g_x, *slopes[0]), (g_y, *slopes[1])):
                    i, j = power
                    parts = np.stack(
                        [
                            mean(g_x * along, i, j),
                            mean(g_y * along, i, j),
                            mean(g_x * along, i + 1, j) + mean(g_y * along, i, j + 1) + mean(one.beside * along, i, j),
                        ]
                    )
                    rights[0] += slope_s * parts
                    rights[1] += slope_t * parts
            lever = self._lever(one)
            constant = np.stack([mean(g_x * lever), mean(g_y * lever), self._third(one, lever)])
            rights[1] += divergence * constant
            over_s, over_t = (np.einsum("ijyx,jyx->iyx", one.inverse, right) for right in rights)
            over_t[2] -= divergence
            found.append((over_s[0], over_t))
        chosen = self._of_chosen([over_t[2] for _, over_t in found], which)
        return self._errors(found[0][0], found[0][1][0], found[0][1][1], chosen)

    def _slopes(self, axis: int) -> list[tuple[Map, Map]]:
        """Return how disparity, and flow, change along x or y: of the shifts along x, then along y."""
        points = self._sight.points
        d_k, q_k = (points.d_x, points.q_x) if axis == 0 else (points.d_y, points.q_y)
        approach = points.d * points.q[2] / points.focal
        change = (d_k * points.q[2] + points.d * q_k[2]) / points.focal
        along_x = d_k * points.q[0] + points.d * q_k[0] - (axis == 0) * approach - points.x * change
        along_y = d_k * points.q[1] + points.d * q_k[1] - (axis == 1) * approach - points.y * change
        return [(d_k, along_x), (np.zeros_like(d_k), along_y)]

    def _lever(self, one: _Registered) -> Map:
        """Return what a divergence shows besides coordinates, where the surface is: - d Σ S_s s ∂I_s/∂x."""
        weights = self._smoothing * self._positions
        return np.asarray(-self._sight.points.d * np.einsum("s,syx->yx", weights, one.gradients[:, 0]))

    def _of_chosen(self, values: Sequence[Map], which: NDArray[np.int64]) -> Map:
        return np.asarray(np.take_along_axis(np.stack(values), which[None], axis=0)[0])

    def _third(self, one: _Registered, seen: Map) -> Map:
        mean = self._window.mean
        return np.asarray(mean(one.along * seen, 1) + mean(one.down * seen, 0, 1) + mean(one.beside * seen))

    def _fitted(self, one: _Registered, seen: Map) -> Map:
        """Return shifts along x and y, and divergence, that fit best to what is seen to move, shape (3, y, x)."""
        return np.asarray(np.einsum("ijyx,jyx->iyx", one.inverse, self._right(one, seen)))

    def _right(self, one: _Registered, seen: Map) -> Map:
        mean = self._window.mean
        return np.stack([mean(one.along * seen), mean(one.down * seen), self._third(one, seen)])

    def _at(self, offset: int | None) -> _Registered:
        """Return the images at the whole disparity that is so far from the nearest one, or at the exact one."""
        from scipy.ndimage import map_coordinates, spline_filter

        texture, points = self._sight.texture, self._sight.points
        whole = points.d if offset is None else np.rint(points.d) + offset
        rows, columns = np.mgrid[: texture.shape[0], : texture.shape[1]].astype(np.float64)
        filtered = [
            spline_filter(along_and_down(texture, *weights))
            for weights in ((PAPER.derivative, PAPER.smoothing), (PAPER.smoothing, PAPER.derivative))
        ]
        gradients = np.empty((len(self._positions), 2, *texture.shape), dtype=np.float32)
        for m, position in enumerate(self._positions):
            # A point at x stands at x - d s in the image that is read at x - w s.
            at = np.stack([rows, columns + (points.d - whole) * position])
            for axis in range(2):
                gradients[m, axis] = map_coordinates(filtered[axis], at, prefilter=False, mode="nearest")
        along, down = (np.einsum("s,syx->yx", self._smoothing, gradients[:, axis]) for axis in range(2))
        beside = -whole * np.einsum("s,syx->yx", self._smoothing * self._positions, gradients[:, 0])
        return _Registered(gradients, along, down, beside, self._inverted(along, down, beside))

    def _inverted(self, g_x: Map, g_y: Map, beside: Map) -> Map:
        mean = self._window.mean
        xx, xy, yy = g_x * g_x, g_x * g_y, g_y * g_y
        normal = np.empty((3, 3, *g_x.shape))
        normal[0, 0], normal[0, 1], normal[1, 1] = mean(xx), mean(xy), mean(yy)
        normal[0, 2] = mean(xx, 1) + mean(xy, 0, 1) + mean(g_x * beside)
        normal[1, 2] = mean(xy, 1) + mean(yy, 0, 1) + mean(g_y * beside)
        normal[2, 2] = mean(xx, 2) + 2 * mean(xy, 1, 1) + mean(yy, 0, 2)
        normal[2, 2] += 2 * (mean(g_x * beside, 1) + mean(g_y * beside, 0, 1)) + mean(beside * beside)
        for i in range(3):
            for j in range(i):
                normal[i, j] = normal[j, i]
        matrices = np.moveaxis(normal, (0, 1), (-2, -1))
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.sqrt(np.einsum("...ii->...i", matrices))
            unit = matrices / (scale[..., :, None] * scale[..., None, :])
            # Where there is no texture, nothing is known.
            known = np.isfinite(unit).all(axis=(-1, -2))
            unit[~known] = np.eye(3)
            known &= np.linalg.det(unit) > _LEAST_DETERMINANT
            unit[~known] = np.eye(3)
            inverse = np.linalg.inv(unit) / (scale[..., :, None] * scale[..., None, :])
        inverse[~known] = np.nan
        return np.moveaxis(inverse, (-2, -1), (0, 1))

    def _errors(self, off_d: Map, off_u: Map, off_v: Map, off_divergence: Map) -> Errors:
        """Return the errors of depth and velocity that follow from those in the image."""
        sight, points = self._sight, self._sight.points
        depth, focal = sight.depth, points.focal
        found: dict[str, Map] = {}
        if self._sees[0]:
            found["disparity"] = off_d
            found["depth"] = -depth * off_d / points.d
        if all(self._sees):
            u, v = sight.flow
            off_z = found["depth"]
            nearer = -depth * off_divergence + off_z * sight.velocity[2] / depth
            found["velocity_x"] = (depth * off_u + off_z * u + points.x * nearer) / focal
            found["velocity_y"] = (depth * off_v + off_z * v + points.y * nearer) / focal
            found["velocity_z"] = nearer
        return found


def _is_nothing(change: Map | float) -> bool:
    return isinstance(change, float) and change == 0.0


_LEAST_DETERMINANT = 1e-9
"""Of a matrix with ones on its diagonal: below, the aperture problem leaves something unknown."""
