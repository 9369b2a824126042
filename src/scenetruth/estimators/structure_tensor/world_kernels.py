"""Kernel that turns the null space of every pixel into depth, motion and their errors in world coordinates."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

__all__ = ["to_world"]

_NONE, _NORMAL, _FULL = 0, 1, 2
# Displacement that may be left between two cameras or two frames by the best of several registrations, in px.
_MOST_LEFT = 1.0

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _look_up(phase: float, phases: Any, table: Any) -> float:
    """Interpolate linearly; beyond the end the last value holds."""
    position = min(phase / phases[1], len(phases) - 1.0)
    index = min(int(position), len(phases) - 2)
    part = position - index
    return float((1.0 - part) * table[index] + part * table[index + 1])


@_jit
def to_world(
    camera: tuple[float, float, float, float],
    centre: tuple[float, float],
    scales: tuple[float, float],
    sees: tuple[bool, bool],
    registrations: Any,
    several: tuple[bool, bool, bool],
    first_row: int,
    kinds: Any,
    solved: Any,
    found: Any,
    choice: Any,
    noise: tuple[float, float, float, float, float, float, float],
    tables: Any,
    texture: Any,
    stride: int,
    floats: Any,
    moved: Any,
    singles: Any,
    flags: Any,
    eigenvalues: Any,
    rows: tuple[int, int],
) -> None:
    """Go back to the world (paper, end of section 3), pixel by pixel.

    Parameters
    ----------
    camera
        f, c_x, c_y in px and V_X in mm.
    centre
        Where the estimates belong, in steps of s and t from the reference.
    scales
        By what g_s and g_t were multiplied so that all derivatives have the same noise.
    sees
        Whether there is disparity, and motion.
    registrations
        Disparity, flow along x, flow along y of every working point, shape (n, 3).
    several
        Which of these three are not the same for all working points.
    first_row
        Row of the image at which the arrays of this call begin.
    kinds, solved, found, choice
        What `estimate_tile` left, of one frame; shapes (3, y, x), (5, y, x), (14, y, x), (y, x).
    noise
        Power of the images' noise (not finite: estimated from each pixel's own residual), the four powers of the
        residuals in units of it, Σ w², and the constraint's noise along s.
    tables
        φ, and noise of the constraint over it, shape (4, n): φ; disparity along s, along t; motion along t.
    texture, stride
        What `texture_transfer` found from ``first_row`` on, shape (5, Y, X), and the distance of its points.
    floats
        Output, float32, shape (8, y, x): depth, velocity, disparity, flow, divergence.
    moved
        Output, float32, shape (2, y, x), written if the estimates belong elsewhere: by how much the reference sees the
        point further right and down.
    singles
        Output, float32, shape (7, y, x): standard deviations of depth, velocity, disparity; confidence; working point.
    flags
        Output, shape (4, y, x): kind of all, of disparity, of motion, and model violation.
    eigenvalues
        Output, float32, shape (5, y, x): λ1 to λ5.
    rows
        First and last + 1 of the rows to do.
    """
    focal, c_x, c_y, baseline = camera
    centre_s, centre_t = centre
    scale_s, scale_t = scales
    phases = tables[0]
    elsewhere = centre_s != 0.0 or centre_t != 0.0
    for y in range(rows[0], rows[1]):
        texture_row = y // stride
        for x in range(choice.shape[1]):
            for k in range(8):
                floats[k, y, x] = np.nan
            if elsewhere:
                moved[0, y, x] = moved[1, y, x] = np.nan
            for k in range(7):
                singles[k, y, x] = np.nan
            singles[5, y, x] = 0.0
            for k in range(4):
                flags[k, y, x] = 0
            for k in range(5):
                eigenvalues[k, y, x] = found[k, y, x] if choice[y, x] >= 0 else np.nan
            if choice[y, x] < 0:
                continue
            whole = registrations[choice[y, x]]
            left_v, left_x, left_y = solved[0, y, x] / scale_s, solved[1, y, x] / scale_t, solved[2, y, x] / scale_t
            # Where there was a choice, a better one lies outside the common view, or there is none.
            if (
                (several[0] and abs(left_v) > _MOST_LEFT)
                or (several[1] and abs(left_x) > _MOST_LEFT)
                or (several[2] and abs(left_y) > _MOST_LEFT)
            ):
                continue
            disparity, flow_x, flow_y = whole[0] - left_v, whole[1] + left_x, whole[2] + left_y
            u_z = (solved[4, y, x] if kinds[1, y, x] == _FULL else solved[3, y, x]) / scale_t
            depth = focal * baseline / disparity if disparity != 0.0 else np.nan
            kind_s = kinds[0, y, x] if sees[0] and np.isfinite(depth) and depth > 0.0 else _NONE
            kind_t = kinds[1, y, x] if sees[1] and np.isfinite(flow_x + flow_y + u_z) else _NONE
            flags[1, y, x], flags[2, y, x] = kind_s, kind_t
            flags[0, y, x] = min(kind_s, kind_t) if sees[0] and sees[1] else max(kind_s, kind_t)
            if kind_s == _NONE and kind_t == _NONE:
                continue
            flags[3, y, x] = kinds[2, y, x]
            singles[6, y, x] = whole[0]
            three, four = found[2, y, x], found[3, y, x]
            gap = max((three - four) / (three + four), 0.0) if three + four > 0.0 else 0.0
            singles[5, y, x] = min(gap * gap, 1.0)

            # The camera between the cameras, the instant between the frames.
            x_0 = first_x = x - c_x - whole[0] * centre_s + whole[1] * centre_t
            y_0 = first_y = first_row + y - c_y + whole[2] * centre_t
            u_x, u_y = flow_x - x_0 * u_z, flow_y - y_0 * u_z
            if kind_t == _NONE:
                u_x = u_y = u_z = 0.0
            if elsewhere:
                closer = 1.0 + u_z * centre_t
                seen = x_0 + (disparity * centre_s if centre_s != 0.0 else 0.0)
                x_0, y_0 = (seen - u_x * centre_t) / closer, (y_0 - u_y * centre_t) / closer
                disparity, depth = disparity / closer, depth * closer
                u_x, u_y, u_z = u_x / closer, u_y / closer, u_z / closer
                moved[0, y, x] = x_0 + c_x - x
                moved[1, y, x] = y_0 + c_y - (first_row + y)

            power = noise[0]
            r_x, r_all, k_x, k_y, wider = texture[:, texture_row, x // stride]
            turn_t = np.sqrt(k_x * left_x * left_x + k_y * left_y * left_y)
            relative = 0.0
            if kind_s != _NONE:
                floats[0, y, x], floats[4, y, x] = depth, disparity
                v = found[7, y, x] if kinds[1, y, x] == _FULL else solved[0, y, x]
                from_s = power if np.isfinite(power) else max(found[5, y, x], 0.0) / (noise[1] + noise[2] * v * v)
                passed = _look_up(np.sqrt(k_x) * abs(left_v), phases, tables[1]) * r_x * noise[5]
                if kind_t == _FULL or not sees[1]:
                    passed *= _look_up(turn_t, phases, tables[2])
                else:
                    passed *= tables[2, 0]
                std = np.sqrt(from_s * passed * found[6, y, x]) / scale_s
                relative = std / abs(disparity)
                singles[0, y, x], singles[4, y, x] = depth * relative, std
            if kind_t == _NONE:
                continue
            floats[5, y, x], floats[6, y, x], floats[7, y, x] = u_x + x_0 * u_z, u_y + y_0 * u_z, u_z
            if kind_s == _NONE:
                continue
            mm = depth / focal
            floats[1, y, x], floats[2, y, x], floats[3, y, x] = u_x * mm, u_y * mm, -u_z * depth
            if kind_t != _FULL:
                continue
            p1, p2 = solved[1, y, x], solved[2, y, x]
            from_t = power
            if not np.isfinite(power):
                from_t = max(found[8, y, x], 0.0) / (noise[3] + noise[4] * (p1 * p1 + p2 * p2))
            passed = from_t * r_all * noise[5] * noise[6] * _look_up(turn_t, phases, tables[3]) / (scale_t * scale_t)
            c11, c22, c33 = found[9, y, x], found[10, y, x], wider * found[11, y, x]
            c13, c23 = found[12, y, x], found[13, y, x]
            across = passed * (c11 - 2.0 * first_x * c13 + first_x * first_x * c33)
            down = passed * (c22 - 2.0 * first_y * c23 + first_y * first_y * c33)
            singles[1, y, x] = mm * np.sqrt(across + (u_x * relative) ** 2)
            singles[2, y, x] = mm * np.sqrt(down + (u_y * relative) ** 2)
            singles[3, y, x] = depth * np.sqrt(passed * c33 + (u_z * relative) ** 2)
