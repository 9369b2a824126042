"""Scene flow as 16-bit PNG, in the layout of KITTI 2015.

For the n-th frame t, of which t + 1 is recorded: ``image_2/00000n_10.png`` and ``_11.png`` (left camera, frames t and
t + 1), ``image_3/`` (right camera), ``disp_occ_0/00000n_10.png`` (disparity at t), ``disp_occ_1/00000n_10.png``
(disparity that the same points have at t + 1, at their pixels of frame t), ``flow_occ/00000n_10.png``, and
``calib_cam_to_cam/00000n.txt`` with KITTI's P_rect_02 and P_rect_03, whose baseline is in metres. Rows run from the
top down. Disparity is uint16 = round(256 d), d = x_left - x_right in px, positive; 0 where it is not known. Flow is
three uint16, (round(64 u) + 2^15, round(64 v) + 2^15, 1) in the order red, green, blue, with u positive to the right,
v downwards, from frame t to t + 1 in px; the third is 0, and the others too, where it is not known. Points that are
hidden in other images are in (``occ``); the last frame has no files. Lost: everything finer than the steps of 1/256
px of disparity (0.0011 px rms) and 1/64 px of flow (0.0045 px rms); disparities of 256 px or more and flows beyond
512 px do not fit and become unknown. With ``flow: instantaneous``, flow is dx/dt, and disp_occ_1 is that after one
frame of the present velocity.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.export.base import FlowOptions, PairOptions, PictureOptions
from scenetruth.export.raster import write_picture
from scenetruth.export.source import Pair, Source

__all__ = ["Kitti"]

_DISPARITY_STEPS, _FLOW_STEPS, _FLOW_ZERO, _LARGEST = 256, 64, 2**15, 2**16 - 1


class Kitti(FlowOptions, PairOptions, PictureOptions):
    """Scene flow as of KITTI 2015."""

    kind: Literal["kitti"] = "kitti"
    """Name of the format."""
    summary: ClassVar[str] = "scene flow as 16-bit PNG: disparity at t and t + 1, flow, images of a pair (KITTI 2015)"
    packages: ClassVar[tuple[str, ...]] = ("cv2",)

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing."""
        yield from super().problems(source)
        yield from self.motion_problems(source, ("displacement_next",), ("velocity",))

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write one number for every frame but the last."""
        pair = self.pair_of(source)
        lost = 0
        for number, t in enumerate(source.pairs_of_frames):
            name = f"{number:06d}"
            for place, s in (("image_2", pair.left), ("image_3", pair.right)):
                for part, frame in (("10", t), ("11", t + 1)):
                    write_picture(folder / place / f"{name}_{part}.png", source.image(s, frame), self.image_bits)
            now, then = source.depth(pair.left, t), source.depth_then(pair.left, t, self.flow)
            for place, depth in (("disp_occ_0", now), ("disp_occ_1", then)):
                lost += _write_disparity(folder / place / f"{name}_10.png", source.disparity(depth, pair))
            lost += _write_flow(folder / "flow_occ" / f"{name}_10.png", source.flow(pair.left, t, self.flow))
            file = folder / "calib_cam_to_cam" / f"{name}.txt"
            file.parent.mkdir(exist_ok=True)
            file.write_text(_calibration(source, pair), encoding="ascii")
        notes = ["disparities have steps of 1/256 px (0.0011 px rms), flow has steps of 1/64 px (0.0045 px rms)"]
        if lost:
            notes.append(f"{lost} values do not fit (disparity under 256 px, flow within 512 px) and became unknown")
        return [*notes, *self.flow_notes(), *self.pair_notes(source)]


def _write_disparity(file: Path, disparity: NDArray[np.float64]) -> int:
    """Write a disparity map; return how many known values did not fit."""
    steps = np.rint(_DISPARITY_STEPS * np.nan_to_num(disparity, nan=0.0, posinf=0.0))
    # 0 stands for unknown: what is rounded to it does not fit.
    fits = (steps >= 1) & (steps <= _LARGEST)
    _write(file, np.where(fits, steps, 0).astype(np.uint16))
    return int((np.isfinite(disparity) & ~fits).sum())


def _write_flow(file: Path, flow: NDArray[np.float64]) -> int:
    known = np.isfinite(flow).all(axis=0)
    steps = np.rint(_FLOW_STEPS * np.where(known, flow, 0)) + _FLOW_ZERO
    fits = known & ((steps >= 0) & (steps <= _LARGEST)).all(axis=0)
    u, v = np.where(fits, steps, 0).astype(np.uint16)
    # OpenCV takes blue, green, red.
    _write(file, np.stack([fits.astype(np.uint16), v, u], axis=-1))
    return int((known & ~fits).sum())


def _write(file: Path, values: NDArray[np.uint16]) -> None:
    import cv2

    file.parent.mkdir(parents=True, exist_ok=True)
    found, coded = cv2.imencode(".png", values)
    if not found:
        msg = f"OpenCV could not code {file.name}"
        raise OSError(msg)
    file.write_bytes(coded.tobytes())


def _calibration(source: Source, pair: Pair) -> str:
    own = source.intrinsics
    f, (c_x, c_y) = own.focal_length_px, own.principal_point_px
    height, width = source.size
    lines = []
    for camera, along in (("02", 0.0), ("03", -f * pair.baseline_mm / 1000)):
        matrix = (f, 0.0, c_x, along, 0.0, f, c_y, 0.0, 0.0, 0.0, 1.0, 0.0)
        lines += [
            f"S_rect_{camera}: {float(width)!r} {float(height)!r}",
            f"R_rect_{camera}: 1 0 0 0 1 0 0 0 1",
            f"P_rect_{camera}: {' '.join(map(repr, matrix))}",
        ]
    return "\n".join(lines) + "\n"
