"""Scenes beyond the bundled ones: every kind of surface, texture, motion, light, lens, shutter, stage and sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

__all__ = ["VARIATIONS", "WALL", "made_scenes"]

WALL: dict[str, Any] = {
    "camera": {"width": 64, "height": 48, "focal_length_px": 500},
    "objects": [
        {
            "name": "wall",
            "mesh": {"kind": "plane", "size_mm": [200, 200]},
            "pose": {"position_mm": [0, 0, 500]},
            "texture": {"kind": "noise", "wavelength_mm": [6, 20]},
        }
    ],
    "stage": {"positions": 3, "baseline_mm": 2.2, "errors": {"yaw_urad": 20, "repeatability_um": 5}},
    "frames": {"count": 3},
    "sensor": {"noise_std": 0.004, "bit_depth": 12},
    "render": {"backend": "raycast"},
    "score": {"interior_margin_px": 0},
}
"""A wall in front of a short stage."""

_EFFECTS = [
    {"kind": "photon_conversion", "photon_rate_per_s": 2e6, "exposure_time_s": 0.01},
    {"kind": "bayer_filter", "order": "rggb"},
    {"kind": "quantum_efficiency", "quantum_efficiency": 0.6},
    {"kind": "photo_response_nonuniformity", "prnu": 0.01},
    {
        "kind": "dark_current",
        "exposure_time_s": 0.01,
        "dark_current_e_per_s": 50,
        "hot_pixel_share": 0.01,
        "hot_pixel_current_e_per_s": 9000,
    },
    {"kind": "shot_noise"},
    {"kind": "dark_signal_nonuniformity", "dsnu_e": 2.0},
    {"kind": "readout_lag", "lag": 0.02},
    {"kind": "full_well", "full_well_e": 7000},
    {"kind": "readout_noise", "temporal_dark_noise_e": 4.0},
    {"kind": "gain", "gain_dn_per_e": 0.1, "black_level_dn": 20},
    {"kind": "gamma", "gamma": 0.8},
    {"kind": "digitisation", "bit_depth": 10},
]
_SHARES = [
    {"kind": "full_scale", "full_scale_radiance": 1.1},
    {"kind": "gaussian_noise", "noise_std": 0.006},
    {"kind": "full_range_gain"},
    {"kind": "digitisation", "bit_depth": 9},
]
_SENSOR = {"kind": "emva1288", "preset": "industrial_cmos", "bayer": "grbg", "gamma": 1.2, "prnu": 0.01, "dsnu_e": 3.0}
_PARTIAL = {"after": "shot_noise", "effect": {"kind": "readout_lag", "lag": 0.05}}
_LIGHTS = [
    {"kind": "point", "position_mm": [80, -60, 300], "irradiance": 0.6, "reference_distance_mm": 300},
    {"kind": "directional", "direction": [0.3, 0.2, 1], "irradiance": 0.4},
    {
        "kind": "spot",
        "position_mm": [-90, 0, 350],
        "target_mm": [0, 0, 660],
        "inner_angle_deg": 10,
        "outer_angle_deg": 25,
        "irradiance": 0.7,
        "reference_distance_mm": 300,
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [2, 0, 0]}],
    },
]

VARIATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "sensor of effects": ("plane", {"sensor": {"kind": "chain", "effects": _EFFECTS}}),
    "sensor of shares": ("plane", {"sensor": {"kind": "chain", "effects": _SHARES}}),
    "sensor of a preset": ("cube", {"sensor": {**_SENSOR, "insert": [_PARTIAL]}}),
    "sensor without noise": ("plane", {"sensor": "ideal"}),
    "distortion": ("plane", {"camera.distortion": {"k1": -0.2, "k2": 0.1, "p1": 0.002, "k3": 0.01, "k4": 0.02}}),
    "psf": (
        "cube",
        {
            "optics.psf": {"kind": "gaussian", "sigma_px": 0.7},
            "optics.vignetting": {"natural": True, "coefficients": [-0.2, 0.05, 0.0]},
        },
    ),
    "diffraction": (
        "plane",
        {"optics.psf": {"kind": "airy", "wavelength_um": 0.55, "f_number": 8, "pixel_pitch_um": 3.45}},
    ),
    "defocus": ("cube", {"optics.defocus": {"aperture_mm": 6, "focus_distance_mm": 640, "samples": 12}}),
    "exposure": (
        "cube_spotlight",
        {"shutter": {"exposure_time_s": 0.4, "samples": 4}, "stage.time_per_position_s": 0.1},
    ),
    "rolling shutter": (
        "plane",
        {"shutter": {"exposure_time_s": 0.1, "readout_time_s": 0.3, "stage_speed_mm_per_s": 5}},
    ),
    "stage with errors": (
        "cube",
        {
            "stage": {
                "positions": 3,
                "baseline_mm": 5,
                "rows": 2,
                "row_spacing_mm": 4,
                "scan": "bidirectional",
                "time_per_position_s": 0.05,
                "errors": {"repeatability_um": 10, "backlash_um": 5, "straightness_um": 8, "pitch_urad": 30},
            }
        },
    ),
    "stage of a preset": ("plane", {"stage.errors": {"preset": "screw_stage"}, "stage.positions": 3}),
    "listed positions": ("plane", {"stage": {"positions_mm": [-7, 0, 4, 11]}}),
    "lights": (
        "occluders",
        {"lighting": {"ambient": 0.2, "lights": _LIGHTS, "drift_per_frame": -0.01}},
    ),
    "flicker": (
        "cube",
        {"lighting": {"ambient": 0.5, "flicker": {"amplitude": 0.1, "period_frames": 3.3}}},
    ),
    "OpenGL": ("cube", {"render": {"backend": "pyrender", "platform": "auto"}}),
}
"""Bundled scenes with changes: name to scene and changes by path."""


def _item(place: int, name: str, mesh: dict[str, Any], texture: dict[str, Any], **more: Any) -> dict[str, Any]:
    position = [(place % 4 - 1.5) * 34, (place // 4 - 1) * 34, 560 + 3 * place]
    turned = {"position_mm": position, "rotations": [{"axis": [0.3, 1, 0], "angle_deg": 20}]}
    return {"name": name, "mesh": mesh, "texture": texture, "pose": turned, **more}


def made_scenes(folder: Path) -> dict[str, dict[str, Any]]:
    """Write the files of some scenes into a folder, and return the scenes as plain values.

    Parameters
    ----------
    folder
        The folder, which exists.
    """
    noise = {"kind": "noise", "wavelength_mm": [3, 9], "spectrum_exponent": 0.5}
    checks = {"kind": "checkerboard", "square_mm": 5}
    plaid = {"kind": "plaid", "wavelength_mm": [7, 9], "amplitude": 0.3}
    curve = {"kind": "harmonic", "mean": 0.5, "amplitude": 2, "period_frames": 5}
    keyframes = {"kind": "keyframes", "times_frames": [-2, 0, 2], "values": [0, 1, 4]}
    _write_files(folder)
    square = {"kind": "file", "file": str(folder / "square_0.obj")}
    shapes = [
        _item(0, "cylinder", {"kind": "cylinder", "radius_mm": 11, "length_mm": 24, "caps": True}, checks),
        _item(1, "sphere", {"kind": "sphere", "radius_mm": 12, "resolution_mm": 2}, noise),
        _item(2, "cap", {"kind": "sphere", "radius_mm": 30, "cap_deg": 25, "resolution_mm": 2}, plaid),
        _item(3, "torus", {"kind": "torus", "ring_radius_mm": 9, "tube_radius_mm": 4}, noise),
        _item(4, "saddle", {"kind": "saddle", "size_mm": [24, 24], "curvature_per_mm": 0.02}, checks),
        _item(5, "stairs", {"kind": "stairs", "tread_mm": [8, 24], "steps_mm": [3, 3]}, noise),
        _item(6, "relief", {"kind": "relief", "size_mm": [26, 26], "amplitude_mm": 2, "wavelength_mm": [9, 13]}, plaid),
        _item(7, "box", {"kind": "box", "size_mm": [14, 14, 14]}, {"kind": "uniform", "radiance": 0.4}),
        _item(8, "textured", square, {"kind": "own"}),
        _item(9, "imaged", square, {"kind": "image", "file": str(folder / "picture.png"), "encoding": "srgb"}),
        _item(10, "leaf", {"kind": "leaf", "outline": "ovate", "length_mm": 26, "width_mm": 18}, {"kind": "leaf"}),
    ]
    plane = {"kind": "plane", "size_mm": [26, 26], "resolution_mm": 2}
    growth = {"kind": "growth", "rate_per_hour": 0.5, "base_to_tip": [1.5, 0.5], "base_mm": -13, "tip_mm": 13}
    series = {"kind": "meshes", "files": [str(folder / f"square_{number}.obj") for number in range(3)]}
    keyed = {"kind": "keyframes", "times_frames": [-1, 0, 1]}
    motions = [
        [{"kind": "acceleration", "velocity_mm_per_frame": [0.5, 0, 0], "acceleration_mm_per_frame2": [0, 0.3, 0]}],
        [{"kind": "rotation", "axis": [0, 0, 1], "rate_deg_per_frame": 2}],
        [{"kind": "exponential", "direction": [0, 0, 1], "amplitude_mm": 2, "time_constant_frames": 3}],
        [{"kind": "shift", "direction": [1, 0, 0], "distance_mm": curve}],
        [{"kind": "turn", "axis": [0, 1, 0], "angle_deg": keyframes}],
        [{**keyed, "positions_mm": [[0, 0, 0], [1, 0, 0], [1, 2, 0]]}],
        [
            {
                "kind": "nutation",
                "direction": [0, 1, 0],
                "towards": [1, 0, 0],
                "amplitudes_deg": [3, 2],
                "period_frames": 8,
                "point_mm": [0, 0, 600],
            }
        ],
    ]
    deformations = [
        [{"kind": "bending", "angle_deg": curve, "length_mm": 20, "from_mm": -10}],
        [growth],
        [{"kind": "hinge", "angle_deg": {"kind": "linear", "rate_per_frame": 2}}],
        [{"kind": "star", "amplitude_mm": 0.5, "period_mm": [6, 12]}],
        [{"kind": "unrolling", "length_mm": 26, "front_mm": 3, "radius_mm": 4}],
    ]
    moved = [_item(place, f"moved {place}", plane, noise, motion=one) for place, one in enumerate(motions)]
    formed = [
        _item(place + 7, f"formed {place}", plane, checks, deformation=one) for place, one in enumerate(deformations)
    ]
    formed[-1] = {**formed[-1], "mesh": {**plane, "resolution_mm": 1}}
    view = {
        "camera": {"width": 96, "height": 72, "focal_length_px": 380, "principal_point_px": [47, 36.5]},
        "stage": {"positions": 3, "baseline_mm": 6},
        "frames": {"count": 3, "frame_interval_s": 60},
        "render": {"backend": "raycast", "supersampling": 2},
        "sensor": {"noise_std": 0.01, "bit_depth": 8},
        "background": 0.1,
        "seed": 5,
    }
    from_files: list[dict[str, Any]] = [
        {"name": "series", "mesh": square, "texture": noise, "pose": {"position_mm": [-20, 0, 300]}},
        {"name": "still", "mesh": square, "texture": {"kind": "own"}, "pose": {"position_mm": [20, 0, 300]}},
    ]
    from_files[0]["deformation"] = [series]
    return {
        "shapes": {**view, "objects": shapes},
        "motions": {**view, "objects": [*moved, *formed]},
        "files": {**view, "objects": from_files},
    }


def _write_files(folder: Path) -> None:
    import numpy as np
    from PIL import Image

    y, x = np.mgrid[:16, :16]
    grey = (120 + 60 * np.sin(x) + 50 * np.cos(0.7 * y)).astype(np.uint8)
    Image.fromarray(grey).save(folder / "picture.png")
    (folder / "square.mtl").write_text("newmtl made\nmap_Kd picture.png\n", encoding="utf-8")
    for number in range(3):
        corners = [(-12, -12, 0), (12, -12, number), (12, 12, 0), (-12, 12, -number)]
        lines = ["mtllib square.mtl", *(f"v {a} {b} {c}" for a, b, c in corners)]
        lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "usemtl made", "f 1/1 3/3 2/2", "f 1/1 4/4 3/3"]
        (folder / f"square_{number}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
