"""Scene flow as HDF5, in the layout of the Spring benchmark.

For frame number n (from 0001 on, in order of t): ``frame_left/frame_left_0001.png``, ``frame_right/``,
``disp1_left/disp1_left_0001.dsp5`` (disparity at t), ``disp2_FW_left/`` and ``disp2_BW_left/`` (disparity that the
same points have at t + 1 and at t - 1, at their pixels of frame t), ``flow_FW_left/flow_FW_left_0001.flo5`` and
``flow_BW_left/`` (flow to t + 1 and to t - 1), ``cam_data/intrinsics.txt`` (fx fy cx cy, one line for each frame,
pixel centres as integers), ``cam_data/extrinsics.txt`` (world to camera, 16 numbers, mm) and
``cam_data/baseline_mm.txt``. .dsp5 holds the dataset ``disparity`` (y, x), .flo5 the dataset ``flow`` (y, x, 2),
float32, rows from the top down. Disparity is positive, x_left - x_right in px; flow u is positive to the right, v
downwards. NaN where no surface is seen; points that are hidden in other images have values. There is no forward file
for the last frame and no backward file for the first. Maps are as large as images (those of the benchmark have twice
its images' resolution). Lost: digits beyond float32. With ``flow: instantaneous``, flow is dx/dt per frame, backward
its negative, and disp2 is that after one frame of the present velocity.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.export.base import FlowOptions, PairOptions, PictureOptions
from scenetruth.export.geometry import pose_of
from scenetruth.export.raster import write_picture
from scenetruth.export.source import Source

__all__ = ["Spring"]


class Spring(FlowOptions, PairOptions, PictureOptions):
    """Scene flow as of the Spring benchmark."""

    kind: Literal["spring"] = "spring"
    """Name of the format."""
    summary: ClassVar[str] = "scene flow as HDF5, .dsp5 and .flo5, forward and backward (Spring)"
    packages: ClassVar[tuple[str, ...]] = ("h5py",)

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing."""
        yield from super().problems(source)
        finite = ("flow_previous", "displacement_next", "displacement_previous")
        yield from self.motion_problems(source, finite, ("velocity",))

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write all frames."""
        pair, recorded = self.pair_of(source), source.recording["t"].values.tolist()
        for number, t in enumerate(source.frames, start=1):
            for side, s in (("left", pair.left), ("right", pair.right)):
                name = f"frame_{side}"
                write_picture(folder / name / f"{name}_{number:04d}.png", source.image(s, t), self.image_bits)
            left = pair.left
            _write(folder, "disp1_left", number, source.disparity(source.depth(left, t), pair))
            if t + 1 in recorded:
                then = source.depth_then(left, t, self.flow)
                _write(folder, "disp2_FW_left", number, source.disparity(then, pair))
                _write(folder, "flow_FW_left", number, source.flow(left, t, self.flow))
            if t - 1 in recorded:
                then = source.depth_then(left, t, self.flow, "previous")
                _write(folder, "disp2_BW_left", number, source.disparity(then, pair))
                _write(folder, "flow_BW_left", number, source.flow(left, t, self.flow, "previous"))
        _write_cameras(folder / "cam_data", source, pair.left, pair.baseline_mm)
        return [*self.flow_notes(), *self.pair_notes(source)]


def _write(folder: Path, what: str, number: int, values: NDArray[np.float64]) -> None:
    """Write a map as the dataset that its name tells; all components are NaN where one is."""
    import h5py

    flow = values.ndim > 2
    values = np.where(np.isfinite(values).all(axis=0), values, np.nan) if flow else values
    place = folder / what
    place.mkdir(exist_ok=True)
    with h5py.File(place / f"{what}_{number:04d}.{'flo5' if flow else 'dsp5'}", "w") as file:
        data = np.moveaxis(values, 0, -1) if flow else values
        file.create_dataset(
            "flow" if flow else "disparity", data=data.astype(np.float32), compression="gzip", compression_opts=5
        )


def _write_cameras(place: Path, source: Source, s: int, baseline_mm: float) -> None:
    own = source.intrinsics
    f, (c_x, c_y) = own.focal_length_px, own.principal_point_px
    poses = [pose_of(source, s, t) for t in source.frames]
    extrinsics = [np.vstack([np.column_stack([pose.axes.T, pose.translation_mm]), [0, 0, 0, 1]]) for pose in poses]
    place.mkdir()
    (place / "intrinsics.txt").write_text(f"{f!r} {f!r} {c_x!r} {c_y!r}\n" * len(poses), encoding="ascii")
    lines = [" ".join(repr(float(value)) for value in matrix.ravel()) for matrix in extrinsics]
    (place / "extrinsics.txt").write_text("".join(f"{line}\n" for line in lines), encoding="ascii")
    (place / "baseline_mm.txt").write_text(f"{baseline_mm!r}\n", encoding="ascii")
