"""The scene that is simulated for a rig: a part of its images, and without what does next to nothing but takes long."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.optics import AiryPsf
from scenetruth.design.predict.look import Look, look_at
from scenetruth.design.predict.seen import flow_of
from scenetruth.design.predict.transfer import blur_px
from scenetruth.resources import Limits, bounded_parts
from scenetruth.scene import Scene

__all__ = ["Lighter", "lighter"]

_LITTLE_DISC_PX, _SMALL_DISC_PX, _LITTLE_MOTION_PX = 0.3, 2.0, 0.1
"""A disc of 0.3 px takes 0.7 % of the contrast of a wave of 4 px; a motion of 0.1 px takes 0.1 %."""
_SAMPLES = 12
_FEWER = 2
_LEAST_WINDOWS, _LEAST_ROWS = 10.0, 32
"""Rows that are left: standard deviations of the window, and px."""


@dataclass(frozen=True)
class Lighter:
    """What is simulated instead of a rig's scene.

    Parameters
    ----------
    plain
        The scene as plain values.
    changes
        What is different, in words.
    """

    plain: Mapping[str, Any]
    changes: tuple[str, ...]


def lighter(scene: Scene, region: str, most_px: int | None) -> Lighter:
    """Return what is simulated of a scene.

    Parameters
    ----------
    scene
        The scene of a rig.
    region
        Region around whose middle images are cut.
    most_px
        Pixels along the longer side, where all positions see the same; images are wider by the disparity between the
        outermost positions, and lower in return. None for whole images.
    """
    look = look_at(scene, bounded_parts(scene, Limits(), Path()), Path())
    chosen = _chosen(look, region)
    plain, changes = scene.to_plain(), list[str]()
    cut = _cut(scene, look, chosen, most_px)
    if cut:
        plain["camera"] |= cut
        camera = scene.camera
        changes.append(f"images cut from {camera.width} x {camera.height} to {cut['width']} x {cut['height']} px")
    changes += _focus(scene, plain, look.depth_mm[chosen])
    if scene.shutter.exposure_time_s > 0:
        flow = flow_of(look)[chosen]
        moved = blur_px(scene, look.depth_mm[chosen], flow.copy())
        most = float(np.hypot(*moved.T).max(initial=0.0))
        if most < _LITTLE_MOTION_PX:
            plain["shutter"]["exposure_time_s"] = 0.0
            changes.append(f"motion while images are exposed left out, {most:.2g} px at most")
    return Lighter(plain, tuple(changes))


def _focus(scene: Scene, plain: dict[str, Any], depth_mm: NDArray[np.float64]) -> list[str]:
    """Put what is out of focus in a form that takes less time, in place; return what that was."""
    defocus, psf = scene.optics.defocus, scene.optics.psf
    if defocus is None:
        return []
    discs = defocus.blur_diameter_px(depth_mm, scene.camera.focal_px)
    most = float(discs.max(initial=0.0))
    if most < _LITTLE_DISC_PX:
        plain["optics"]["defocus"] = None
        return [f"blur out of focus left out, {most:.2g} px at most"]
    if most < _SMALL_DISC_PX and not isinstance(psf, AiryPsf):
        # A disc has a quarter of its diameter as standard deviation along each axis.
        sigma = math.hypot(0.0 if psf is None else psf.sigma_px, float(np.sqrt(np.mean(discs**2))) / 4)
        plain["optics"] |= {"defocus": None, "psf": {"kind": "gaussian", "sigma_px": sigma}}
        return [f"blur out of focus, {most:.2g} px at most, made a part of the point spread"]
    plain["optics"]["defocus"]["samples"] = min(_SAMPLES, defocus.samples)
    plain["render"]["supersampling"] = min(_FEWER, scene.render.supersampling)
    few = plain["optics"]["defocus"]["samples"]
    return [f"{few} samples of the aperture, not {defocus.samples}"] if few < defocus.samples else []


def _chosen(look: Look, region: str) -> NDArray[np.bool_]:
    name = region.removeprefix("object_")
    if region.startswith("object_") and name in look.names:
        own = look.body == look.names.index(name)
        if own.any():
            return np.asarray(own)
    return np.ones(len(look), dtype=np.bool_)


def _cut(scene: Scene, look: Look, chosen: NDArray[np.bool_], most_px: int | None) -> dict[str, Any]:
    """Return the fields of a camera that sees the middle of a region only; nothing if it sees no less."""
    camera = scene.camera
    longer = max(camera.width, camera.height)
    if most_px is None or longer <= most_px:
        return {}
    width, height = (side * most_px / longer for side in (camera.width, camera.height))
    places = scene.stage.x_mm
    # What is in the middle must be seen from all positions; as many rows are left out as columns are added.
    wide = width + camera.focal_px * float(np.ptp(places)) / float(np.median(look.depth_mm[chosen]))
    sigma = float(getattr(scene.estimate.settings, "window_sigma_px", 0.0))
    low = min(max(width * height / wide, _LEAST_WINDOWS * sigma, _LEAST_ROWS), max(height, _LEAST_ROWS))
    columns, rows = min(round(wide), camera.width), min(round(low), camera.height)
    # The middle of what is bent may lie beside it: the point next to it does not.
    x, y = look.points.x[chosen], look.points.y[chosen]
    nearest = int(np.argmin((x - np.median(x)) ** 2 + (y - np.median(y)) ** 2))
    c_x, c_y = camera.principal_point
    left = int(np.clip(round(c_x + float(x[nearest]) - columns / 2), 0, camera.width - columns))
    top = int(np.clip(round(c_y + float(y[nearest]) - rows / 2), 0, camera.height - rows))
    return {"width": columns, "height": rows, "principal_point_px": [c_x - left, c_y - top]}
