"""Motions that are not steady: swings, nodding leaves, wind; and curved surfaces."""

from __future__ import annotations

from benchmarks.trust import Plain, noise, plane, rig
from benchmarks.trust_growth import leaf

__all__ = ["GROUPS", "SCENES"]


def swing(amplitude_mm: float, period_frames: float, phase_deg: float = 30.0) -> Plain:
    """Return a scene of a sheet that swings along X and towards the camera."""
    curve = {"kind": "harmonic", "amplitude": amplitude_mm, "period_frames": period_frames, "phase_deg": phase_deg}
    motion = [{"kind": "shift", "direction": [1, 0.2, 0.5], "distance_mm": curve}]
    return rig([plane(noise(4, 20), motion=motion)])


def nodding(amplitude_deg: float, period_frames: float, phase_deg: float = 40.0) -> Plain:
    """Return a scene of a leaf that nods about the end of its petiole."""
    curve = {"kind": "harmonic", "amplitude": amplitude_deg, "period_frames": period_frames, "phase_deg": phase_deg}
    return leaf(0.03, None, motion=[{"kind": "turn", "axis": [0, 1, 0], "point_mm": [-40, 0, 600], "angle_deg": curve}])


def curved(radius_mm: float) -> Plain:
    """Return a scene of a rotating sphere that fills most of the view."""
    motion = [{"kind": "velocity", "velocity_mm_per_frame": [0.2, 0.1, 0.3]}]
    ball = {"kind": "sphere", "radius_mm": radius_mm}
    pose = {"position_mm": [0, 0, 600 + radius_mm]}
    return rig([plane(noise(4, 20), mesh=ball, pose=pose, motion=motion)])


SCENES: dict[str, Plain] = {
    "swing of 7 frames": swing(0.2, 7),
    "swing of 5 frames": swing(0.5, 5, 70),
    "swing of 9 frames": swing(1.0, 9, 0),
    "swing of 14 frames": swing(1.5, 14, 100),
    "swing of 20 frames": swing(2.0, 20),
    "swing of 11 frames": swing(0.3, 11, 60),
    "nodding in 10 frames": nodding(0.5, 10),
    "nodding in 7 frames": nodding(0.3, 7, 90),
    "nodding in 12 frames": nodding(0.6, 12, 10),
    "nodding in 25 frames": nodding(1.0, 25),
    "sphere of 40 mm": curved(40),
    "sphere of 25 mm": curved(25),
}

GROUPS: dict[str, str] = {
    "swings": r"swing",
    "leaves nodding": r"nodding",
    "spheres": r"sphere",
}
"""Rows of the summary, and what the names of their scenes contain."""
