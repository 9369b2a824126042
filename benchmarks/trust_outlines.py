"""Surfaces before others, with and without texture; errors by the distance to outlines.

``python -m benchmarks.trust_outlines [NAME ...] [--held-out]`` prints the share of the valid pixels that are wrong: off
in depth by more than 6 standard deviations and by more than a thousandth, and off in velocity by more than 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import scenetruth as st
from benchmarks.jobs import ends, heading, line, number
from benchmarks.trust import DEPTH_MM, Plain, family, noise, parse_arguments, plane, rig, simulated

__all__ = ["GROUPS", "SCENES", "assess_bands"]

BANDS_PX = ((0.0, 2.0), (2.0, 5.0), (5.0, 12.0), (12.0, np.inf))
COLUMNS = (
    "scene",
    "distance, px",
    "pixels",
    "valid, %",
    "wrong depth, %",
    "off by 1 mm, %",
    "beyond 6: Z, %",
    "X, Y, Z",
)
BLANK: Plain = {"kind": "uniform", "radiance": 0.5}


def before(front: Plain, wall: Plain, gap_mm: float = 60.0, **changes: Any) -> Plain:
    """Return a scene of a square before a wall; further keys change the square."""
    square = plane(
        front,
        **{
            "name": "square",
            "mesh": {"kind": "plane", "size_mm": [26, 22]},
            "pose": {"position_mm": [0, 0, DEPTH_MM - gap_mm], "rotations": [{"axis": [0, 0, 1], "angle_deg": 12}]},
            "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.1, 0.05, -0.1]}],
            **changes,
        },
    )
    return rig([square, plane(wall)])


def disc(front: Plain, wall: Plain, gap_mm: float = 40.0) -> Plain:
    """Return a scene of a ball before a wall."""
    mesh, pose = {"kind": "sphere", "radius_mm": 14}, {"position_mm": [3, 2, DEPTH_MM - gap_mm + 14]}
    return before(front, wall, gap_mm, mesh=mesh, pose=pose)


SCENES: dict[str, Plain] = {
    "square, blank wall": before(noise(4, 20), BLANK),
    "square, textured wall": before(noise(4, 20), noise(5, 24)),
    "square, blank wall far": before(noise(4, 20), BLANK, 150.0),
    "blank square, textured wall": before(BLANK, noise(4, 20)),
    "ball, blank wall": disc(noise(4, 20), BLANK),
    "ball, textured wall": disc(noise(4, 20), noise(5, 24)),
    "weak square, strong wall": before(noise(4, 20, 0.06), noise(4, 20)),
    "square, weak wall": before(noise(4, 20), noise(4, 20, 0.04)),
    "coarse square, blank wall": before(noise(8, 40), BLANK, 30.0),
}

GROUPS: dict[str, str] = {
    "surfaces before others": r"",
}
"""Rows of the summary, and what the names of their scenes contain."""


def assess_bands(scene: Plain, settings: Plain, cache: str | None) -> dict[str, dict[str, float]]:
    """Return the shares of valid and of wrong pixels by the distance to the nearest outline."""
    recording, truth = simulated(scene, cache)
    estimate = st.estimate(recording, "refined", **settings)
    truth = truth.sel(t=estimate["t"])
    distance, seen = truth["boundary_distance"].values, np.isfinite(truth["depth"].values)
    off = np.abs(estimate["depth"].values - truth["depth"].values)
    depth_z = off / np.maximum(estimate["depth_std"].values, 1e-300)
    velocity = [np.zeros_like(off)] * 3
    if "velocity" in estimate:
        moved = np.abs(estimate["velocity"].values - truth["velocity"].values)
        axis = estimate["velocity"].dims.index("component")
        velocity = list(np.moveaxis(moved / np.maximum(estimate["velocity_std"].values, 1e-300), axis, 0))
    found: dict[str, dict[str, float]] = {}
    for low, high in (*BANDS_PX, (0.0, np.inf)):
        among = seen & (distance >= low) & ((distance < high) | (high == np.inf))
        valid = among & (estimate["status"].values == 2)
        wrong = (depth_z > 6) & (off > 1e-3 * truth["depth"].values)
        share = {"wrong": wrong, "millimetre": off > 1.0, "depth": depth_z > 6}
        share |= {name: each > 6 for name, each in zip("xyz", velocity, strict=True)}
        found[f"{low:g} to {high:g}"] = {
            "pixels": float(among.sum()),
            "valid": float(valid.sum() / max(among.sum(), 1)),
            **{name: float(each[valid].mean()) if valid.any() else float("nan") for name, each in share.items()},
        }
    return found


def main() -> None:
    """Print a table with a line for each scene and distance."""
    given, settings = parse_arguments(__doc__)
    scenes: dict[str, Plain] = {}
    for module in ("trust_outlines", "trust_shipped"):
        of_family: Mapping[str, Plain] = family(module)
        scenes |= {name: scene for n, (name, scene) in enumerate(of_family.items()) if (n % 3 == 2) == given.held_out}
    print(heading(COLUMNS), flush=True)
    for name, bands in ends(assess_bands, {n: (scene, settings, given.cache) for n, scene in scenes.items()}, given):
        for band, of in bands.items():
            shares = [number(100 * of[each]) for each in ("valid", "wrong", "millimetre", "depth")]
            motion = " / ".join(number(100 * of[each]) for each in "xyz")
            print(line([name, band, f"{of['pixels']:.0f}", *shares, motion]), flush=True)


if __name__ == "__main__":
    main()
