"""Disparity and depth as PFM, in the layout of Middlebury's stereo sets, one folder for each frame.

``t+0/im0.png``, ``im1.png`` (left and right image), ``disp0.pfm``, ``depth0.pfm``, with a truth of all cameras also
``disp1.pfm``, ``depth1.pfm``, and ``calib.txt``. PFM is float32 with rows from the bottom up; the negative scale -1.0
says little endian. Disparity is positive: pixel (x, y) of the left image is at (x - d, y) in the right one, pixel (x,
y) of the right image at (x + d, y) in the left one. Depth is Z in mm along the optical axis, and Z = baseline f / (d
+ doffs) with doffs 0 and the baseline in mm. +inf where no surface is seen; points that the other camera does not see
have their disparity. ``calib.txt`` counts pixel centres as integers; ndisp is one more than the largest disparity,
rounded up. Lost: motion, the other cameras, digits beyond float32 (6e-8 of the value).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.export.base import PairOptions, PictureOptions
from scenetruth.export.raster import write_pfm, write_picture
from scenetruth.export.source import Pair, Source

__all__ = ["Pfm"]


class Pfm(PairOptions, PictureOptions):
    """Disparity and depth as PFM."""

    kind: Literal["pfm"] = "pfm"
    """Name of the format."""
    summary: ClassVar[str] = "disparity and depth of a left-right pair as .pfm, with images and calib.txt (Middlebury)"

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write one folder for each frame."""
        pair = self.pair_of(source)
        for t in source.frames:
            place = folder / f"t{t:+d}"
            for number, s in enumerate((pair.left, pair.right)):
                write_picture(place / f"im{number}.png", source.image(s, t), self.image_bits)
                if s not in source.views:
                    continue
                depth = source.depth(s, t)
                disparity = source.disparity(depth, pair)
                write_pfm(place / f"disp{number}.pfm", disparity)
                write_pfm(place / f"depth{number}.pfm", depth)
                if number == 0:
                    (place / "calib.txt").write_text(_calibration(source, pair, disparity), encoding="ascii")
        return self.pair_notes(source)


def _calibration(source: Source, pair: Pair, disparity: NDArray[np.float64]) -> str:
    own = source.intrinsics
    f, (c_x, c_y) = own.focal_length_px, own.principal_point_px
    matrix = f"[{f!r} 0 {c_x!r}; 0 {f!r} {c_y!r}; 0 0 1]"
    height, width = source.size
    known = disparity[np.isfinite(disparity)]
    least, most = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    lines = {
        "cam0": matrix,
        "cam1": matrix,
        "doffs": 0,
        "baseline": pair.baseline_mm,
        "width": width,
        "height": height,
        "ndisp": math.ceil(most) + 1,
        "isint": 0,
        "vmin": least,
        "vmax": most,
        "dyavg": 0,
        "dymax": 0,
    }
    return "".join(f"{name}={value}\n" for name, value in lines.items())
