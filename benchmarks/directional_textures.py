"""Errors of `refined` on textures of few directions, beside predictions: two or three cameras, two frames.

Run it from the top of the repository: ``python -m benchmarks.directional_textures [NAME ...] [--kept FILE]``; noise
textures of 4 to 20 px whose waves have directions within a sector around an angle to the image rows.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np

import scenetruth as st
from benchmarks.jobs import arguments, ends, heading, line, number
from benchmarks.trust import PIXEL_MM, plane, rig

__all__ = ["measure", "paint"]

SIDE, STEP_MM = 1024, 0.15
MARGIN_PX = 20
COLUMNS = ("sector", "quantity", "valid, %", "RMSE", "scaled median", "analytic", "maps", "beyond 6, %")
QUANTITIES = {"depth": None, "velocity_x": 0, "velocity_z": 2}


def paint(folder: Path, half_deg: float, angle_deg: float) -> str:
    """Write a noise texture whose waves are within ``half_deg`` of an angle, and return its path."""
    frequency = np.fft.fftfreq(SIDE) * PIXEL_MM / STEP_MM
    along, down = np.meshgrid(frequency, frequency)
    periods = np.hypot(along, down)
    off = (np.degrees(np.arctan2(down, along)) - angle_deg + 90) % 180 - 90
    band = (periods > 1 / 20) & (periods < 1 / 4) & (np.abs(off) <= half_deg)
    waves = np.fft.fft2(np.random.default_rng(3).normal(size=(SIDE, SIDE))) * band / np.maximum(periods, 1e-9)
    grey = np.fft.ifft2(waves).real
    file = folder / "texture.png"
    imageio.imwrite(file, (np.clip(0.5 + 0.15 * grey / grey.std(), 0, 1) * 65535).astype(np.uint16))
    return str(file)


def measure(half_deg: float, angle_deg: float, cameras: int, seed: int) -> dict[str, Any]:
    """Return errors and predictions by quantity."""
    with tempfile.TemporaryDirectory() as folder:
        texture = {"kind": "image", "file": paint(Path(folder), half_deg, angle_deg), "encoding": "linear"}
        sheet = plane(texture, mesh={"kind": "plane", "size_mm": [SIDE * STEP_MM] * 2})
        size = {"width": 160, "height": 120}
        scene = rig([sheet], camera=size, stage={"positions": cameras}, frames={"count": 2}, seed=seed)
        recording, truth = st.simulate(scene)
        both = {model: st.predict(scene, method="refined", model=model) for model in ("analytic", "maps")}
    estimate = st.estimate(recording, "refined", frames="all").isel(t=-1)
    exact = truth.sel(t=float(estimate["t"]))
    inner = np.zeros(estimate["depth"].shape, dtype=np.bool_)
    inner[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = True
    valid = inner & estimate["valid"].values
    found: dict[str, Any] = {}
    for name, component in QUANTITIES.items():
        quantity = name.partition("_")[0]
        parts = [estimate[quantity].values, exact[quantity].values, estimate[f"{quantity}_std"].values]
        values, true, std = parts if component is None else [each[component] for each in parts]
        error = np.abs(values - true)[valid]
        known = bool(error.size)
        found[name] = {
            "valid": float(valid.sum() / inner.sum()),
            "rmse": float(np.sqrt(np.mean(error**2))) if known else None,
            "median": float(1.4826 * np.median(error)) if known else None,
            "beyond": float(np.mean(error > 6 * std[valid])) if known else None,
            **{model: made.precision(name, "all").std for model, made in both.items()},
        }
    return found


def main() -> None:
    """Print errors and predictions by sector."""
    given = arguments(__doc__).parse_args()
    jobs = {
        f"± {half}° around {angle}°, {cameras} cameras, seed {seed}": (half, angle, cameras, seed)
        for half in (5, 10, 15, 20, 30, 45, 90)
        for angle in (45, -45, 0)
        for cameras, seed in ((2, 1), (2, 2), (3, 1))
        if half < 90 or angle == 0
    }
    print(heading(COLUMNS), flush=True)
    for name, found in ends(measure, jobs, given):
        for quantity, of in found.items():
            cells = [number(100 * of["valid"]), *(number(of[key]) for key in ("rmse", "median", "analytic", "maps"))]
            beyond = None if of["beyond"] is None else 100 * of["beyond"]
            print(line([name, quantity, *cells, number(beyond)]), flush=True)


if __name__ == "__main__":
    main()
