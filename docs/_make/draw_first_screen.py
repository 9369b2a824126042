"""Draw the moving picture of the README: a nodding, growing rosette, its truth, and an estimate with its errors."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from PIL import Image

import scenetruth as st

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "first_screen.png"
# Leaves nod once an hour: the last frame leads to the first.
PERIOD, STEP, MARGIN = 60, 5, 2
SMALL = {
    "camera.width": 480,
    "camera.height": 360,
    "camera.focal_length_px": 2175,
    "frames.count": PERIOD + 2 * MARGIN + 1,
    "plants.0.nutation_deg": 4,
    "plants.0.nutation_period_frames": PERIOD,
}
METHOD = {"noise": "estimated"}
HOLD_MS = 180
# Levels of the colour maps in the palette of all frames; 256 in all.
LEVELS = {"gray": 46, "viridis_r": 70, "RdBu_r": 70, "magma": 70}


def main() -> None:
    """Render an hour of growth, estimate every fifth frame, and draw images, truth and estimates as one animation."""
    scene = st.load_scene(ROOT / "scenes" / "rosette.yaml", overrides=SMALL)
    recording, truth = st.simulate(scene)
    hours = scene.frames.frame_interval_s / 3600
    shown = [draw(recording, truth, int(truth["t"][0]) + MARGIN + first, hours) for first in range(0, PERIOD, STEP)]
    frames = [one.quantize(palette=palette(), dither=Image.Dither.NONE) for one in shown]
    frames[0].save(PICTURE, save_all=True, append_images=frames[1:], duration=HOLD_MS, loop=0, optimize=True)


def palette() -> Image.Image:
    """Return a picture whose palette has the colours of all maps, each in steps too small to be seen."""
    colours = [mpl.colormaps[name](np.linspace(0, 1, count))[:, :3] for name, count in LEVELS.items()]
    found = Image.new("P", (1, 1))
    found.putpalette(np.rint(255 * np.concatenate(colours)).astype(np.uint8).tobytes())
    return found


def draw(recording: xr.Dataset, truth: xr.Dataset, t: int, hours_per_frame: float) -> Image.Image:
    """Return one frame of the animation."""
    around = recording.sel(t=slice(t - MARGIN, t + MARGIN))
    found = st.estimate(around.assign_coords(t=around["t"] - t), "refined", METHOD).sel(t=0)
    truth = truth.sel(t=t)
    bright = recording["image"].sel(s=0, t=t).values / recording.attrs["full_scale"]
    growth = 100 / hours_per_frame * truth["growth_rate"].values
    depth = truth["depth"].values
    valid = (growth > 0) & (found["status"].values == 2)
    off_um = 1000 * np.where(valid, found["depth"].values - depth, np.nan)
    motion_um = 1000 * truth["velocity"].sel(component="Z").values

    figure, rows = plt.subplots(2, 3, figsize=(9.6, 6.9), layout="constrained")
    axes = rows.ravel()
    panel(axes[0], bright, "image", "of full scale", "gray", (0.0, 0.8))
    # The bench under the pot is deeper; the scale is chosen for the plant.
    panel(axes[1], depth, "true depth", "mm", "viridis_r", (580, 640))
    panel(axes[2], motion_um, "true motion in depth", "µm per frame", "RdBu_r", (-400, 400))
    panel(axes[3], growth, "true growth", "% of area per hour", "magma", (0.0, 4.0))
    panel(axes[4], off_um, "error of an estimate", "µm of depth", "RdBu_r", (-300, 300))
    axes[5].axis("off")
    minutes = round(60 * hours_per_frame * (t + PERIOD // 2))
    caption = f"{minutes:2d} min of 60\n\n5 camera positions;\ndepth, motion and growth\nof every pixel are exact"
    axes[5].text(0.5, 0.55, caption, ha="center", va="center", fontsize=19, linespacing=1.5)
    with io.BytesIO() as file:
        figure.savefig(file, dpi=100, format="png")
        plt.close(figure)
        return Image.open(file).convert("RGB")


def panel(
    axes: plt.Axes, values: NDArray[np.floating], title: str, units: str, colours: str, limits: tuple[float, float]
) -> None:
    """Draw one map with its colour bar."""
    low, high = limits
    shown = axes.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation="antialiased")
    # Legible in a column of 375 px.
    axes.set_title(title, fontsize=19)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("0.85")
    bar = axes.figure.colorbar(shown, ax=axes, location="bottom", shrink=0.92, pad=0.02, aspect=24)
    bar.set_label(units, fontsize=17)
    bar.set_ticks([low, (low + high) / 2, high])
    bar.ax.tick_params(labelsize=17)


if __name__ == "__main__":
    main()
