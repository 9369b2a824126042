"""Linear propagation of image disturbances to errors of an estimate, for each modelled method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.fisher_information import (
    GROWTH_BIAS,
    WindowSums,
    compute_pixel_information,
    compute_sensitivity,
    compute_window_deviations,
    compute_window_sums,
    normal_matrix,
    window_weights,
)
from scenetruth.bound.image_gradients import GreyNoise, compute_signed_textures, gradient_along
from scenetruth.bound.motion_selection import MapNeighbourhood, select_affine
from scenetruth.bound.surface_geometry import compute_image_times, compute_interior_mask, label_surface_segments
from scenetruth.bound.unknowns import (
    FIELDS,
    Columns,
    Motion,
    Surface,
    WindowUnknowns,
    compute_columns,
    compute_functionals,
)
from scenetruth.design.prediction.camera_response import compute_grey_levels
from scenetruth.design.uncertainty.observation_model import Disturbance, ObservationModel
from scenetruth.estimators.method_settings import RefinedSettings, StructureTensorSettings
from scenetruth.estimators.structure_tensor.filters import PAPER, choose_acquisition_axes, gaussian_window
from scenetruth.validated_model import FrozenModel

__all__ = ["MODELLED", "Errors", "Propagation", "RefinedPropagation", "TensorPropagation", "select_propagation"]


Map = NDArray[np.float64]
Errors = Mapping[str, Map]
"""Errors by quantity: ``disparity``, ``depth``, ``velocity_x``, ``velocity_y``, ``velocity_z`` and optionally
``growth_rate`` (per frame), each of shape (y, x); NaN where invalid."""


class Propagation(Protocol):
    """Linear model of an estimation method, for small image disturbances."""

    name: str
    """Name of the method."""

    def respond(self, disturbance: Disturbance) -> Errors:
        """Return the errors caused by a disturbance."""
        ...

    def own(self) -> dict[str, Errors]:
        """Return the modelled errors with ideal images, by the property of the surface that causes them."""
        ...


def sum_over_windows(image: Map, weights_x: Map, weights_y: Map) -> Map:
    """Return the sums of a map over windows with separable weights along x and y."""
    from scipy.ndimage import correlate1d

    return np.asarray(
        correlate1d(correlate1d(image, weights_x, axis=1, mode="constant"), weights_y, axis=0, mode="constant")
    )


_NAMES = {
    "disparity": "disparity",
    "depth": "depth",
    "velocity.0": "velocity_x",
    "velocity.1": "velocity_y",
    "velocity.2": "velocity_z",
    "growth_rate": "growth_rate",
}


class _Solver(NamedTuple):
    """Normal equations of windows with the same unknowns."""

    at: tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and columns
    inverse: Map  # inverse of their matrices, shape (n, unknowns, unknowns)
    columns: Columns
    model: WindowUnknowns


class RefinedPropagation:
    """The refined method, linearised at the ground truth, with the model of `cramer_rao_bound`.

    With the derivatives a_i of image i by the fields of a pixel, and the disturbance p_i = ∇T · δ_i - e_i, the error of
    the parameters of a window is H⁻¹ Σ w Φᵀ Σ_i (a_i - ā) p_i. With a gain per image, the part of e that a gain and an
    offset explain in a window has no effect. Errors are computed in every ``step_px``-th row and column. With
    ``motion: auto``, they are those of the model that is selected for the noise of the sensor.
    """

    name = "refined"

    def __init__(self, sight: ObservationModel, settings: RefinedSettings, step_px: int = 3) -> None:
        self._sight, self._every_px = sight, step_px
        half = settings.window_frames // 2
        recording = sight.recording.isel(t=[n for n, t in enumerate(sight.t) if abs(t) <= half])
        self._frames = [int(t) for t in recording["t"].values]
        self._gains = settings.photometric_model == "per_image"
        surface: Surface = "constant" if settings.surface == "constant" else "plane"
        motion: Motion = "growing" if settings.motion == "auto" else settings.motion
        self._model = WindowUnknowns(surface, motion, moving=len(self._frames) > 1, brightness=0)
        self._selects = settings.motion == "auto" and surface == "plane" and self._model.moving
        self._sigma_px = settings.window_sigma_px
        self._weights = window_weights("gaussian", settings.window_sigma_px)
        points = sight.points
        pieces = label_surface_segments(sight.truth)
        usable = compute_interior_mask(pieces)
        views = compute_image_times(recording, sight.intrinsics.baseline_mm)
        shown = np.zeros((len(views), *points.d.shape), dtype=np.bool_)
        for i in range(len(views)):
            place = points.place(views.s[i], 0.0, views.t[i])
            column, row = place.x - points.x[0, 0], place.y - points.y[0, 0]
            height, width = points.d.shape
            inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
            shown[i] = usable & inside
        scale = float(recording.attrs["full_scale"])
        shares = recording.assign(image=recording["image"] / scale, radiance=recording["image"] / scale)
        layers = compute_signed_textures(shares, views, points, shown, usable, GreyNoise(1.0))
        products = compute_pixel_information(points, views, shown, layers, self._model)
        gradient = tuple(gradient_along(sight.texture, axis) for axis in (1, 0))
        self._pieces, self._shown, self._views = pieces, shown, views
        self._sensitivities: list[tuple[Map, list[Map]]] = []
        fields = FIELDS if self._model.moving else 1
        self._mean = np.zeros((fields, *points.d.shape))
        for i in range(len(views)):
            inverse, moves = compute_sensitivity(points, views.s[i], views.s_y[i], views.t[i], shown[i])
            along = inverse[0] * gradient[0] + inverse[1] * gradient[1]
            down = inverse[2] * gradient[0] + inverse[3] * gradient[1]
            own = [along * moves[0] + down * moves[1]]
            if self._model.moving:
                own += [along * moves[2], down * moves[2], along * moves[3] + down * moves[4]]
            self._mean += np.stack(own)
            self._sensitivities.append(
                (np.stack([along, down]).astype(np.float32), [m.astype(np.float32) for m in own])
            )
        self._count = np.maximum(shown.sum(axis=0), 1)
        self._mean /= self._count
        self._parts = list(self._solvers(products))

    def _solvers(self, products: Map) -> Iterator[_Solver]:
        """Yield the normal equations by surface segment and motion model."""
        sums = list(compute_window_sums(products, self._pieces, self._weights, self._model, self._every_px))
        affine = replace(self._model, motion="affine")
        selected = self._select_affine(sums, affine) if self._selects else np.zeros(self._pieces.shape, dtype=np.bool_)
        for part in sums:
            own = selected[part.rows, part.columns]
            for model, mask in ((self._model, ~own), (affine, own)):
                if mask.any():
                    yield self._solver(part, model, mask)

    def _solver(self, part: WindowSums, model: WindowUnknowns, mask: NDArray[np.bool_]) -> _Solver:
        """Return the normal equations of some windows."""
        at = part.rows[mask], part.columns[mask]
        columns = compute_columns(model, self._sight.points.at(at))
        sums = {key: values[mask] for key, values in part.sums.items()}
        normal = np.moveaxis(normal_matrix(sums, columns, model), -1, 0)
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-300))
        unit = normal / (scale[:, :, None] * scale[:, None, :])
        known = np.isfinite(unit).all(axis=(1, 2))
        unit[~known] = np.eye(unit.shape[1])
        known &= np.linalg.eigvalsh(unit)[:, 0] > _LEAST_EIGENVALUE
        unit[~known] = np.eye(unit.shape[1])
        inverse = np.linalg.inv(unit) / (scale[:, :, None] * scale[:, None, :])
        inverse[~known] = np.nan
        return _Solver(at, inverse, columns, model)

    def _select_affine(self, sums: Sequence[WindowSums], affine: WindowUnknowns) -> NDArray[np.bool_]:
        """Return where growth is anisotropic beyond the noise of the sensor, at the computed rows and columns."""
        sight = self._sight
        texture = sight.texture[self._pieces >= 0]
        noise_std = float(np.median(compute_grey_levels(sight.scene.sensor, texture).noise)) if texture.size else 0.0
        noise_std = max(noise_std, _LEAST_NOISE)
        maps = np.full((3, *self._pieces.shape), np.nan)
        for part in sums:
            at = part.rows, part.columns
            normal, scatter = (
                {key: values / noise_std**2 for key, values in each.items()} for each in (part.sums, part.squares)
            )
            isotropic, general = (
                compute_window_deviations(
                    normal, scatter, sight.points.at(at), sight.intrinsics, model, biased=model is self._model
                )
                for model in (self._model, affine)
            )
            maps[(slice(None), *at)] = isotropic[GROWTH_BIAS], isotropic["growth_rate"], general["growth_rate"]
        step = self._every_px
        around = MapNeighbourhood(self._pieces[::step, ::step], self._sigma_px / step)
        found = np.zeros(self._pieces.shape, dtype=np.bool_)
        bias, *std_maps = maps[:, ::step, ::step]
        found[::step, ::step] = select_affine(bias, std_maps[0], std_maps[1], around)
        return found

    def respond(self, disturbance: Disturbance) -> Errors:
        """Return the errors caused by a disturbance; see `Propagation`."""
        sight = self._sight
        right = np.zeros_like(self._mean)
        total = np.zeros_like(sight.texture)
        for i in range(len(self._views)):
            _, m, n = self._views.frame_of[i]
            change = disturbance(sight.s[m], self._frames[n])
            if change is None:
                continue
            (along, down), own = self._sensitivities[i]
            grey = self._unexplained(np.asarray(change.grey)) if np.ndim(change.grey) else 0.0
            seen = (along * change.x + down * change.y - grey) * self._shown[i]
            total += seen
            for k, one in enumerate(own):
                right[k] += one * seen
        right -= self._mean * total
        shape = sight.texture.shape
        found: dict[str, Map] = {}
        for at, inverse, columns, model in self._parts:
            points = sight.points.at(at)
            sums = self._moments(right, at)
            vector = np.zeros((len(at[0]), len(columns)))
            for j, column in enumerate(columns):
                for parameter, share in column:
                    vector[:, j] += share * sums[parameter]
            solved = np.einsum("nij,nj->ni", inverse, vector)
            for name, functional in compute_functionals(points, sight.intrinsics, model).items():
                if name not in _NAMES:
                    continue
                shares, value = dict(functional), np.zeros(len(at[0]))
                for j, column in enumerate(columns):
                    for parameter, share in column:
                        if parameter in shares:
                            value += solved[:, j] * share * shares[parameter]
                found.setdefault(_NAMES[name], np.full(shape, np.nan))[at] = value
        return found

    def own(self) -> dict[str, Errors]:
        """Return the modelled errors with ideal images: zero for planes with a modelled motion."""
        nothing = {name: np.zeros_like(self._sight.texture) for name in self._list_quantities()}
        return {"slope": nothing} if self._model.surface == "plane" else {}

    def _list_quantities(self) -> list[str]:
        moving = ["velocity_x", "velocity_y", "velocity_z"] if self._model.moving else []
        return ["disparity", "depth", *moving]

    def _moments(self, right: Map, at: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Mapping[int, Map]:
        """Return the sums over windows around pixels of one segment, by parameter."""
        number = self._pieces[at[0][0], at[1][0]]
        reach = self._weights.shape[1] // 2
        box = tuple(slice(max(int(k.min()) - reach, 0), int(k.max()) + reach + 1) for k in at)
        mask = self._pieces[box] == number
        place = at[0] - box[0].start, at[1] - box[1].start
        found = {}
        for parameter in range(self._model.parameters):
            i, j = self._model.get_powers(parameter)
            inside = np.where(mask, right[self._model.get_field(parameter)][box], 0.0)
            found[parameter] = sum_over_windows(inside, self._weights[i], self._weights[j])[place]
        return found

    def _unexplained(self, grey: Map) -> Map:
        """Return the part of a change of grey values that a gain and an offset per window do not explain."""
        if not self._gains:
            return grey
        one = self._weights[0] / self._weights[0].sum()
        texture = self._sight.texture
        mean_t, mean_g = sum_over_windows(texture, one, one), sum_over_windows(grey, one, one)
        spread = sum_over_windows(texture * texture, one, one) - mean_t**2
        both = sum_over_windows(texture * grey, one, one) - mean_t * mean_g
        gain = both / np.maximum(spread, 1e-12)
        return np.asarray(grey - mean_g - gain * (texture - mean_t))


_LEAST_NOISE = 1e-4  # noise relative to full scale below which interpolation errors exceed those of noise
_LEAST_EIGENVALUE = 1e-7
"""Least eigenvalue of a matrix with unit diagonal: below, the images do not determine all unknowns."""


Single = NDArray[np.float32]

_OFFSETS = (0, -1, 1, -2, 2)  # tried registrations, relative to the nearest integer disparity


class _Moments(NamedTuple):
    """Weights of a window along one axis, times the powers 0 to 2 of the distance."""

    one: Map
    first: Map
    second: Map

    def mean(self, image: Map, power_x: int = 0, power_y: int = 0) -> Map:
        """Return the mean over windows around all pixels."""
        return sum_over_windows(image, self[power_x], self[power_y])


@dataclass(frozen=True, eq=False)
class _Registered:
    """Images at one registration, smoothed along s.

    ``beside``: Additional coefficient of the divergence: - w Σ S_s s ∂I_s/∂x at the integer disparity w, since with a
      residual disparity, motion in depth also appears in its change.
    """

    gradients: Single  # of the texture by camera along x and y, shape (s, 2, y, x)
    along: Map  # mean gradient with the weights of S, as ``down``
    down: Map
    beside: Map
    inverse: Map  # inverse normal matrix of shift along x and y, and divergence, shape (3, 3, y, x)


class TensorPropagation:
    """The structure tensor, linearised at its estimate of ideal images.

    Along s, its derivative filter D and smoothing filter S convert image shifts δ to a shift Σ D_s δ_s per step; along
    t the same, averaged over the window B_t. In the window over x and y, a least-squares fit to p = ∇T · δ - S e gives
    the errors of (v_x, v_y, v_z) over s, and of flow and divergence over t. The divergence is taken from the one of
    five integer disparities with its lowest variance; for disparity and flow, the residual disparity of at most half a
    pixel is neglected. The difference between total least squares and least squares is of second order.
    """

    name = "structure_tensor"

    def __init__(self, sight: ObservationModel, settings: StructureTensorSettings) -> None:
        self._sight = sight
        self._positions = np.array([sight.steps(s) for s in sight.s])
        rig = choose_acquisition_axes(self._positions, len(sight.t), settings)
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
        # The first is exact; the others are at integer disparities.
        self._registered = [self._at(None), *map(self._at, offsets)]
        self._offsets = (0, *offsets)
        variances = np.stack([one.inverse[2, 2] for one in self._registered[1:]])
        self._chosen = 1 + np.argmin(np.nan_to_num(variances, nan=1e300), axis=0)
        # Unused registrations are not evaluated.
        self._used = [k for k in range(len(self._registered)) if k == 0 or (self._chosen == k).any()]

    def respond(self, disturbance: Disturbance) -> Errors:
        """Return the errors caused by a disturbance; see `Propagation`."""
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
                    if not _is_zero(x) or not _is_zero(y):
                        g_x, g_y = self._registered[k].gradients[m]
                        seen[k, axis] += weight * (g_x * x + g_y * y)
                    if not _is_zero(grey):
                        # Grey values are read at this distance from their points.
                        beside = round(self._offsets[k] * self._positions[m])
                        greys[k, axis] += weight * np.roll(np.asarray(grey), beside, axis=-1)
        for k in self._used:
            for axis in (0, 1) if k == 0 else (1,):
                seen[k, axis] -= sum_over_windows(greys[k, axis], PAPER.smoothing, PAPER.smoothing)
        over_s = self._fitted(self._registered[0], seen[0, 0])
        over_t = [
            self._fitted(one, seen[k, 1]) if k in self._used else np.zeros((3, *shape))
            for k, one in enumerate(self._registered)
        ]
        # Images move by -d for a step along s.
        return self._errors(
            -over_s[0], over_t[0][0], over_t[0][1], self._of_chosen([one[2] for one in over_t], self._chosen)
        )

    def own(self) -> dict[str, Errors]:
        """Return the errors with ideal images by slope and by curvature of the surface."""
        chosen = self._sure_of_ideal() if all(self._sees) else self._chosen
        both, tilted = self._left(chosen, tangent=False), self._left(chosen, tangent=True)
        return {"slope": tilted, "curvature": {name: both[name] - tilted[name] for name in both}}

    def _moving(self, one: _Registered) -> Map:
        """Return the apparent motion at a registration."""
        u, v = np.nan_to_num(self._sight.flow)
        points = self._sight.points
        # With a camera to the right, a point appears closer to the camera's axis, the centre of expansion.
        return np.asarray(one.along * u + one.down * v - points.d * points.q[2] / points.focal * self._lever(one))

    def _sure_of_ideal(self) -> NDArray[np.int64]:
        """Return the registrations with the lowest stated uncertainty of the divergence for ideal images."""
        bars = []
        for one in self._registered[1:]:
            seen = self._moving(one)
            fitted, right = self._fitted(one, seen), self._right(one, seen)
            residual = self._window.mean(seen * seen) - (fitted * right).sum(axis=0)
            bars.append(np.maximum(residual, 0.0) * one.inverse[2, 2])
        return np.asarray(1 + np.argmin(np.nan_to_num(np.stack(bars), nan=1e300), axis=0))

    def _left(self, which: NDArray[np.int64], *, tangent: bool) -> Errors:
        """Return the errors with ideal images, for the surface or its tangent plane."""
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
        """Return the derivatives of disparity and flow along x or y: of the shifts along x, then along y."""
        points = self._sight.points
        d_k, q_k = (points.d_x, points.q_x) if axis == 0 else (points.d_y, points.q_y)
        approach = points.d * points.q[2] / points.focal
        change = (d_k * points.q[2] + points.d * q_k[2]) / points.focal
        along_x = d_k * points.q[0] + points.d * q_k[0] - (axis == 0) * approach - points.x * change
        along_y = d_k * points.q[1] + points.d * q_k[1] - (axis == 1) * approach - points.y * change
        return [(d_k, along_x), (np.zeros_like(d_k), along_y)]

    def _lever(self, one: _Registered) -> Map:
        """Return the additional coefficient of the divergence at the surface: - d Σ S_s s ∂I_s/∂x."""
        weights = self._smoothing * self._positions
        return np.asarray(-self._sight.points.d * np.einsum("s,syx->yx", weights, one.gradients[:, 0]))

    def _of_chosen(self, values: Sequence[Map], which: NDArray[np.int64]) -> Map:
        return np.asarray(np.take_along_axis(np.stack(values), which[None], axis=0)[0])

    def _third(self, one: _Registered, seen: Map) -> Map:
        mean = self._window.mean
        return np.asarray(mean(one.along * seen, 1) + mean(one.down * seen, 0, 1) + mean(one.beside * seen))

    def _fitted(self, one: _Registered, seen: Map) -> Map:
        """Return the best-fitting shifts along x and y, and divergence, shape (3, y, x)."""
        return np.asarray(np.einsum("ijyx,jyx->iyx", one.inverse, self._right(one, seen)))

    def _right(self, one: _Registered, seen: Map) -> Map:
        mean = self._window.mean
        return np.stack([mean(one.along * seen), mean(one.down * seen), self._third(one, seen)])

    def _at(self, offset: int | None) -> _Registered:
        """Return the images registered at an offset from the nearest integer disparity, or at the exact disparity."""
        from scipy.ndimage import map_coordinates, spline_filter

        texture, points = self._sight.texture, self._sight.points
        whole = points.d if offset is None else np.rint(points.d) + offset
        rows, columns = np.mgrid[: texture.shape[0], : texture.shape[1]].astype(np.float64)
        filtered = [
            spline_filter(sum_over_windows(texture, *weights))
            for weights in ((PAPER.derivative, PAPER.smoothing), (PAPER.smoothing, PAPER.derivative))
        ]
        gradients = np.empty((len(self._positions), 2, *texture.shape), dtype=np.float32)
        for m, position in enumerate(self._positions):
            # A point at x appears at x - d s in the image that is read at x - w s.
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
            # Without texture, all unknowns are undetermined.
            known = np.isfinite(unit).all(axis=(-1, -2))
            unit[~known] = np.eye(3)
            known &= np.linalg.det(unit) > _LEAST_DETERMINANT
            unit[~known] = np.eye(3)
            inverse = np.linalg.inv(unit) / (scale[..., :, None] * scale[..., None, :])
        inverse[~known] = np.nan
        return np.moveaxis(inverse, (-2, -1), (0, 1))

    def _errors(self, off_d: Map, off_u: Map, off_v: Map, off_divergence: Map) -> Errors:
        """Return the errors of depth and velocity from those of image coordinates."""
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


def _is_zero(change: Map | float) -> bool:
    return isinstance(change, float) and change == 0.0


_LEAST_DETERMINANT = 1e-9
"""Least determinant of a matrix with unit diagonal: below, the aperture problem leaves unknowns undetermined."""


MODELLED = ("structure_tensor", "refined")
"""Methods with a propagation model; for other methods, all sources are simulated."""


def select_propagation(sight: ObservationModel, settings: FrozenModel) -> Propagation | None:
    """Return the propagation model of a method by its settings; None without a model."""
    if isinstance(settings, StructureTensorSettings):
        return TensorPropagation(sight, settings)
    if isinstance(settings, RefinedSettings) and len(sight.s) > 1:
        return RefinedPropagation(sight, settings)
    return None
