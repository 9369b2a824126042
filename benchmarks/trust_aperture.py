"""Textures in one direction, repetitive textures with and without a weak second texture, and controls of many kinds."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.trust import PIXEL_MM, Plain, noise, plane, rig
from benchmarks.trust_textures import checkers, turned

__all__ = ["GROUPS", "SCENES"]

Values = NDArray[np.float64]
SHEET_MM, TEXELS = 150.0, 2400
PER_PX = TEXELS * PIXEL_MM / SHEET_MM


def pattern(name: str, values: Callable[[Values, Values], Values]) -> Plain:
    """Return an image texture of a sheet, from its values at columns and rows in pixels of the camera."""
    import imageio.v3 as imageio

    file = Path(tempfile.gettempdir()) / "scenetruth_trust_patterns" / f"{name}.png"
    if not file.exists():
        file.parent.mkdir(exist_ok=True)
        y, x = np.mgrid[:TEXELS, :TEXELS] / PER_PX
        grey = np.clip(values(x, y), 0.0, 1.0)
        imageio.imwrite(file, np.rint(65535 * grey).astype(np.uint16))
    return {"kind": "image", "file": str(file)}


def waves(at: Values, shortest_px: float, longest_px: float, seed: int) -> Values:
    """Return a sum of 60 waves of one dimension, of standard deviation 1."""
    generator = np.random.default_rng(seed)
    lengths = np.exp(generator.uniform(np.log(shortest_px), np.log(longest_px), 60))
    phases = generator.uniform(0, 2 * np.pi, 60)
    # Evaluated once for every different place.
    places, index = np.unique(at, return_inverse=True)
    line = np.cos(2 * np.pi * places[:, None] / lengths + phases).sum(axis=1) / np.sqrt(30)
    return np.asarray(line[index.reshape(at.shape)])


def speckle(x: Values, smooth_px: float, seed: int) -> Values:
    """Return smoothed noise of standard deviation 1."""
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(np.random.default_rng(seed).normal(size=x.shape), smooth_px * PER_PX, mode="wrap")
    return np.asarray(values / values.std())


def lines(at: Values, period_px: float, width_px: float) -> Values:
    """Return soft lines of height 1 at each period."""
    return np.asarray(np.exp(-0.5 * ((at / period_px + 0.5) % 1.0 - 0.5) ** 2 * (period_px / width_px) ** 2))


def one_dimensional(angle_deg: float, shortest_px: float = 4.0, longest_px: float = 40.0, **sensor: Any) -> Plain:
    """Return a scene of noise that varies in one direction."""
    seed = round(angle_deg) + 1
    texture = pattern(
        f"noise_{angle_deg:g}_{shortest_px:g}", lambda x, y: 0.5 + 0.12 * waves(x, shortest_px, longest_px, seed)
    )
    scene = turned(texture, angle_deg)
    return {**scene, "sensor": {**scene["sensor"], **sensor}}


def stripes_with(contrast: float, angle_deg: float, period_px: float = 10.0) -> Plain:
    """Return a scene of stripes with a weak speckle over them."""
    texture = pattern(
        f"stripes_{contrast:g}_{period_px:g}",
        lambda x, y: 0.5 + 0.2 * np.cos(2 * np.pi * x / period_px) + contrast * speckle(x, 1.5, 3),
    )
    return turned(texture, angle_deg)


def slanted(texture: Plain, angle_deg: float, slant_deg: float) -> Plain:
    """Return a scene of a sheet that is turned in the image and slanted about the y axis."""
    rotations = [{"axis": [0, 0, 1], "angle_deg": angle_deg}, {"axis": [0, 1, 0], "angle_deg": slant_deg}]
    mesh = {"kind": "plane", "size_mm": [SHEET_MM, SHEET_MM]}
    return rig([plane(texture, mesh=mesh, pose={"position_mm": [0, 0, 600], "rotations": rotations})])


def veins(period_px: float, contrast: float) -> Plain:
    """Return a scene of parallel veins on a blade with a weak texture."""
    texture = pattern(
        f"veins_{period_px:g}_{contrast:g}",
        lambda x, y: 0.4 + 0.25 * lines(x, period_px, 1.2) + contrast * speckle(x, 2.0, 5),
    )
    return turned(texture, 20)


def bricks(width_px: float, height_px: float, contrast: float) -> Plain:
    """Return a scene of bricks, every other row displaced by half a brick."""

    def values(x: Values, y: Values) -> Values:
        row = np.floor(y / height_px)
        joints = np.maximum(lines(x + 0.5 * width_px * (row % 2), width_px, 1.0), lines(y, height_px, 1.0))
        return np.asarray(0.35 + 0.35 * joints + contrast * speckle(x, 1.5, 7))

    return turned(pattern(f"bricks_{width_px:g}_{height_px:g}_{contrast:g}", values), 0)


def two_periods(first_px: float, second_px: float) -> Plain:
    """Return a scene with two periods along each axis."""

    def values(x: Values, y: Values) -> Values:
        each = [np.cos(2 * np.pi * at / period) for at in (x, y) for period in (first_px, second_px)]
        return np.asarray(0.5 + 0.09 * np.sum(each, axis=0))

    return turned(pattern(f"periods_{first_px:g}_{second_px:g}", values), 5)


def board() -> Plain:
    """Return a scene of a checkerboard of 12 x 8 squares of 8 px in front of a textured wall."""
    wall = plane(
        noise(4, 20), name="wall", pose={"position_mm": [0, 0, 640]}, mesh={"kind": "plane", "size_mm": [130, 100]}
    )
    texture = {"kind": "checkerboard", "square_mm": 8 * PIXEL_MM, "radiances": [0.3, 0.7]}
    mesh = {"kind": "plane", "size_mm": [96 * PIXEL_MM, 64 * PIXEL_MM]}
    return rig([wall, plane(texture, mesh=mesh)])


def bars() -> Plain:
    """Return a scene of textured bars in front of a textured wall."""
    still = [{"kind": "velocity", "velocity_mm_per_frame": [0.05, 0, -0.1]}]
    wall = plane(
        noise(4, 20), name="wall", pose={"position_mm": [0, 0, 660]}, mesh={"kind": "plane", "size_mm": [130, 100]}
    )
    bars_ = [
        plane(
            noise(4, 20),
            name=f"bar {number}",
            mesh={"kind": "plane", "size_mm": [9, 120]},
            pose={"position_mm": [x_mm, 0, 600], "rotations": [{"axis": [0, 0, 1], "angle_deg": angle}]},
            motion=[{"kind": "velocity", "velocity_mm_per_frame": [0.2, 0, 0]}],
        )
        for number, (x_mm, angle) in enumerate(((-15, 8), (12, -14)))
    ]
    return rig([{**wall, "motion": still}, *bars_])


def natural(contrast: float = 0.25, exponent: float = -2.0) -> Plain:
    """Return the texture of natural images, whose power falls with the frequency."""
    return {**noise(3, 120, contrast), "spectrum_exponent": exponent}


def sphere(texture: Plain) -> Plain:
    """Return a scene of a sphere."""
    return rig([plane(texture, mesh={"kind": "sphere", "radius_mm": 30}, pose={"position_mm": [0, 0, 630]})])


SCENES: dict[str, Plain] = {
    "one-dimensional noise 0 deg": one_dimensional(0),
    "one-dimensional noise 20 deg": one_dimensional(20),
    "one-dimensional noise 35 deg": one_dimensional(35),
    "one-dimensional noise 50 deg": one_dimensional(50),
    "one-dimensional noise 70 deg, 2 % noise": one_dimensional(70, noise_std=0.02),
    "one-dimensional noise 90 deg": one_dimensional(90),
    "stripes with speckle of 0.01": stripes_with(0.01, 15),
    "stripes with speckle of 0.004": stripes_with(0.004, 30),
    "stripes with speckle of 0.02": stripes_with(0.02, 0),
    "stripes with speckle of 0.05": stripes_with(0.05, 40),
    "slanted stripes": slanted(stripes_with(0.0, 0)["objects"][0]["texture"], 45, 40),
    "slanted checkers": slanted(checkers(8, 0)["objects"][0]["texture"], 10, 35),
    "veins of 14 px": veins(14, 0.01),
    "veins of 9 px, bare": veins(9, 0.0),
    "veins of 20 px": veins(20, 0.02),
    "bricks": bricks(16, 8, 0.0),
    "bricks with speckle": bricks(20, 10, 0.03),
    "bricks, large": bricks(28, 14, 0.01),
    "two periods of 9 and 13 px": two_periods(9, 13),
    "two periods of 7 and 11 px": two_periods(7, 11),
    "two periods of 8 and 12 px": two_periods(8, 12),
    "board before a wall": board(),
    "control bars": bars(),
    "control natural": rig([plane(natural())]),
    "control natural, weak": rig([plane(natural(0.06))], sensor={"noise_std": 0.003}),
    "control sphere": sphere(noise(4, 20)),
    "control natural sphere": sphere(natural()),
    "control weak, 2 % noise": rig([plane(noise(4, 20, 0.06))], sensor={"noise_std": 0.02}),
    "control 8 % noise": rig([plane(noise(4, 20))], sensor={"noise_std": 0.08}),
    "control 8 bit": rig([plane(noise(4, 20, 0.1))], sensor={"bit_depth": 8, "noise_std": 0.002}),
    "control blurred": rig([plane({**noise(6, 40), "spectrum_exponent": -4})]),
    "control slanted": slanted(noise(4, 20), 30, 45),
    "control natural, 3 % noise": rig([plane(natural())], sensor={"noise_std": 0.03}),
    "slanted checkers of 7 px": slanted(checkers(7, 0)["objects"][0]["texture"], 20, 30),
    "slanted checkers of 10 px": slanted(checkers(10, 0)["objects"][0]["texture"], 35, 25),
    "slanted checkers of 6 px": slanted(checkers(6, 0)["objects"][0]["texture"], 5, 40),
}

GROUPS: dict[str, str] = {
    "textures of one direction": r"one-dimensional|stripes|veins",
    "bricks, boards, two periods": r"bricks|board|periods|checkers",
    "controls: natural, slanted, noisy": r"control",
}
"""Rows of the summary, and what the names of their scenes contain."""
