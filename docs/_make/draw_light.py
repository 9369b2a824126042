"""Draw the pictures of gloss, transmission and bands: ``python docs/_make/draw_light.py``."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from PIL import Image

import scenetruth as st

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "how_to" / "scenes"
SMALLER = {"stage.positions": 1, "frames.count": 1, "sensor": "ideal", "render.backend": "raycast"}

RING = {
    "kind": "ring",
    "position_mm": [0, 0, 0],
    "direction": [0, 0, 1],
    "inner_radius_mm": 80,
    "radius_mm": 120,
    "irradiance": 1.2,
    "reference_distance_mm": 615,
}
ROSETTE = {
    "plants.0.texture.channel": "green",
    "plants.0.material": {"refractive_index": 1.5, "roughness": 0.2, "transmittance": 0.4, "reflectance": 0.6},
    "lighting": {"ambient": 0.12, "lights": [RING]},
}
"""Leaves with a wax layer under a ring lamp around the lens."""

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

PATCHES = (
    ((115, 82, 68), (194, 150, 130), (98, 122, 157), (87, 108, 67), (133, 128, 177), (103, 189, 170)),
    ((214, 126, 44), (80, 91, 166), (193, 90, 99), (94, 60, 108), (157, 188, 64), (224, 163, 46)),
    ((56, 61, 150), (70, 148, 73), (175, 54, 60), (231, 199, 31), (187, 86, 149), (8, 133, 161)),
    ((243, 243, 242), (200, 200, 200), (160, 160, 160), (122, 122, 121), (85, 85, 85), (52, 52, 52)),
)
"""Nominal sRGB values of the 24 patches of a ColorChecker (GretagMacbeth; Pascale 2006, BabelColor)."""

BANDS = ("red", "green", "blue")
CUBE = {
    "camera.bands": list(BANDS),
    "camera.focal_length_px": 4600,
    "objects.0.texture": {"kind": "image", "file": "chart.png", "encoding": "srgb"},
    "objects.0.pose.rotations": [
        {"axis": [0, 1, 0], "angle_deg": 28},
        {"axis": [1, 0, 0], "angle_deg": 20},
    ],
    "lighting": {
        "ambient": {"red": 0.1, "green": 0.16, "blue": 0.3},
        "lights": [{"kind": "directional", "direction": [0.8, 0.6, 1], "irradiance": 1.1}],
    },
}
"""A colour chart on every face of the cube, under a white lamp and bluish ambient light."""


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


def chart() -> NDArray[np.uint8]:
    """Return the picture of the colour chart: patches with a black border, in six columns and four rows."""
    patches = np.array(PATCHES, dtype=np.uint8).repeat(120, axis=0).repeat(80, axis=1)
    y, x = np.indices(patches.shape[:2])
    patches[(abs(y % 120 - 59.5) > 52) | (abs(x % 80 - 39.5) > 32)] = 0
    return patches


def srgb(radiance: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return radiance as sRGB values for display."""
    clipped = radiance.clip(0, 1)
    encoded: NDArray[np.floating] = np.where(clipped < 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return encoded


def draw_bands(target: str) -> None:
    """Draw the cube with colour charts: in colour, and every band."""
    with tempfile.TemporaryDirectory() as folder:
        Image.fromarray(chart()).save(file := Path(folder) / "chart.png")
        changes = {**SMALLER, **CUBE, "objects.0.texture.file": str(file)}
        recording, _ = st.simulate(st.load_scene("cube", overrides=changes))
    image = recording["image"].sel(s=0, t=0)
    height, width = image.shape[:2]
    figure, axes = plt.subplots(1, 4, figsize=(12.0, 3.0 * height / width + 0.42), layout="constrained")
    axes[0].imshow(srgb(image.values))
    axes[0].set_title("image", fontsize=13)
    for panel, band in zip(axes[1:], BANDS, strict=True):
        panel.imshow(srgb(image.sel(channel=band).values), cmap="gray", vmin=0, vmax=1)
        panel.set_title(band, fontsize=13)
    for panel in axes:
        panel.set_xticks([])
        panel.set_yticks([])
    figure.savefig(PICTURES / target, dpi=70)
    plt.close(figure)


if __name__ == "__main__":
    lit = {"lit fraction": "lit_fraction"}
    draw("rosette", "glossy_rosette.png", ROSETTE, {"share of specular light": "specular_share", **lit})
    draw("leaf", "backlit_leaf.png", LEAF, {"share of transmitted light": "transmitted_share", **lit})
    draw_bands("colour_chart.png")
