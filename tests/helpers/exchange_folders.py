"""Reads the folders that programs are given, with other means than those that write them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def camera_in(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "camera.json").read_text()))


def images_in(folder: Path) -> NDArray[np.float64]:
    """Return the values of all images, shape (s, t, y, x[, channel]), as camera.json says that they follow."""
    camera = camera_in(folder)
    read = {"png": _png, "tiff": _tiff}
    form = camera["image_format"]
    if form == "npy":
        numbers = np.load(folder / "images.npy")
    else:
        names = [[f"s{s:+d}_t{t:+d}.{form}" for t in camera["t"]] for s in camera["s"]]
        numbers = np.array([[read[form](folder / name) for name in row] for row in names])
    return np.asarray(camera["image_offset"] + camera["image_scale"] * numbers.astype(np.float64))


def masks_in(folder: Path) -> NDArray[np.bool_]:
    """Return all masks, shape (s, t, y, x), after what camera.json lists."""
    camera = camera_in(folder)
    found = np.zeros((len(camera["s"]), len(camera["t"]), camera["height_px"], camera["width_px"]), dtype=bool)
    for name in camera["exclusion_masks"]:
        if name == "exclusion_mask.npy":
            return np.asarray(np.load(folder / name) != 0)
        s, t = (int(part[1:]) for part in name.removeprefix("exclusion_mask_").removesuffix(".png").split("_"))
        found[camera["s"].index(s), camera["t"].index(t)] = _png(folder / name) != 0
    return found


def _png(file: Path) -> NDArray[Any]:
    import cv2

    values = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert values is not None
    # OpenCV counts colours from the blue one.
    return np.asarray(values[..., ::-1] if values.ndim == 3 else values)


def _tiff(file: Path) -> NDArray[Any]:
    import imageio.v3 as imageio

    return np.asarray(imageio.imread(file))
