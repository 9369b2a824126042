"""Noise that increases with the grey value, as photons cause it: bright surfaces before dark ones, and controls."""

from __future__ import annotations

from benchmarks.trust import Plain, noise, plane, rig

__all__ = ["GROUPS", "SCENES"]


def two_sheets(bright: Plain, dark: Plain, sensor: Plain) -> Plain:
    """Return a scene of a moving sheet that covers the middle of the view, before one at rest."""
    pose = {"position_mm": [0, 0, 600.0], "rotations": [{"axis": [0, 1, 0], "angle_deg": 10}]}
    leaf = plane(bright, name="leaf", mesh={"kind": "plane", "size_mm": [40, 36]}, pose=pose)
    ground = plane(dark, name="soil", pose={"position_mm": [0, 0, 640.0]}, motion=[])
    scene = rig([leaf, ground])
    return {**scene, "sensor": sensor}


def weak(mean: float, contrast: float, longest_px: float = 20.0) -> Plain:
    """Return a noise texture of a mean radiance and contrast."""
    return {**noise(4, longest_px, contrast), "mean": mean}


def photons(**changes: object) -> Plain:
    """Return an industrial sensor of 10,400 electrons, with changes."""
    return {"kind": "emva1288", "preset": "industrial_cmos", "prnu": 0.0, "dsnu_e": 0.0, **changes}


SCENES: dict[str, Plain] = {
    "bright leaf before dark soil": two_sheets(weak(0.7, 0.06), weak(0.06, 0.3), photons()),
    "bright leaf before black ground": two_sheets(weak(0.7, 0.1), weak(0.03, 0.1), photons()),
    "bright leaf, little light": two_sheets(weak(0.5, 0.1), weak(0.1, 0.3), photons(exposure_time_s=0.002)),
    "one texture with all grey values": {**rig([plane(noise(4, 20, 0.33))]), "sensor": photons()},
    "constant noise, bright leaf before dark soil": two_sheets(
        weak(0.7, 0.06), weak(0.06, 0.3), {"bit_depth": 12, "noise_std": 0.005}
    ),
    "encoded values (gamma 0.45), bright leaf": two_sheets(weak(0.7, 0.1), weak(0.1, 0.3), photons(gamma=0.45)),
    "no noise but rounding, bright leaf before dark soil": two_sheets(
        weak(0.7, 0.06), weak(0.06, 0.3), {"bit_depth": 12, "noise_std": 0.0}
    ),
}

GROUPS: dict[str, str] = {
    "noise of photons": r"^(?!constant|no noise)",
    "constant noise": r"^(constant|no noise)",
}
"""Rows of the summary, and what the names of their scenes contain."""
