"""Errors of stage, schedule and lens: what a recording states of them, and what it does not."""

from __future__ import annotations

from typing import Any

from benchmarks.trust import DEPTH_MM, Plain, noise, plane, rig

__all__ = ["GROUPS", "SCENES"]


def stage(errors: Plain | None, seed: int = 11, focal_px: float = 2400.0, **changes: Any) -> Plain:
    """Return a scene with a stage of stated errors; the texture has the same size in pixels for every focal length."""
    return scene(focal_px, {"errors": errors, **changes}, seed=seed)


def scene(focal_px: float, stage_: Plain, **changes: Any) -> Plain:
    """Return the usual sheet before a camera of another focal length, at the distance of equal pixels."""
    distance_mm = DEPTH_MM * focal_px / 2400.0
    sheet = plane(noise(4, 20))
    sheet["pose"]["position_mm"][2] = distance_mm
    return rig([sheet], camera={"focal_length_px": focal_px}, stage=stage_, **changes)


def scan(frames_per_position: float, order: str = "unidirectional", seed: int = 11, **changes: Any) -> Plain:
    """Return a scene whose positions are visited one after the other."""
    return scene(2400.0, {"time_per_position_s": 60 * frames_per_position, "scan": order}, seed=seed, **changes)


def lens(k1: float, k2: float = 0.0, seed: int = 11, **more: float) -> Plain:
    """Return a scene seen by a lens of stated distortion."""
    return rig([plane(noise(4, 20))], camera={"distortion": {"k1": k1, "k2": k2, **more}}, seed=seed)


def rolling(readout_frames: float, seed: int = 11, **changes: Any) -> Plain:
    """Return a scene of a camera with a rolling shutter."""
    stage_ = changes.pop("stage", {})
    return scene(2400.0, stage_, shutter={"readout_time_s": 60 * readout_frames}, seed=seed, **changes)


SMALL = {"pitch_urad": 10.0, "yaw_urad": 10.0, "roll_urad": 10.0, "straightness_um": 1.0, "repeatability_um": 1.0}
SCREW = {"preset": "screw_stage"}
AIR = {"preset": "air_bearing"}

SCENES: dict[str, Plain] = {
    "10 µrad and 1 µm": stage(SMALL),
    "10 µrad and 1 µm, another draw": stage(SMALL, 21),
    "10 µrad and 1 µm, a third draw": stage(SMALL, 31),
    "10 µrad and 1 µm, 1900 px": stage(SMALL, 12, 1900.0),
    "10 µrad and 1 µm, 5016 px": stage(SMALL, 13, 5016.0),
    "10 µrad and 1 µm, 3500 px": stage(SMALL, 14, 3500.0),
    "screw stage, 1900 px": stage(SCREW, 11, 1900.0),
    "screw stage, 1900 px, another draw": stage(SCREW, 22, 1900.0),
    "screw stage, 1900 px, a third draw": stage(SCREW, 33, 1900.0),
    "screw stage, 5016 px": stage(SCREW, 11, 5016.0),
    "screw stage, 5016 px, another draw": stage(SCREW, 22, 5016.0),
    "screw stage, 5016 px, a third draw": stage(SCREW, 33, 5016.0),
    "air bearing, 5016 px": stage(AIR, 11, 5016.0),
    "screw stage, bidirectional": stage(SCREW, 15, scan="bidirectional"),
    "screw stage, nine positions": stage(SCREW, 16, positions=9, baseline_mm=2.5),
    "scan of 0.1 frames": scan(0.1),
    "scan of 0.05 frames": scan(0.05, seed=12),
    "scan of 0.15 frames": scan(0.15, seed=13),
    "bidirectional scan of 0.1 frames": scan(0.1, "bidirectional"),
    "bidirectional scan of 0.02 frames": scan(0.02, "bidirectional", 12),
    "bidirectional scan of 0.15 frames": scan(0.15, "bidirectional", 13),
    "rolling shutter of half a frame": rolling(0.5),
    "rolling shutter of a tenth of a frame": rolling(0.1, 12),
    "rolling shutter of 0.9 frames": rolling(0.9, 13),
    "rolling shutter and scan": rolling(0.15, 14, stage={"time_per_position_s": 9.0}),
    "k1 = -0.6": lens(-0.6),
    "k1 = 0.6, k2 = 8, decentred": lens(0.6, 8.0, 12, p1=1e-3, p2=-8e-4),
    "k1 = -2": lens(-2.0, 0.0, 13),
    "k1 = 1.5": lens(1.5, 0.0, 14),
}

GROUPS: dict[str, str] = {
    "stage errors with stated tolerances": r"µrad|air bearing|screw",
    "scans": r"^(bidirectional )?scan",
    "rolling shutters": r"rolling",
    "lenses with distortion": r"k1",
}
"""Rows of the summary, and what the names of their scenes contain."""
