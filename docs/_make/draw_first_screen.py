"""Draw the picture of the README: a growing rosette, three maps of its truth, and the error of an estimate."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import scenetruth as st

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "first_screen.png"
FEW = ("frames.count=5", "stage.positions=5", "render.backend=raycast")
METHOD = {"noise": "estimated"}


def main() -> None:
    """Render the rosette, estimate, and draw one image with its truth and the error of depth."""
    scene = st.load_scene(ROOT / "scenes" / "rosette.yaml", overrides=FEW)
    recording, truth = st.simulate(scene)
    found = st.estimate(recording, "refined", METHOD).sel(t=0)
    image, truth = recording["image"].sel(s=0, t=0), truth.sel(t=0)
    hours_per_frame = scene.frames.frame_interval_s / 3600
    motion_um = 1000 * truth["velocity"].sel(component="Z").values
    growth = 100 / hours_per_frame * truth["growth_rate"].values

    figure, axes = plt.subplots(1, 5, figsize=(17, 3.72), layout="constrained")
    bright = image.values / recording.attrs["full_scale"]
    panel(axes[0], bright, "image", "fraction of full scale", "gray", (0.0, float(np.percentile(bright, 99.9))))
    # The bench under the pot is deeper; the scale is chosen for the plant.
    depth = truth["depth"].values
    plant = depth[growth > 0]
    panel(axes[1], depth, "depth $Z$", "mm", "viridis_r", (float(plant.min()), float(plant.max()) + 10), "max")
    panel(axes[2], motion_um, "motion in depth $U_Z$", "µm/frame", "RdBu_r", around_zero(motion_um), "both")
    panel(axes[3], growth, "areal growth rate", "%/h", "magma", (0.0, float(np.percentile(growth, 99.8))), "max")
    valid = (growth > 0) & (found["status"].values == 2)
    off_um = 1000 * np.where(valid, found["depth"].values - depth, np.nan)
    panel(axes[4], off_um, "depth, estimate minus truth", "µm", "RdBu_r", around_zero(off_um, 90.0), "both")
    figure.savefig(PICTURE, dpi=104)


def around_zero(values: NDArray[np.float64], percentile: float = 99.5) -> tuple[float, float]:
    """Return limits symmetric about zero that exclude values beyond a percentile."""
    limit = float(np.nanpercentile(np.abs(values), percentile))
    return -limit, limit


def panel(
    axes: plt.Axes,
    values: NDArray[np.floating],
    title: str,
    units: str,
    colours: str,
    limits: tuple[float, float],
    beyond: str = "neither",
) -> None:
    """Draw one map with its colour bar; ``beyond`` sets the sides on which values exceed it."""
    low, high = limits
    shown = axes.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation="antialiased")
    axes.set_title(title, fontsize=16)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("0.85")
    bar = axes.figure.colorbar(shown, ax=axes, location="bottom", shrink=0.92, pad=0.02, aspect=28, extend=beyond)
    bar.set_label(units, fontsize=14)
    bar.ax.tick_params(labelsize=13)
    bar.ax.locator_params(nbins=5)


if __name__ == "__main__":
    main()
