"""Predicted precision of glossy surfaces against the errors of ``refined``, as a table in Markdown.

Run from the top of the repository: ``python -m benchmarks.highlight_predictions``.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

import scenetruth as st
from benchmarks.jobs import heading, line
from scenetruth.design.prediction import predict, predict_quickly
from scenetruth.resources import limited_objects

FOCAL_LENGTH_PX, DISTANCE_MM, MARGIN_PX = 1200.0, 600.0, 10
SLANT_DEG = 10.0
MIRRORED = [float(np.sin(np.deg2rad(2 * SLANT_DEG))), 0.0, float(np.cos(np.deg2rad(2 * SLANT_DEG)))]
"""Direction of parallel light that the slanted plane reflects into the camera."""
SURFACES: dict[str, tuple[dict[str, Any], list[float], list[float]]] = {
    "plane": ({"kind": "plane", "size_mm": [150, 120]}, [0, 0, DISTANCE_MM], MIRRORED),
    "leaf": (
        {"kind": "leaf", "outline": "ovate", "length_mm": 70, "width_mm": 55, "fold_deg": 10},
        [-35, 0, DISTANCE_MM],
        [0, 0, 1],
    ),
}
"""Mesh, position, and direction of parallel light."""
ROUGHNESS = (0.0, 0.1, 0.2, 0.4, 0.6)
"""0 for matt surfaces."""


def lamp(kind: str, direction: list[float]) -> dict[str, Any]:
    """Return parallel light, a point lamp close to the surface, or a ring in front of the camera."""
    if kind == "parallel":
        return {"kind": "directional", "direction": direction, "irradiance": 0.8}
    if kind == "point":
        place = {"position_mm": [0, 0, DISTANCE_MM - 120], "reference_distance_mm": 120}
        return {"kind": "point", "irradiance": 0.6, **place}
    ring = {"kind": "ring", "position_mm": [0, 0, 100], "target_mm": [0, 0, DISTANCE_MM], "irradiance": 0.8}
    return ring | {"inner_radius_mm": 35, "radius_mm": 50, "reference_distance_mm": 500}


def scene(surface: str, kind: str, roughness: float) -> dict[str, Any]:
    """Return a moving surface with gloss in the light of a lamp."""
    mesh, place, direction = SURFACES[surface]
    px = DISTANCE_MM / FOCAL_LENGTH_PX
    item: dict[str, Any] = {
        "name": "surface",
        "mesh": mesh,
        "texture": {"kind": "noise", "wavelength_mm": [5 * px, 20 * px], "mean": 0.35},
        "pose": {"position_mm": place},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.3, 0.1, -0.2]}],
    }
    if surface == "plane":
        item["pose"]["rotations"] = [{"axis": [0, 1, 0], "angle_deg": SLANT_DEG}]
    if roughness:
        item["material"] = {"refractive_index": 1.5, "roughness": roughness}
    return {
        "camera": {"width": 160, "height": 120, "focal_length_px": FOCAL_LENGTH_PX},
        "stage": {"positions": 5, "baseline_mm": 3.0},
        "frames": {"count": 5},
        "lighting": {"ambient": 0.15, "lights": [lamp(kind, direction)]},
        "objects": [item],
        "background": 0.1,
        "sensor": {"noise_std": 0.005, "bit_depth": 12, "full_scale_radiance": 1.6},
        "score": {"interior_margin_px": MARGIN_PX},
    }


def measured(surface: str, kind: str, roughness: float) -> list[str]:
    """Return the share of specular light, and RMSE by predicted RMSE: of Z as matt, analytic, maps; of U_X; of U_Z."""
    plain = scene(surface, kind, roughness)
    known = st.Scene.from_dict(plain)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        recording, truth = st.simulate(plain, truth_content="complete_with_light")
        estimate = st.estimate(recording, "refined").isel(t=0)
    truth = truth.sel(t=estimate["t"])
    inner = (truth["object_id"].values == 0) & (truth["boundary_distance"].values >= MARGIN_PX)
    valid = inner & estimate["valid"].values.astype(bool)
    error = estimate - truth
    predictions = {
        "matt": predict_quickly(known, limited_objects(known, st.Limits()), "refined"),
        "analytic": predict(known, method="refined"),
        "maps": predict(known, method="refined", model="maps"),
    }
    cells = [f"{100 * np.nanmean(truth['specular_share'].values[inner]):.0f}", f"{100 * valid.sum() / inner.sum():.0f}"]
    for name, values in (
        ("depth", error["depth"]),
        ("velocity_x", error["velocity"].sel(component="X")),
        ("velocity_z", error["velocity"].sel(component="Z")),
    ):
        rms = float(np.sqrt(np.mean(values.values[valid] ** 2)))
        chosen = predictions if name == "depth" else {"maps": predictions["maps"]}
        cells += [f"{rms / one.precision(name, 'object_surface').rmse:.2f}" for one in chosen.values()]
    return cells


def main() -> None:
    """Print the table."""
    columns = ["specular, %", "valid, %", "Z, as matt", "Z, analytic", "Z, maps", "U_X, maps", "U_Z, maps"]
    print(heading(["surface", "lamp", "roughness", *columns]))
    for surface in SURFACES:
        for kind in ("point", "parallel", "ring"):
            for roughness in ROUGHNESS:
                cells = measured(surface, kind, roughness)
                print(line([surface, kind, f"{roughness:g}" if roughness else "matt", *cells]), flush=True)


if __name__ == "__main__":
    main()
