"""Draw the gallery of scenes: reference image, depth, velocity and growth."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from rich.progress import track

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.simulation import make_truth

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "reference" / "gallery"
HEADER = """# Scene gallery

All bundled scenes. Each picture shows the reference image, depth, the velocity along the optical axis, and the velocity
across it (colour: magnitude; arrows: direction). Without motion across the axis, the last panel shows the optical flow;
where growth varies over the surface, it shows the areal growth rate. `scenetruth run NAME -o outputs/NAME` runs a
scene, from the checkout or installed; `make gallery` redraws the pictures.
"""

LIGHT = """## Light and colour

Bundled scenes with other [materials and lamps](../how_to/scenes/light_and_materials.md#maps-of-light), with maps of \
light, and with [bands](../how_to/scenes/colour.md) (`python docs/_make/draw_light.py`).

![Glossy rosette under a ring lamp: image, share of specular light, lit fraction](../how_to/scenes/glossy_rosette.png)

![Backlit leaf: image, share of transmitted light, lit fraction](../how_to/scenes/backlit_leaf.png)

![Cube with colour charts: image, and its bands red, green and blue](../how_to/scenes/colour_chart.png)
"""


def comment_of(file: Path) -> str:
    """Return the leading comment of a scene file."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    return " ".join(lines)


def see(scene: Scene) -> tuple[NDArray[np.float32], xr.Dataset]:
    """Return the reference image and its truth."""
    only = scene.model_copy(
        update={
            "frames": scene.frames.model_copy(update={"count": 1}),
            "stage": scene.stage.model_copy(update={"positions": 1}),
        }
    )
    world: BuiltScene = build_scene(scene, ROOT)
    with RaycastRenderer(world, scene.camera, scene.background, 4, scene.lighting) as renderer:
        image = renderer.render(0.0, Viewpoint.on_axis(0.0))
    return image, make_truth(only).sel(t=0)


def draw(image: NDArray[np.float32], truth: xr.Dataset, hours_per_frame: float, target: Path) -> None:
    """Draw the row of pictures of a scene."""
    height, width = image.shape
    figure, axes = plt.subplots(1, 4, figsize=(12.8, 12.8 / 4 * height / width + 0.42), layout="constrained")
    panel(axes[0], image, "image", "gray", (0.0, float(np.percentile(image, 99.8))))
    panel(axes[1], truth["depth"].values, "depth Z, mm", "viridis_r")
    velocity = truth["velocity"].values
    largest = float(np.nanmax(np.abs(velocity)))
    along = spread(velocity[2], largest)
    panel(axes[2], velocity[2], "U_Z, mm/frame", "RdBu_r", along)
    growth = truth["growth_rate"].values * 100
    # Uniform growth is not shown as a map.
    if float(np.nanmax(growth) - np.nanmin(growth)) > max(1e-9, 0.01 * float(np.nanmax(np.abs(growth)))):
        # At intervals of seconds, the quantity is strain rather than growth.
        slow = hours_per_frame >= 1 / 60
        growth, units = (growth / hours_per_frame, "%/h") if slow else (growth, "%/frame")
        panel(axes[3], growth, f"growth rate, {units}", "RdBu_r", spread(growth, 0.0))
    elif float(np.nanmax(np.hypot(*velocity[:2]))) > 1e-6 * largest:
        arrows(axes[3], velocity[:2], "(U_X, U_Y), mm/frame")
    else:
        arrows(axes[3], truth["flow"].values, "flow, px/frame")
    figure.savefig(target, dpi=100)
    plt.close(figure)


def arrows(axes: plt.Axes, vectors: NDArray[np.float64], title: str) -> None:
    """Draw a vector map: lengths as colours, directions as arrows."""
    height, width = vectors.shape[1:]
    lengths = np.hypot(*vectors)
    longest = float(np.nanmax(lengths))
    panel(axes, lengths, title, "magma", (0.0, max(longest, 1e-9)))
    step = max(width // 20, 8)
    y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    moving = lengths[y, x] > 0.05 * longest
    y, x = y[moving], x[moving]
    if len(x) and longest > 1e-9:
        # A length in pixels that is independent of the number of moving pixels.
        size = {"angles": "xy", "scale_units": "xy", "scale": 0.8 / step}
        shown = vectors[:, y, x] / longest
        axes.quiver(x, y, *shown, **size, color="white", edgecolor="black", linewidth=0.4, width=0.005)


def spread(values: NDArray[np.float64], largest: float) -> tuple[float, float]:
    """Return limits symmetric about zero; those of the largest values if the values are only rounding errors."""
    limit = float(np.nanpercentile(np.abs(values), 99.5))
    limit = limit if limit > 1e-6 * largest else max(largest, 1e-12)
    return -limit, limit


def panel(
    axes: plt.Axes, values: NDArray[np.floating], title: str, colours: str, limits: tuple[float, float] | None = None
) -> None:
    """Draw one map with its colour bar."""
    low, high = limits or (None, None)
    shown = axes.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    axes.set_title(title, fontsize=13)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("0.85")
    if colours != "gray":
        scale = axes.figure.colorbar(shown, ax=axes, shrink=0.85, pad=0.015, ticks=MaxNLocator(4))
        scale.ax.tick_params(labelsize=11)


def main(names: list[str]) -> None:
    """Draw all scenes, or the given scenes, and write the page."""
    files = sorted((ROOT / "scenes").glob("*.yaml"))
    PICTURES.mkdir(exist_ok=True)
    for file in track([file for file in files if not names or file.stem in names], "gallery"):
        scene = st.load_scene(file)
        image, truth = see(scene)
        draw(image, truth, scene.frames.frame_interval_s / 3600, PICTURES / f"{file.stem}.png")
    parts = [HEADER]
    for file in files:
        description = re.sub(r"\s+", " ", comment_of(file))
        title = f"[{file.stem}](../../scenes/{file.name})"
        picture = f"![The scene {file.stem}: image, depth, and how it moves](gallery/{file.stem}.png)"
        parts.append(f"## {title}\n\n{description}\n\n{picture}\n")
    (ROOT / "docs" / "reference" / "scene_gallery.md").write_text("\n".join([*parts, LIGHT]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
