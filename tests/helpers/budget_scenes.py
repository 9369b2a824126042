"""Scenes with all causes of errors at once, small and quick."""

from __future__ import annotations

from typing import Any

import scenetruth as st
from scenetruth.benchmark.cases import build_reference_scene

__all__ = ["EVERYTHING", "laboratory"]

EVERYTHING: dict[str, Any] = {
    "stage.errors": {
        "repeatability_um": 20.0,
        "backlash_um": 30.0,
        "straightness_um": 30.0,
        "pitch_urad": 100.0,
        "yaw_urad": 100.0,
        "roll_urad": 200.0,
    },
    "stage.time_per_position_s": 0.6,
    "camera.distortion": {"k1": -0.05},
    "optics": {
        "psf": {"kind": "gaussian", "sigma_px": 0.6},
        "vignetting": {"coefficients": [-0.1, 0, 0]},
        "defocus": {"aperture_mm": 1.0, "focus_distance_mm": 700, "samples": 4},
    },
    "shutter": {"exposure_time_s": 6.0, "samples": 2, "readout_time_s": 1.0},
    "lighting": {
        "drift_per_frame": 0.002,
        "flicker": {"amplitude": 0.001, "period_frames": 3},
        "ambient": 0.3,
        "lights": [{"kind": "directional", "direction": [-0.5, 0.4, 0.7], "irradiance": 0.7}],
    },
    "sensor": {"kind": "emva1288", "preset": "industrial_cmos"},
    "render.supersampling": 2,
    "objects.0.material": {"refractive_index": 1.5, "roughness": 0.3, "transmittance": 0.2, "reflectance": 0.7},
}
"""Every cause that a scene can have."""


def laboratory(changes: dict[str, Any] | None = None, *, everything: bool = True) -> st.Scene:
    """Return a slanted sheet with all causes of errors, or with some changes alone."""
    pose = {"position_mm": [0, 0, 720], "rotations": [{"axis": [0, 1, 0], "angle_deg": 25}]}
    plain = build_reference_scene({**(EVERYTHING if everything else {}), "objects.0.pose": pose, **(changes or {})})
    return st.Scene.from_dict(plain)
