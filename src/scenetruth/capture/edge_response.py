"""Exponent of the response of a camera from the edges of a board: blur is symmetric in linear light only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from scenetruth.capture.calibration.boards import Board, CharucoBoard, DotGrid
from scenetruth.capture.calibration.corner_detection import detect_board
from scenetruth.capture.calibration.corner_refinement import axes_of
from scenetruth.capture.calibration.start_values import fit_homography
from scenetruth.capture.radiometry import GammaFit

__all__ = ["fit_edge_exponent"]

Floats = NDArray[np.float64]

_MOST_EDGES, _FEWEST_EDGES = 80, 8  # of an image, and of all
_MOST_LOST = 2  # images without a board, after which no other is searched
_SAMPLES = 240  # pixels of an edge
_MOST_REACH, _LEAST_REACH = 7.0, 3.0  # px on either side of an edge
_ALONG = 0.2  # part of an edge at either end that corners affect
_ROUNDS, _SETTLED, _MOST_DAMPING = 60, 1e-7, 1e5
_MOST_BLUR = 0.4  # of the reach: the plateaus must be visible
_LEAST_CONTRAST = 0.1  # of full scale
_TOP = 0.99  # of full scale, above which an edge is saturated
_MOST_LOG_STD = 0.25
_RANGE = (0.25, 4.0)


@dataclass(frozen=True, eq=False)
class _Edges:
    """Pixels about edges.

    ``distances``: Distance of the pixels from their edge in px, positive on the bright side, shape (n, samples).
    ``values``: Share of full scale.
    ``used``: Which samples exist.
    ``groups``: Direction of the step of light in quarters of a turn, shape (n,); -1 for closed edges.
    """

    distances: Floats
    values: Floats
    used: NDArray[np.bool_]
    groups: NDArray[np.int64]


def fit_edge_exponent(images: Sequence[NDArray[np.generic]], board: Board, full_scale: float) -> GammaFit:
    """Return the exponent of digital number over light from the edges of a board in grey images.

    The profile of an edge is fitted by the power of a symmetric step, F ((b + (w - b) Φ(u / σ)))^γ, with its own place,
    blur and levels. The place absorbs ink that spreads; aberrations that blur one side are antisymmetric in the
    direction of the step, and cancel in the mean over directions. NaN without enough edges.
    """
    logs, groups, lost = list[Floats](), list[NDArray[np.int64]](), 0
    for image in images:
        values = np.asarray(image, dtype=np.float64)
        detection = detect_board(values, board)
        if detection.reason:
            lost += 1
            # The search for a board that is not there takes longest.
            if lost == _MOST_LOST and not logs:
                break
            continue
        edges = _edges_of(values / full_scale, board, detection.ids, detection.pixels)
        if edges is None:
            continue
        found, std = _fit_edges(edges)
        good = np.isfinite(found) & (std < _MOST_LOG_STD) & (np.abs(found) < np.log(_RANGE[1]))
        logs.append(found[good])
        groups.append(edges.groups[good])
    return _combined(np.concatenate(logs), np.concatenate(groups)) if logs else GammaFit(np.nan, np.nan)


def _combined(logs: Floats, groups: NDArray[np.int64]) -> GammaFit:
    """Return the mean over the directions of the medians of all edges."""
    if len(logs) < _FEWEST_EDGES:
        return GammaFit(np.nan, np.nan)
    medians, variances = [], []
    for group in np.unique(groups):
        part = logs[groups == group]
        if len(part) < 3:
            continue
        spread = 1.4826 * float(np.median(np.abs(part - np.median(part))))
        medians.append(float(np.median(part)))
        variances.append(1.57 * max(spread, 1e-3) ** 2 / len(part))
    if not medians:
        return GammaFit(np.nan, np.nan)
    # Opposite directions differ by aberrations, which are part of the uncertainty where a direction is missing.
    scatter = float(np.ptp(medians)) / 2 / len(medians)
    std = float(np.hypot(np.sqrt(np.sum(variances)) / len(medians), scatter))
    exponent = float(np.exp(np.mean(medians)))
    return GammaFit(exponent, exponent * std)


def _edges_of(values: Floats, board: Board, ids: NDArray[np.int64], pixels: Floats) -> _Edges | None:
    """Return the pixels about the edges of a detected board."""
    if len(ids) < 6:
        return None
    flat = board.points_mm[ids, :2]
    axes = axes_of(fit_homography(flat, pixels), flat)
    if isinstance(board, DotGrid):
        return _dot_edges(values, board, flat, pixels, axes)
    return _square_edges(values, board.square_mm, board.gap if isinstance(board, CharucoBoard) else 1.0, flat, pixels,
                         axes)  # fmt: skip


def _square_edges(
    values: Floats, square_mm: float, gap: float, flat: Floats, pixels: Floats, axes: Floats
) -> _Edges | None:
    """Return the pixels about the edges between neighbouring inner corners."""
    places = {tuple(place): n for n, place in enumerate(np.rint(2 * flat / square_mm).astype(int).tolist())}
    pairs = [
        (n, places[u + 2 * (axis == 0), v + 2 * (axis == 1)], axis)
        for (u, v), n in places.items()
        for axis in (0, 1)
        if (u + 2 * (axis == 0), v + 2 * (axis == 1)) in places
    ]
    chosen = pairs[:: max(len(pairs) // _MOST_EDGES, 1)]
    parts = []
    for one, other, axis in chosen:
        start, end = pixels[one], pixels[other]
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        normal = np.array([-along[1], along[0]])
        # Width of a square across the edge.
        across = abs(float(axes[one][:, 1 - axis] @ normal)) * square_mm
        reach = min(_MOST_REACH, 0.45 * across, 0.85 * gap * across if gap < 0.5 else np.inf)
        if reach < _LEAST_REACH or length < 2 * _LEAST_REACH:
            continue
        box = _box(np.stack([start, end]), reach + 1, values.shape)
        offset = np.stack(box, axis=-1) - start
        t, u = offset @ along / length, offset @ normal
        inside = (t > _ALONG) & (t < 1 - _ALONG) & (np.abs(u) < reach)
        parts.append((u[inside], values[box[1][inside], box[0][inside]], normal))
    return _stacked(parts)


def _dot_edges(values: Floats, board: DotGrid, flat: Floats, pixels: Floats, axes: Floats) -> _Edges | None:
    """Return the pixels about the edges of dots."""
    radius = board.diameter_mm / 2
    nearest = board.spacing_mm / (np.sqrt(2) if board.kind == "asymmetric_dots" else 1)
    beyond = (nearest / 2 - radius) / radius
    parts = []
    for n in range(0, len(flat), max(len(flat) // _MOST_EDGES, 1)):
        frame = axes[n] * radius
        size = float(np.linalg.norm(frame, axis=1).max())
        inverse = np.linalg.inv(frame)
        narrow = float(np.linalg.svd(frame, compute_uv=False)[-1])
        reach = min(_MOST_REACH, 0.8 * narrow, 0.9 * beyond * narrow)
        if reach < _LEAST_REACH - 1:
            continue
        box = _box(pixels[n][None], size + reach + 1, values.shape)
        places = (np.stack(box, axis=-1) - pixels[n]) @ inverse.T
        r = np.hypot(places[..., 0], places[..., 1])
        slope = np.linalg.norm(places @ inverse, axis=-1) / np.maximum(r, 1e-9)
        u = (r - 1) / np.maximum(slope, 1e-9)
        inside = (np.abs(u) < reach) & (r > 0.1)
        parts.append((u[inside], values[box[1][inside], box[0][inside]], None))
    return _stacked(parts)


def _box(points: Floats, border: float, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return columns and rows of the pixels about points."""
    low = np.clip(np.floor(points.min(axis=0) - border), 0, [shape[1] - 1, shape[0] - 1]).astype(int)
    high = np.clip(np.ceil(points.max(axis=0) + border), 0, [shape[1] - 1, shape[0] - 1]).astype(int)
    rows, columns = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    return columns, rows


def _stacked(parts: Sequence[tuple[Floats, Floats, Floats | None]]) -> _Edges | None:
    """Return edges whose step is clear and not saturated, with the bright side at positive distances."""
    kept = []
    for distances, values, normal in parts:
        order = np.arange(len(values))[:: max(-(-len(values) // _SAMPLES), 1)]
        u, y = distances[order], values[order]
        bright, dark = y[u > 1], y[u < -1]
        if min(len(bright), len(dark)) < 10 or values.max() > _TOP:
            continue
        step = float(np.median(bright) - np.median(dark))
        if abs(step) < _LEAST_CONTRAST:
            continue
        sign = 1.0 if step > 0 else -1.0
        group = -1 if normal is None else int(np.rint(np.arctan2(*(sign * normal)[::-1]) / (np.pi / 2))) % 4
        kept.append((sign * u, y, group))
    if not kept:
        return None
    size = max(len(u) for u, _, _ in kept)
    distances, values = np.zeros((len(kept), size)), np.zeros((len(kept), size))
    used = np.zeros((len(kept), size), dtype=bool)
    for n, (u, y, _) in enumerate(kept):
        distances[n, : len(u)], values[n, : len(u)], used[n, : len(u)] = u, y, True
    return _Edges(distances, values, used, np.array([group for _, _, group in kept]))


def _fit_edges(edges: _Edges) -> tuple[Floats, Floats]:
    """Return the logarithm of the exponent of every edge, and its standard deviation: Levenberg-Marquardt."""
    u, y, used = edges.distances, edges.values, edges.used
    count = len(u)
    high = np.array([np.median(y[n][used[n] & (u[n] > 1.5)]) for n in range(count)])
    low = np.array([np.median(y[n][used[n] & (u[n] < -1.5)]) for n in range(count)])
    # Logarithms of the levels of encoded values, place, logarithms of blur and exponent.
    state = np.stack([np.log(np.maximum(low, 1e-3)), np.log(high), np.zeros(count), np.full(count, np.log(0.8)),
                      np.zeros(count)], axis=1)  # fmt: skip

    def model(p: Floats) -> Floats:
        gamma = np.exp(p[:, 4:5])
        dark, bright = np.exp(p[:, 0:1] / gamma), np.exp(p[:, 1:2] / gamma)
        light = dark + (bright - dark) * ndtr((u - p[:, 2:3]) / np.exp(p[:, 3:4]))
        return np.asarray(np.maximum(light, 1e-12) ** gamma)

    limits = (np.array([-9.0, -5.0, -4.0, -2.5, -1.8]), np.array([0.0, 0.3, 4.0, 2.0, 1.8]))
    damping = np.full(count, 1e-3)
    residual = np.where(used, y - model(state), 0.0)
    cost = (residual**2).sum(axis=1)
    normal = np.tile(np.eye(5), (count, 1, 1))
    for _ in range(_ROUNDS):
        slopes = np.empty((*u.shape, 5))
        for k in range(5):
            step = np.zeros(5)
            step[k] = 1e-5
            slopes[..., k] = np.where(used, (model(state + step) - model(state - step)) / 2e-5, 0.0)
        normal = np.einsum("nsi,nsj->nij", slopes, slopes)
        gradient = np.einsum("nsi,ns->ni", slopes, residual)
        diagonal = np.einsum("nii->ni", normal)
        damped = normal + (damping[:, None] * diagonal + 1e-12)[:, :, None] * np.eye(5)
        move = np.linalg.solve(damped, gradient[..., None])[..., 0]
        candidate = np.clip(state + np.clip(move, -0.5, 0.5), *limits)
        left = np.where(used, y - model(candidate), 0.0)
        new = (left**2).sum(axis=1)
        better = new <= cost
        state = np.where(better[:, None], candidate, state)
        residual = np.where(better[:, None], left, residual)
        settled = np.where(better, cost - new <= _SETTLED * cost, damping > _MOST_DAMPING)
        cost = np.minimum(new, cost)
        damping = np.clip(np.where(better, 0.3 * damping, 10 * damping), 1e-9, 10 * _MOST_DAMPING)
        if settled.all():
            break
    dof = np.maximum(used.sum(axis=1) - 5, 1)
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-300))
    inverse = np.linalg.pinv(normal / scale[:, :, None] / scale[:, None, :], rcond=1e-10, hermitian=True)
    std = np.sqrt(np.maximum(inverse[:, 4, 4], 0) * cost / dof) / scale[:, 4]
    reach = np.abs(np.where(used, u, 0)).max(axis=1)
    seen = np.exp(state[:, 3]) < _MOST_BLUR * reach
    inner = np.abs(state[:, 4]) < 0.99 * limits[1][4]
    return np.where(seen & inner, state[:, 4], np.nan), np.where(seen & inner, std, np.inf)
