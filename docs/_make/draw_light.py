"""Draw the pictures of gloss and transmission, with maps of light: ``python docs/_make/draw_light.py``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import scenetruth as st

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "how_to" / "scenes"
SMALLER = {"stage.positions": 1, "frames.count": 1, "sensor": "ideal", "render.backend": "raycast"}

SPOT = {
    "kind": "spot",
    "position_mm": [-40, -60, 150],
    "target_mm": [0, 0, 620],
    "inner_angle_deg": 12,
    "outer_angle_deg": 18,
    "irradiance": 1.2,
    "reference_distance_mm": 500,
}
ROSETTE = {
    "plants.0.texture.channel": "green",
    "plants.0.material": {"refractive_index": 1.5, "roughness": 0.2, "transmittance": 0.4, "reflectance": 0.6},
    "lighting": {"ambient": 0.12, "lights": [SPOT]},
}
"""Leaves with a wax layer under a spot lamp."""

BAR = {
    "name": "bar",
    "mesh": {"kind": "plane", "size_mm": [9, 44]},
    "pose": {"position_mm": [-2, -4, 625], "rotations": [{"axis": [0, 0, 1], "angle_deg": 25}]},
    "texture": {"kind": "uniform", "radiance": 0.05},
}
LEAF = {
    "objects.0.material": {"preset": "leaf", "transmittance": 0.6, "reflectance": 0.4},
    "objects.1": BAR,
    "lighting": {"ambient": 0.08, "lights": [{"kind": "directional", "direction": [0.1, -0.2, -1], "irradiance": 1.4}]},
    "background": 0.0,
}
"""A leaf with a lamp behind it, and a bar between lamp and leaf."""


def shown(name: str, changes: Mapping[str, Any]) -> tuple[xr.DataArray, xr.Dataset]:
    """Return the reference image of a scene with these changes, and its ground truth."""
    scene = st.load_scene(name, overrides={**SMALLER, **changes})
    recording, truth = st.simulate(scene, truth_content="complete_with_light")
    return recording["image"].sel(s=0, t=0), truth.sel(t=0)


def draw(name: str, target: str, changes: Mapping[str, Any], maps: Mapping[str, str]) -> None:
    """Draw the image of a scene, and maps of its light by title."""
    image, truth = shown(name, changes)
    height, width = image.shape
    size = 12.0, 12.0 / (1 + len(maps)) * height / width + 0.42
    figure, axes = plt.subplots(1, 1 + len(maps), figsize=size, layout="constrained")
    axes[0].imshow(image, cmap="gray", vmin=0, vmax=float(np.percentile(image, 99.8)))
    axes[0].set_title("image", fontsize=13)
    for panel, (title, variable) in zip(axes[1:], maps.items(), strict=True):
        drawn = panel.imshow(truth[variable], cmap="viridis", vmin=0, vmax=1, interpolation="nearest")
        panel.set_title(title, fontsize=13)
        panel.set_facecolor("0.85")
        figure.colorbar(drawn, ax=panel, shrink=0.85, pad=0.015, ticks=(0, 0.5, 1))
    for panel in axes:
        panel.set_xticks([])
        panel.set_yticks([])
    figure.savefig(PICTURES / target, dpi=70)
    plt.close(figure)


if __name__ == "__main__":
    lit = {"lit fraction": "lit_fraction"}
    draw("rosette", "glossy_rosette.png", ROSETTE, {"share of specular light": "specular_share", **lit})
    draw("leaf", "backlit_leaf.png", LEAF, {"share of transmitted light": "transmitted_share", **lit})
