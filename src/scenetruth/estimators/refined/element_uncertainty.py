"""Uncertainty of slopes, curvatures, rotation and growth due to poses of the images and calibration of the lens.

Errors of poses move disparity and velocity by amounts that vary over the image: their values, slopes and second
derivatives at a pixel are errors of the parameters of its window, from which those of the surface element follow to
first order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter1d

from scenetruth.estimators.refined.acquisition import PosePriors
from scenetruth.estimators.refined.common_uncertainty import CalibrationUncertainty
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.element_variance import describe_rows, propagate_rows
from scenetruth.estimators.refined.kernels.window_solver import DIRECTION, FULL, FUNCTIONALS, VALUES
from scenetruth.estimators.refined.pose_corrections import (
    PoseCorrections,
    compute_point_derivatives,
    count_frames,
    follow_points,
)
from scenetruth.threads import in_bands

__all__ = ["compute_calibration_effect", "compute_pose_effect"]

Map = NDArray[np.float64]

_STEP_PX = 16  # distance in px of the points at which errors are computed; covariances are interpolated linearly
_APART = 0.4  # distance of the points of numerical derivatives, in standard deviations of a window
_TRUNCATED = 0.83  # standard deviation of a Gaussian truncated at 2σ, in σ: in the image √(1 - 2 e⁻² / (1 - e⁻²))
_ISOTROPIC = 0.02  # part of the texture that is taken as isotropic: noise and interpolation
_NEIGHBOURS = 3  # points along each axis over which covariances are averaged
_Q = 6  # index of the first parameter of velocity; three for each component
_LEAST_ROWS = 8  # rows per task of a thread


def compute_pose_effect(
    images: ImageStack, theta: Map, rooted: Map, turned_px: tuple[float, float], sigma_px: float
) -> Map:
    """Return the variances of the quantities of the surface element due to poses, shape (11, y, x).

    Displacements that surface and motion do not explain act through the texture: in a window with oblique gradients,
    images that are displaced along y seem to be displaced along x. Slopes of disparity respond most.

    ``theta``: Parameters of every pixel, finite, shape (15 or more, y, x).
    ``rooted``: L of the covariance L Lᵀ of the errors of all images, shape (4 n, any).
    ``turned_px``: Standard deviations of the shifts of positions along x and y that are rotations of the camera.
    """
    height, width = images.shape
    rows, columns = (np.linspace(0, size - 1, max(2, size // _STEP_PX)).round().astype(int) for size in (height, width))
    down, across = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    own = theta[:FULL, down, across]
    apart = max(1, round(_APART * sigma_px))
    nodes = apart * np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2)
    textures = _textures(images, sigma_px)
    # Rotations displace points by f α (1 + x² / f²); corrections are without the second part.
    turned = PoseCorrections(PosePriors((*turned_px, 0.0, 0.0), (0.0, 0.0)), images).parts
    effects = []
    for x, y in nodes:
        fields = np.empty((4, len(down)))
        fields[0] = own[0] + own[1] * x + own[2] * y + own[3] * x * x + own[4] * x * y + own[5] * y * y
        fields[1:] = own[_Q::3] + own[_Q + 1 :: 3] * x + own[_Q + 2 :: 3] * y
        texture = textures[np.clip(down + y, 0, height - 1), np.clip(across + x, 0, width - 1)]
        effects.append(_displace(images, fields, np.stack([across + x, down + y]), texture, rooted, turned))
    change = np.einsum("kn,npfu->kpfu", _derivatives(nodes), np.stack(effects), optimize=True)
    of_motion = change[:3, :, 1:].transpose(2, 0, 1, 3).reshape(9, *change.shape[1:2], change.shape[3])
    moved = np.concatenate([change[:, :, 0], of_motion]).swapaxes(0, 1)
    covariance = np.matmul(moved, moved.swapaxes(1, 2)).reshape(len(rows), len(columns), FULL, FULL)
    covariance = uniform_filter1d(uniform_filter1d(covariance, _NEIGHBOURS, axis=0), _NEIGHBOURS, axis=1)
    out = np.empty((FUNCTIONALS, height, width))
    fixed = np.ascontiguousarray(theta[:FULL]), np.asarray(images.centre, dtype=np.float64), float(images.focal)
    places = [np.interp(np.arange(n), at, np.arange(len(at))) for n, at in ((height, rows), (width, columns))]
    in_bands(propagate_rows, height, *fixed, np.ascontiguousarray(covariance), *places, out, least=_LEAST_ROWS)
    return out


def _textures(images: ImageStack, sigma_px: float) -> Map:
    """Return the structure tensor of the reference image over windows, of trace 2, shape (y, x, 2, 2)."""
    frame, camera = images.reference()
    out = np.zeros((*images.shape, 2, 2))
    for channel in range(images.channels):
        gradient = np.gradient(images.grey(frame, camera, channel))
        for k, j in ((0, 0), (0, 1), (1, 1)):
            out[..., k, j] += gaussian_filter(gradient[1 - k] * gradient[1 - j], _TRUNCATED * sigma_px)
    out[..., 1, 0] = out[..., 0, 1]
    mean = 0.5 * (out[..., 0, 0] + out[..., 1, 1])[..., None, None] + 1e-300
    return np.asarray((1.0 - _ISOTROPIC) * out / mean + _ISOTROPIC * np.eye(2))


def _displace(images: ImageStack, fields: Map, at: Map, texture: Map, rooted: Map, turned: Map) -> Map:
    """Return the errors of disparity, and of velocity times disparity, per unit error; shape (points, 4, any)."""
    view = images.view()
    still = count_frames(view) == 1
    moves = compute_point_derivatives(view, fields, at, still=still)
    points, count = len(at[0]), len(view.s)
    follow = follow_points(moves, texture)[:, :4].reshape(points, 4, count, 2)
    # A single frame does not determine the velocity.
    follow[:, 1:] *= 0.0 if still else fields[0][:, None, None, None]
    by_pose = np.einsum("pfnk,pnki->pfni", follow, moves.by_image, optimize=True).reshape(points, 4, -1)
    bent = _bend(moves.by_image, follow, images.focal)
    return np.concatenate([np.matmul(by_pose, rooted), np.matmul(bent, turned)], axis=2)


def _bend(by_image: Map, follow: Map, focal: float) -> Map:
    """Return the effect of the displacements x (x, y) / f² and y (x, y) / f² of every image, shape (points, 4, 4 n)."""
    x, y = by_image[:, :, 0, 3], by_image[:, :, 1, 3]
    bent = np.zeros_like(by_image)
    bent[:, :, 0, 0], bent[:, :, 1, 0] = x * x, x * y
    bent[:, :, 0, 1], bent[:, :, 1, 1] = x * y, y * y
    product = np.einsum("pfnk,pnki->pfni", follow, bent / focal**2, optimize=True)
    return np.asarray(product.reshape(*product.shape[:2], -1))


def _derivatives(nodes: NDArray[np.intp]) -> Map:
    """Return the coefficients of value, slopes and second order of a polynomial by its values at points, (6, n)."""
    x, y = nodes.T.astype(np.float64)
    return np.asarray(np.linalg.pinv(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)))


def compute_calibration_effect(images: ImageStack, theta: Map, given: CalibrationUncertainty) -> Map:
    """Return the variances of the quantities of the surface element due to the calibration, shape (11, y, x).

    Images show disparity, flow and its divergence; an error of the lens changes what follows from them.
    """
    height, width = images.shape
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - images.centre[0], y - images.centre[1]
    theta, focal = np.ascontiguousarray(theta[:FULL]), float(images.focal)
    before = _describe(theta, x, y, focal)
    total = np.zeros((FUNCTIONALS, height, width))
    if given.focal > 0:
        changed = theta.copy()
        changed[12:] *= 1.0 + given.focal
        total += _change(before, _describe(changed, x, y, focal * (1.0 + given.focal)))
    for axis, std in enumerate(given.centre):
        if std > 0:
            changed = theta.copy()
            changed[_Q + 3 * axis : _Q + 3 * axis + 3] -= std * theta[12:]
            to_x, to_y = (x - std * focal, y) if axis == 0 else (x, y - std * focal)
            total += _change(before, _describe(changed, to_x, to_y, focal))
    for moved in () if given.displacements is None else given.displacements:
        changed, to_x, to_y = _see_elsewhere(theta, x, y, focal, moved)
        total += _change(before, _describe(changed, to_x, to_y, focal))
    # Distances along the stage are the unit of lengths: of curvatures only.
    total[2] += (before[2] * given.scale) ** 2
    total[3] += (2.0 * before[3] * given.scale) ** 2
    return total


def _see_elsewhere(theta: Map, x: Map, y: Map, focal: float, moved: Map) -> tuple[Map, Map, Map]:
    """Return parameters and positions if the lens shows points at other places, displaced by a map (2, y, x)."""
    by = np.stack([np.stack([np.gradient(each, axis=axis) for axis in (1, 0)]) for each in moved])
    slope = np.stack([np.gradient(by[0, 0], axis=axis) for axis in (1, 0)])
    rows, columns = np.indices(x.shape)
    changed = theta.copy()

    def change(right: int, down: int) -> tuple[Map, Map, Map]:
        """Return the changes of disparity and velocity on the surface of every pixel at an offset, and the offset."""
        at = np.clip(rows + down, 0, len(x) - 1), np.clip(columns + right, 0, x.shape[1] - 1)
        to = np.stack([at[1] - columns, at[0] - rows]).astype(np.float64)
        d = theta[0] + theta[1] * to[0] + theta[2] * to[1]
        q = theta[_Q::3] + theta[_Q + 1 :: 3] * to[0] + theta[_Q + 2 :: 3] * to[1]
        here = np.stack([x + to[0], y + to[1]])
        ahead = q[2] / focal
        flow = d * (q[:2] - ahead * here)
        d_to = d * (1.0 + by[0, 0][at])
        flow_to = flow + np.einsum("ij...,j...->i...", by[:, :, at[0], at[1]], flow)
        # The divergence is the relative change of disparity per frame.
        ahead_to = (d * ahead - (slope[:, at[0], at[1]] * flow).sum(axis=0)) / d_to
        across = flow_to / d_to + ahead_to * (here + moved[:, at[0], at[1]]) - q[:2]
        return d_to - d, np.stack([*across, focal * ahead_to - q[2]]), to

    of_d, of_q, _ = change(0, 0)
    changed[0] += of_d
    changed[_Q::3] += of_q
    for place in (0, 1):
        before, after = (change(*((sign, 0) if place == 0 else (0, sign))) for sign in (-1, 1))
        step = after[2][place] - before[2][place]
        changed[1 + place] += (after[0] - before[0]) / step
        changed[_Q + 1 + place :: 3] += (after[1] - before[1]) / step
    return changed, x + moved[0], y + moved[1]


def _describe(theta: Map, x: Map, y: Map, focal: float) -> Map:
    out = np.empty((VALUES, *x.shape))
    in_bands(describe_rows, len(x), theta, x, y, focal, out, least=_LEAST_ROWS)
    return out


def _change(before: Map, after: Map) -> Map:
    """Return the squared changes of the quantities; that of the direction as an angle."""
    change = np.square(after[:DIRECTION] - before[:DIRECTION])
    cosine = np.abs((after[DIRECTION:] * before[DIRECTION:]).sum(axis=0))
    return np.concatenate([change, np.arccos(np.minimum(cosine, 1.0))[None] ** 2])
