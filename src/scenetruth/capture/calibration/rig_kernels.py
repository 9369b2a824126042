"""Kernels that project target points through a camera on a stage, with derivatives."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel

__all__ = ["project_views"]

# Columns of the Jacobian: f, c_x, c_y, k1, k2, p1, p2, k3, k4, k5, k6, then these blocks.
_STAGE = 11  # a_y, a_z, kappa, backlash, aspect
_POSITION = 16  # rotation vector and offset of a position
_VISIT = 22  # rotation vector and offset of a visit
_TARGET = 28  # scale, warp a, b, c
_POSE = 32  # rotation and translation of a target, and its bend in this pose
_BEND = 7  # uu, uv, vv, uuu, uuv, uvv, vvv
_POINT = _POSE + 6 + _BEND  # deviation of a point of the target
_SMALL_ANGLE = 1e-4  # below it, Taylor series are exact to 1e-17


@subkernel()
def _rotation(x: float, y: float, z: float, rotation: NDArray[np.float64], jacobian: NDArray[np.float64]) -> None:
    """Write exp([w]x) and its left Jacobian, sum of [w]x^n / (n + 1)!, for a rotation vector w."""
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    if angle < _SMALL_ANGLE:
        a = 1.0 - square / 6.0
        b = 0.5 - square / 24.0
        c = 1.0 / 6.0 - square / 120.0
    else:
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / square
        c = (1.0 - a) / square
    w = np.zeros((3, 3))
    w[0, 1], w[0, 2], w[1, 0], w[1, 2], w[2, 0], w[2, 1] = -z, y, z, -x, -y, x
    for i in range(3):
        for j in range(3):
            product = 0.0
            for k in range(3):
                product += w[i, k] * w[k, j]
            unit = 1.0 if i == j else 0.0
            rotation[i, j] = unit + a * w[i, j] + b * product
            jacobian[i, j] = unit + b * w[i, j] + c * product


@kernel()
def project_views(
    points: NDArray[np.float64], first: NDArray[np.int64], offsets: NDArray[np.int64], values: NDArray[np.float64],
    turns: NDArray[np.float64], travel: NDArray[np.float64], half_widths: NDArray[np.float64],
    pixels: NDArray[np.float64], jacobian: NDArray[np.float64],
) -> None:  # fmt: skip
    """Project the points of all views.

    ``points``: Target points (u, v, w) in mm, deviations included, shape (n, 3).
    ``first``: Index of the first point of each view, then n; shape (views + 1,).
    ``offsets``: Offsets of position, visit, target and pose of each view in ``values``; shape (views, 4).
    ``values``: Parameters; f, c_x, c_y, k1, k2, p1, p2, k3, k4, k5, k6, a_y, a_z, kappa, backlash, aspect, then the
      blocks.
    ``turns``: Reference rotation of the pose of each view, shape (views, 3, 3).
    ``travel``: Nominal position in mm and direction of arrival of each view, shape (views, 2).
    ``half_widths``: Half width in mm of the target of each view, shape (views,).
    ``pixels``: Pixel positions to write, shape (n, 2).
    ``jacobian``: Derivatives to write, shape (n, 2, 48), or (0, 2, 48) for none; columns in the order of ``values``,
      then those by the deviation of the point from its place on the target.
    """
    f, c_x, c_y, k1, k2, p1 = values[0], values[1], values[2], values[3], values[4], values[5]
    p2, k3, k4, k5, k6 = values[6], values[7], values[8], values[9], values[10]
    a_y, a_z, kappa, backlash = values[_STAGE], values[_STAGE + 1], values[_STAGE + 2], values[_STAGE + 3]
    tall = f * (1.0 + values[_STAGE + 4])
    slopes = jacobian.shape[0] > 0
    camera, camera_left = np.empty((3, 3)), np.empty((3, 3))
    board, unused = np.empty((3, 3)), np.empty((3, 3))
    away, arm, towards = np.empty(3), np.empty(3), np.empty(3)
    turned = np.empty((3, 3))
    by_point = np.empty((2, 3))
    for view in range(first.size - 1):
        position, visit, target, pose = offsets[view, 0], offsets[view, 1], offsets[view, 2], offsets[view, 3]
        nominal, direction = travel[view, 0], travel[view, 1]
        _rotation(
            values[position] + values[visit], values[position + 1] + values[visit + 1],
            values[position + 2] + values[visit + 2], camera, camera_left,
        )  # fmt: skip
        _rotation(values[pose], values[pose + 1], values[pose + 2], board, unused)
        # Backlash: the camera stops short in its direction of travel.
        along = nominal * (1.0 + kappa) - 0.5 * direction * backlash + values[visit + 3]
        centre_x = along + values[position + 3]
        centre_y = along * a_y + values[position + 4] + values[visit + 4]
        centre_z = along * a_z + values[position + 5] + values[visit + 5]
        scale = 1.0 + values[target]
        w_a, w_b = values[target + 1] + values[pose + 6], values[target + 2] + values[pose + 7]
        w_c = values[target + 3] + values[pose + 8]
        w_uuu, w_uuv, w_uvv, w_vvv = values[pose + 9], values[pose + 10], values[pose + 11], values[pose + 12]
        width = half_widths[view]
        over = 1.0 / (width * width)
        cubic = over / width
        for i in range(3):
            for j in range(3):
                product = 0.0
                for k in range(3):
                    product += board[i, k] * turns[view, k, j]
                turned[i, j] = product
        for n in range(first[view], first[view + 1]):
            u, v, w = points[n, 0], points[n, 1], points[n, 2]
            b_x, b_y = scale * u, scale * v
            b_z = scale * w + (w_a * u * u + w_b * u * v + w_c * v * v) * over
            b_z += (w_uuu * u * u * u + w_uuv * u * u * v + w_uvv * u * v * v + w_vvv * v * v * v) * cubic
            for i in range(3):
                arm[i] = turned[i, 0] * b_x + turned[i, 1] * b_y + turned[i, 2] * b_z
                away[i] = arm[i] + values[pose + 3 + i]
            away[0] -= centre_x
            away[1] -= centre_y
            away[2] -= centre_z
            for i in range(3):
                towards[i] = camera[0, i] * away[0] + camera[1, i] * away[1] + camera[2, i] * away[2]
            depth = towards[2]
            x, y = towards[0] / depth, towards[1] / depth
            r2 = x * x + y * y
            above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
            radial = above / below
            x_d = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
            y_d = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
            # Points behind the camera have no image.
            pixels[n, 0] = f * x_d + c_x if depth > 0.0 else np.nan
            pixels[n, 1] = tall * y_d + c_y if depth > 0.0 else np.nan
            if not slopes:
                continue
            out = jacobian[n]
            out[:] = 0.0
            out[0, 0], out[1, 0] = x_d, y_d * tall / f
            out[1, _STAGE + 4] = f * y_d
            out[0, 1], out[1, 2] = 1.0, 1.0
            out[0, 3], out[1, 3] = f * x * r2 / below, tall * y * r2 / below
            out[0, 4], out[1, 4] = out[0, 3] * r2, out[1, 3] * r2
            out[0, 5], out[1, 5] = f * 2.0 * x * y, tall * (r2 + 2.0 * y * y)
            out[0, 6], out[1, 6] = f * (r2 + 2.0 * x * x), tall * 2.0 * x * y
            out[0, 7], out[1, 7] = out[0, 4] * r2, out[1, 4] * r2
            for k in range(3):
                out[0, 8 + k] = -radial * out[0, 3] * r2**k
                out[1, 8 + k] = -radial * out[1, 3] * r2**k
            slope = (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3) - radial * (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6))) / below
            d_xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            d_xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            d_yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            g_x, g_y = f / depth * d_xx, f / depth * d_xy
            h_x, h_y = tall / depth * d_xy, tall / depth * d_yy
            # Derivatives by the point in the camera frame, then by the point in the frame of the stage.
            g_z, h_z = -(g_x * x + g_y * y), -(h_x * x + h_y * y)
            for i in range(3):
                by_point[0, i] = camera[i, 0] * g_x + camera[i, 1] * g_y + camera[i, 2] * g_z
                by_point[1, i] = camera[i, 0] * h_x + camera[i, 1] * h_y + camera[i, 2] * h_z
            a_0, a_1, a_2 = away[0], away[1], away[2]
            r_0, r_1, r_2 = arm[0], arm[1], arm[2]
            for row in range(2):
                q_0, q_1, q_2 = by_point[row, 0], by_point[row, 1], by_point[row, 2]
                on_axis = q_0 + q_1 * a_y + q_2 * a_z
                out[row, _STAGE] = -q_1 * along
                out[row, _STAGE + 1] = -q_2 * along
                out[row, _STAGE + 2] = -on_axis * nominal
                out[row, _STAGE + 3] = 0.5 * direction * on_axis
                # Rotation of the camera: d(R^T a) = R^T [a]x J_l dw.
                s_0, s_1, s_2 = q_1 * a_2 - q_2 * a_1, q_2 * a_0 - q_0 * a_2, q_0 * a_1 - q_1 * a_0
                for j in range(3):
                    value = s_0 * camera_left[0, j] + s_1 * camera_left[1, j] + s_2 * camera_left[2, j]
                    out[row, _POSITION + j] = value
                    out[row, _VISIT + j] = value
                out[row, _POSITION + 3], out[row, _POSITION + 4], out[row, _POSITION + 5] = -q_0, -q_1, -q_2
                out[row, _VISIT + 3], out[row, _VISIT + 4], out[row, _VISIT + 5] = -on_axis, -q_1, -q_2
                along_u = q_0 * turned[0, 0] + q_1 * turned[1, 0] + q_2 * turned[2, 0]
                along_v = q_0 * turned[0, 1] + q_1 * turned[1, 1] + q_2 * turned[2, 1]
                along_w = q_0 * turned[0, 2] + q_1 * turned[1, 2] + q_2 * turned[2, 2]
                out[row, _TARGET] = along_u * u + along_v * v + along_w * w
                for k, square in enumerate((u * u * over, u * v * over, v * v * over)):
                    out[row, _TARGET + 1 + k] = along_w * square
                    out[row, _POSE + 6 + k] = along_w * square
                for k, cube in enumerate((u * u * u, u * u * v, u * v * v, v * v * v)):
                    out[row, _POSE + 9 + k] = along_w * cube * cubic
                bend_u = (2.0 * w_a * u + w_b * v) * over
                bend_u += (3.0 * w_uuu * u * u + 2.0 * w_uuv * u * v + w_uvv * v * v) * cubic
                bend_v = (w_b * u + 2.0 * w_c * v) * over
                bend_v += (w_uuv * u * u + 2.0 * w_uvv * u * v + 3.0 * w_vvv * v * v) * cubic
                out[row, _POINT] = scale * along_u + along_w * bend_u
                out[row, _POINT + 1] = scale * along_v + along_w * bend_v
                out[row, _POINT + 2] = scale * along_w
                # Rotation of the target about its origin, at a rotation vector of zero.
                out[row, _POSE] = q_2 * r_1 - q_1 * r_2
                out[row, _POSE + 1] = q_0 * r_2 - q_2 * r_0
                out[row, _POSE + 2] = q_1 * r_0 - q_0 * r_1
                out[row, _POSE + 3], out[row, _POSE + 4], out[row, _POSE + 5] = q_0, q_1, q_2
