"""Optical flow as Middlebury's .flo, with the images.

``images/s+0_t+0.png``, ``flow/s+0_t+0.flo`` for every camera with maps. A .flo file holds the tag 202021.25, width,
height, then u and v of every pixel as float32, rows from the top down, all little endian. u is positive to the right,
v downwards, in px: pixel (x, y) of frame t is at (x + u, y + v) in frame t + 1. 1e10 for both where no surface is
seen. Points that are hidden in the next frame, or outside of it, have their flow all the same. The last frame has no
file. Lost: depth and motion in depth, digits beyond float32 (6e-8 of the value). With ``flow: instantaneous``, values
are dx/dt per frame instead of displacements.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from scenetruth.export.base import FlowOptions, PictureOptions
from scenetruth.export.raster import image_name, write_flo, write_picture
from scenetruth.export.source import Source

__all__ = ["Flo"]


class Flo(FlowOptions, PictureOptions):
    """Optical flow as .flo."""

    kind: Literal["flo"] = "flo"
    """Name of the format."""
    summary: ClassVar[str] = "optical flow as .flo (Middlebury), with the images"

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write images and flow."""
        for s in source.views:
            for t in source.pairs_of_frames:
                for frame in (t, t + 1):
                    write_picture(
                        folder / "images" / f"{image_name(s, frame)}.png", source.image(s, frame), self.image_bits
                    )
                write_flo(folder / "flow" / f"{image_name(s, t)}.flo", source.flow(s, t, self.flow))
        return self.flow_notes()
