"""The refined method, linear in what is wrong with the images: one least squares fit of all images in a window."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.functionals import functionals_of
from scenetruth.bound.geometry import views_of
from scenetruth.bound.model import FIELDS, Columns, Model, Motion, Surface, columns_of
from scenetruth.bound.noise import GreyNoise
from scenetruth.bound.pieces import inside_of, pieces_of
from scenetruth.bound.products import products_of, sensitivity
from scenetruth.bound.solving import normal_matrix
from scenetruth.bound.texture import gradient_along, layers_of
from scenetruth.bound.windows import parts_of, window_weights
from scenetruth.design.budget.propagation.base import Errors, along_and_down
from scenetruth.design.budget.sight import Disturbance, Sight
from scenetruth.estimators.refined.settings import RefinedSettings

__all__ = ["RefinedPropagation"]

Map = NDArray[np.float64]

_NAMES = {
    "disparity": "disparity",
    "depth": "depth",
    "velocity.0": "velocity_x",
    "velocity.1": "velocity_y",
    "velocity.2": "velocity_z",
    "growth_rate": "growth_rate",
}


class RefinedPropagation:
    """The refined method around the truth: the model is that of `cramer_rao`, with its plain motion.

    With a_i, what the fields of a pixel change in image i, and p_i = ∇T · δ_i - e_i, what is wrong there, the
    parameters of a window are off by H⁻¹ Σ w Φᵀ Σ_i (a_i - ā) p_i. Where images have gains of their own, what a gain
    and an offset explain of e in a window does nothing.

    Parameters
    ----------
    sight
        The scene; at least two cameras.
    settings
        Of the method.
    every_px
        Errors are computed in every n-th row and column.
    """

    name = "refined"

    def __init__(self, sight: Sight, settings: RefinedSettings, every_px: int = 3) -> None:
        self._sight, self._every_px = sight, every_px
        half = settings.window_frames // 2
        recording = sight.recording.isel(t=[n for n, t in enumerate(sight.t) if abs(t) <= half])
        self._frames = [int(t) for t in recording["t"].values]
        self._gains = settings.brightness == "per_image"
        surface: Surface = "constant" if settings.surface == "constant" else "plane"
        motion: Motion = "growing" if settings.motion == "auto" else settings.motion
        self._model = Model(surface, motion, moving=len(self._frames) > 1, brightness=0)
        self._weights = window_weights("gaussian", settings.window_sigma_px)
        points = sight.points
        pieces = pieces_of(sight.truth)
        usable = inside_of(pieces)
        views = views_of(recording, sight.intrinsics.baseline_mm)
        shown = np.zeros((len(views), *points.d.shape), dtype=np.bool_)
        for i in range(len(views)):
            place = points.place(views.s[i], 0.0, views.t[i])
            column, row = place.x - points.x[0, 0], place.y - points.y[0, 0]
            height, width = points.d.shape
            inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
            shown[i] = usable & inside
        scale = float(recording.attrs["full_scale"])
        shares = recording.assign(image=recording["image"] / scale, ideal=recording["image"] / scale)
        layers = layers_of(shares, views, points, shown, usable, GreyNoise(1.0))
        products = products_of(points, views, shown, layers, self._model)
        gradient = tuple(gradient_along(sight.texture, axis) for axis in (1, 0))
        self._pieces, self._shown, self._views = pieces, shown, views
        self._sensitivities: list[tuple[Map, list[Map]]] = []
        fields = FIELDS if self._model.moving else 1
        self._mean = np.zeros((fields, *points.d.shape))
        for i in range(len(views)):
            inverse, moves = sensitivity(points, views.s[i], views.s_y[i], views.t[i], shown[i])
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

    def _solvers(self, products: Map) -> list[tuple[tuple[NDArray[np.int64], NDArray[np.int64]], Map, Columns]]:
        """Return, piece by piece, pixels, the inverse of their normal equations, and what is unknown there."""
        found = []
        for part in parts_of(products, self._pieces, self._weights, self._model, self._every_px):
            at = part.rows, part.columns
            columns = columns_of(self._model, self._sight.points.at(at))
            normal = np.moveaxis(normal_matrix(part.sums, columns, self._model), -1, 0)
            scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-300))
            unit = normal / (scale[:, :, None] * scale[:, None, :])
            known = np.isfinite(unit).all(axis=(1, 2))
            unit[~known] = np.eye(unit.shape[1])
            known &= np.linalg.eigvalsh(unit)[:, 0] > _LEAST_EIGENVALUE
            unit[~known] = np.eye(unit.shape[1])
            inverse = np.linalg.inv(unit) / (scale[:, :, None] * scale[:, None, :])
            inverse[~known] = np.nan
            found.append((at, inverse, columns))
        return found

    def respond(self, disturbance: Disturbance) -> Errors:
        """Return the errors that a disturbance causes; see `Propagation`."""
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
        for at, inverse, columns in self._parts:
            points = sight.points.at(at)
            sums = self._moments(right, at)
            vector = np.zeros((len(at[0]), len(columns)))
            for j, column in enumerate(columns):
                for parameter, share in column:
                    vector[:, j] += share * sums[parameter]
            solved = np.einsum("nij,nj->ni", inverse, vector)
            for name, functional in functionals_of(points, sight.intrinsics, self._model).items():
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
        """Return what is known of the errors with ideal images: planes in plain motion leave none."""
        nothing = {name: np.zeros_like(self._sight.texture) for name in self._told()}
        return {"slope": nothing} if self._model.surface == "plane" else {}

    def _told(self) -> list[str]:
        moving = ["velocity_x", "velocity_y", "velocity_z"] if self._model.moving else []
        return ["disparity", "depth", *moving]

    def _moments(self, right: Map, at: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Mapping[int, Map]:
        """Return the sums over windows around pixels of one piece, by the parameter that they belong to."""
        number = self._pieces[at[0][0], at[1][0]]
        reach = self._weights.shape[1] // 2
        box = tuple(slice(max(int(k.min()) - reach, 0), int(k.max()) + reach + 1) for k in at)
        mask = self._pieces[box] == number
        place = at[0] - box[0].start, at[1] - box[1].start
        found = {}
        for parameter in range(self._model.parameters):
            i, j = self._model.powers_of(parameter)
            inside = np.where(mask, right[self._model.field_of(parameter)][box], 0.0)
            found[parameter] = along_and_down(inside, self._weights[i], self._weights[j])[place]
        return found

    def _unexplained(self, grey: Map) -> Map:
        """Return what a gain and an offset of a window's image leave of a change of its grey values."""
        if not self._gains:
            return grey
        one = self._weights[0] / self._weights[0].sum()
        texture = self._sight.texture
        mean_t, mean_g = along_and_down(texture, one, one), along_and_down(grey, one, one)
        spread = along_and_down(texture * texture, one, one) - mean_t**2
        both = along_and_down(texture * grey, one, one) - mean_t * mean_g
        gain = both / np.maximum(spread, 1e-12)
        return np.asarray(grey - mean_g - gain * (texture - mean_t))


_LEAST_EIGENVALUE = 1e-7
"""Of a matrix with ones on its diagonal: below, the images do not tell all that is unknown."""
