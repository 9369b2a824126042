"""Flow, depth, cameras and occlusions in the binary files of MPI Sintel.

Under ``training/``, for frame number n (from 0001 on, in order of t) of one camera:
``clean/SEQUENCE/frame_0001.png``, ``flow/SEQUENCE/frame_0001.flo``, ``depth/SEQUENCE/frame_0001.dpt``,
``camdata_left/SEQUENCE/frame_0001.cam``, ``occlusions/SEQUENCE/frame_0001.png``, ``invalid/SEQUENCE/frame_0001.png``.
Binary files start with the tag 202021.25 as float32, little endian; rows run from the top down. .flo is as of
Middlebury: u to the right, v downwards, from frame t to t + 1 in px, 1e10 where no surface is seen. .dpt holds width,
height and Z in mm as float32, NaN where no surface is seen (Sintel itself has a surface everywhere, and no mark).
.cam holds M (3 x 3) and N (3 x 4) as float64 with x = M N X, X in the world in mm, x in px with integer pixel
centres. Occlusions are 255 where a point is not seen in frame t + 1, hidden or outside the image. Invalid is 255
where there is no flow, or in the last frame no depth. The last frame has no flow and no occlusions; estimates have no
occlusions. How occlusions are found: where a point is seen both a frame earlier and later, in the first frame, and at
t = 0 of the reference camera, the truth tells exactly; else the point is looked for in the depth of frame t + 1,
which tells outlines to half a pixel. Lost: motion in depth, digits beyond float32. With ``flow: instantaneous``, flow
is dx/dt per frame, and there are no occlusions.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.errors import Problem
from scenetruth.export.base import FlowOptions, PictureOptions
from scenetruth.export.geometry import Pose, pose_of
from scenetruth.export.occlusion import hidden_next
from scenetruth.export.raster import FLO_TAG, write_flo, write_mask, write_picture
from scenetruth.export.source import Source

__all__ = ["Sintel"]


class Sintel(FlowOptions, PictureOptions):
    """Flow, depth and cameras as of MPI Sintel."""

    kind: Literal["sintel"] = "sintel"
    """Name of the format."""
    camera: Annotated[int, Field(ge=-100_000, le=100_000)] = 0
    """Position s of the camera."""
    sequence: Annotated[str, Field(pattern=r"^\w[\w-]{0,99}$")] = "scene"
    """Name of the folder that Sintel calls the sequence: letters, digits, _ and -."""
    summary: ClassVar[str] = "flow, depth, camera, occlusions as .flo, .dpt, .cam, PNG (MPI Sintel)"

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing."""
        yield from super().problems(source)
        if self.camera not in source.views:
            remedy = "; render with `--truth all` for the others" if len(source.views) == 1 else ""
            yield Problem("camera", f"must be a position with maps, one of {source.views}{remedy}", self.camera)
        if "depth" not in source.maps and "disparity" not in source.maps:
            yield Problem("depth", "is missing; take the format flo for flow alone")

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write all frames."""
        s, matrix = self.camera, _matrix(source)
        for number, t in enumerate(source.frames, start=1):

            def file(what: str, ending: str, name: str = f"frame_{number:04d}") -> Path:
                place = folder / "training" / what / self.sequence
                place.mkdir(parents=True, exist_ok=True)
                return place / f"{name}.{ending}"

            write_picture(file("clean", "png"), source.image(s, t), self.image_bits)
            depth = source.depth(s, t)
            _write_depth(file("depth", "dpt"), depth)
            _write_camera(file("camdata_left", "cam"), matrix, pose_of(source, s, t))
            unknown = np.asarray(~np.isfinite(depth))
            if t in source.pairs_of_frames:
                flow = source.flow(s, t, self.flow)
                write_flo(file("flow", "flo"), flow)
                unknown = np.asarray(~np.isfinite(flow).all(axis=0))
                if self.flow == "finite" and "occluded_in_t" in source.maps:
                    write_mask(file("occlusions", "png"), hidden_next(source, s, t))
            write_mask(file("invalid", "png"), unknown)
        notes = (
            ["the lens distorts, and .cam files know pinholes only: x = M N X does not hold"]
            if source.distortion
            else []
        )
        return [*self.flow_notes(), *notes]


def _tag() -> bytes:
    return np.array(FLO_TAG, dtype="<f4").tobytes()


def _write_depth(file: Path, depth: NDArray[np.float64]) -> None:
    height, width = depth.shape
    file.write_bytes(_tag() + np.array([width, height], dtype="<i4").tobytes() + depth.astype("<f4").tobytes())


def _write_camera(file: Path, matrix: NDArray[np.float64], pose: Pose) -> None:
    outer = np.column_stack([pose.axes.T, pose.translation_mm])
    file.write_bytes(_tag() + matrix.astype("<f8").tobytes() + outer.astype("<f8").tobytes())


def _matrix(source: Source) -> NDArray[np.float64]:
    own = source.intrinsics
    (c_x, c_y), f = own.principal_point_px, own.focal_length_px
    return np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1]])
