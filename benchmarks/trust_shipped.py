"""The shipped scenes, of which the middle part of the images is taken: half as wide and half as high."""

from __future__ import annotations

from pathlib import Path

import yaml

from benchmarks.trust import Plain

__all__ = ["GROUPS", "SCENES"]

FOLDER = Path(__file__).parents[1] / "scenes"
LARGEST_PX = (320, 240)


def cropped(name: str) -> Plain:
    """Return a scene with smaller images, in which a pixel is as large as before."""
    scene: Plain = yaml.safe_load((FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))
    camera = scene["camera"]
    for side, largest in zip(("width", "height"), LARGEST_PX, strict=True):
        camera[side] = min(camera[side], largest)
    scene.pop("estimate", None)
    return scene


NAMES = (
    "cube",
    "leaf",
    "relief",
    "occluders",
    "plane",
    "rosette",
    "windy_leaf",
    "seedling",
    "unrolling",
    "rubber_sheet",
    "cube_spotlight",
    "star",
    "plaid",
)
SCENES: dict[str, Plain] = {name: cropped(name) for name in NAMES}

GROUPS: dict[str, str] = {
    "shipped scenes": r"",
}
"""Rows of the summary, and what the names of their scenes contain."""
