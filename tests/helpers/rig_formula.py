"""A rig for a leaf in closed form: lenses, cameras and stages to choose, noise against bias, and constraints."""

from __future__ import annotations

import math
from typing import Any

from scenetruth.design.optimisation import DesignSpace, Parameter

__all__ = ["CHOICES", "leaf_rig", "rig_space"]

DEPTH_MM = 600.0
# f-numbers, blur in µm, image circle and least distance in mm, by focal length in mm.
_LENSES = {
    "8": (1.4, 16.0, 2.5, 11.5, 100.0),
    "12": (1.8, 16.0, 2.0, 11.5, 100.0),
    "16": (1.8, 16.0, 2.0, 11.5, 100.0),
    "25": (1.8, 16.0, 2.0, 11.5, 150.0),
    "35": (2.0, 16.0, 2.0, 11.5, 200.0),
    "50": (2.8, 22.0, 2.0, 11.5, 250.0),
    "75": (2.8, 22.0, 2.5, 11.5, 500.0),
    "50 large": (1.8, 22.0, 4.0, 43.3, 450.0),
    "100 large": (2.8, 32.0, 3.0, 43.3, 300.0),
}
# Pixels, pitch in µm, quantum efficiency, full well and read noise in electrons.
_CAMERAS = {
    "industrial": (2448, 2048, 3.45, 0.62, 10500.0, 2.4),
    "scientific": (2048, 2048, 6.5, 0.82, 30000.0, 0.9),
    "ccd": (1600, 1200, 7.4, 0.4, 20000.0, 15.0),
    "large": (4096, 3072, 5.5, 0.6, 14000.0, 13.0),
    "vga": (640, 480, 4.8, 0.6, 10000.0, 8.0),
}
# Travel in mm, repeatability in µm, angles in µrad, speed in mm/s, settling in s.
_STAGES = {
    "screw": (100.0, 1.0, 100.0, 10.0, 0.2),
    "roller": (50.0, 0.2, 20.0, 100.0, 0.1),
    "air": (25.0, 0.1, 2.5, 100.0, 0.1),
    "long air": (300.0, 0.1, 10.0, 200.0, 0.2),
}
CHOICES = [(lens, camera, stage) for lens in _LENSES for camera in _CAMERAS for stage in _STAGES]


def rig_space() -> DesignSpace:
    """Return the design variables: three choices, four ranges, and a whole number."""
    return DesignSpace(
        (
            *(Parameter("lens", choices=tuple(_LENSES)), Parameter("camera", choices=tuple(_CAMERAS))),
            Parameter("stage", choices=tuple(_STAGES)),
            Parameter("f_number", 2.0, 22.0, logarithmic=True),
            Parameter("exposure_s", 0.001, 0.2, logarithmic=True),
            Parameter("baseline_mm", 1.0, 40.0, logarithmic=True),
            Parameter("positions", 2, 9, whole=True),
            Parameter("interval_s", 60.0, 1800.0, logarithmic=True),
        )
    )


def leaf_rig(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
    """Return errors of growth (``a``) and depth (``b``), and the margins of constraints relative to their bounds."""
    focal = float(values["lens"].split()[0])
    least_f, most_f, blur_um, circle, nearest = _LENSES[values["lens"]]
    width, height, pitch, efficiency, full_well, read_noise = _CAMERAS[values["camera"]]
    travel, repeatability, angle, speed, settle = _STAGES[values["stage"]]
    f_number, exposure = values["f_number"], values["exposure_s"]
    step, positions, interval = values["baseline_mm"], values["positions"], values["interval_s"]
    image = focal * DEPTH_MM / (DEPTH_MM - focal)
    focal_px, effective = image / pitch * 1e3, f_number * image / focal
    scale = DEPTH_MM / focal_px
    disc = focal_px * focal / f_number * 12.5 / DEPTH_MM**2
    blur_px = math.hypot(blur_um / pitch, 0.421 * 0.55 * effective / pitch, disc / 4)
    electrons = 4.09e7 / (4 * effective**2) * pitch**2 * efficiency * exposure * 0.9
    level = 0.4 * min(electrons, full_well)
    noise = math.sqrt(level + read_noise**2) / level
    period = 2.0 / scale
    gradient = 0.25 * math.exp(-0.5 * (2 * math.pi * blur_px / period) ** 2) * 2 * math.pi / period
    window_px = noise / gradient / (16 * math.sqrt(math.pi))
    lever = step * math.sqrt(positions * (positions**2 - 1) / 12)
    shift = math.hypot(focal_px * repeatability / 1e3 / DEPTH_MM, focal_px * angle * 1e-6)
    depth = DEPTH_MM**2 / focal_px / lever * math.hypot(window_px, shift)
    whole = step * (positions - 1)
    affine = window_px / math.sqrt(60) * 3.6e5 / interval / math.sqrt(positions) * (1 + 30 / whole)
    isotropic = math.hypot(affine / 6, 0.13 * (1 + 0.3 * math.log(scale / 0.05) ** 2))
    at_most = [
        *(
            (disc, 1.5),
            (8 * scale, 3.0),
            (9 * interval, 7200.0),
            (positions * (settle + step / speed + exposure), 30.0),
        ),
        *((exposure / interval * 2 / scale, 0.1), (1.2 * electrons / full_well, 0.95), (9.0 * positions, 81.0)),
        *((max(focal_px * angle * 1e-6, focal_px * repeatability / 1e3 / DEPTH_MM), 0.05), (f_number, most_f)),
        *(
            (focal_px * whole / DEPTH_MM / width, 0.3),
            (1e-3 * pitch * math.hypot(width, height), circle),
            (whole, travel),
        ),
    ]
    at_least = [(width * scale, 95.0), (height * scale, 65.0), (DEPTH_MM, nearest), (f_number, least_f)]
    margins = [(bound - value) / bound for value, bound in at_most]
    margins += [(value - bound) / bound for value, bound in at_least]
    return {"a": min(affine, isotropic), "b": depth}, margins
