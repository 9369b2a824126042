"""Draw the pictures of docs/explanation/structure_tensor.md: images of a point, and eigenvalues of the tensor.

Run ``python docs/_make/draw_method.py [FOLDER]``; without an argument the SVGs in docs/_static are made. The same
version of matplotlib writes the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GREY, BLUE, RED, GREEN = "#222222", "#767676", "#1f5fa8", "#b5322a", "#2c7a3f"

# The drawn set-up, with five stage positions in mm and an approaching point.
FOCAL_PX, BASELINE_MM, POSITIONS = 40.0, 5.0, np.arange(-2, 3)
POINT_MM, VELOCITY_MM = np.array([6.0, 100.0]), np.array([2.0, -4.0])


def image_of(s: np.ndarray | float, t: np.ndarray | float) -> np.ndarray:
    """Return x in px of the drawn point in camera s at time t."""
    x, z = POINT_MM[0] + VELOCITY_MM[0] * np.asarray(t), POINT_MM[1] + VELOCITY_MM[1] * np.asarray(t)
    return np.asarray(FOCAL_PX * (x - BASELINE_MM * np.asarray(s)) / z)


def draw_rig(axes: Axes) -> None:
    """Draw the stage from above, the point at three times, and the rays to it at t = 0."""
    depth = 26.0
    axes.plot([-13, 13], [0, 0], color=GREY, lw=4, solid_capstyle="butt")
    for s in POSITIONS:
        x = BASELINE_MM * s
        axes.plot([x, POINT_MM[0]], [0, depth], color=BLUE if s == 0 else GREY, lw=1.3 if s == 0 else 0.7)
        axes.plot(x, 0, "s", color=INK if s == 0 else "#d9d9d9", markeredgecolor=INK, ms=8)
        axes.text(x, -1.6, f"{s:+d}".replace("-", "−") if s else "s = 0", ha="center", va="top")
    step = np.array([2.4, -2.6])
    for t in (-1, 0, 1):
        here = np.array([POINT_MM[0], depth]) + step * t
        axes.plot(*here, "o", color=RED, ms=7 if t == 0 else 5, alpha=1.0 if t == 0 else 0.6)
        axes.text(here[0] + 0.9, here[1] + 0.3, f"t = {t:+d}".replace("-", "−") if t else "t = 0", color=RED)
    axes.set(xlim=(-14, 16), ylim=(-7, 31), aspect="equal", title="Seen from above")
    axes.text(0, -4.2, "stage, $X_s = V_X\\,s$", ha="center", va="top", color=INK)
    axes.axis("off")


def draw_line(axes: Axes, over: str) -> None:
    """Draw x of the image points over s or over t, with the line of the linear model."""
    numbers = np.linspace(-2.2, 2.2, 45)
    images = image_of(numbers, 0.0) if over == "s" else image_of(0.0, numbers)
    first = image_of(0.0, 0.0)
    if over == "s":
        slope, colour, title = -FOCAL_PX * BASELINE_MM / POINT_MM[1], BLUE, "Along the stage: slope $v_x$"
    else:
        slope = (FOCAL_PX * VELOCITY_MM[0] - first * VELOCITY_MM[1]) / POINT_MM[1]
        colour, title = RED, "In time: slope $u_x + u_z x$"
    axes.plot(first + slope * numbers, numbers, color=GREY, lw=1, ls="--", label="linear model")
    axes.plot(images, numbers, color=colour, lw=1.6, label="exact")
    axes.plot(image_of(POSITIONS, 0.0) if over == "s" else image_of(0.0, POSITIONS), POSITIONS, "o", color=colour, ms=5)
    axes.set(xlabel="$x$ in px", ylabel="$s$" if over == "s" else "$t$ in frames", title=title, yticks=POSITIONS)
    axes.legend(loc="upper right" if over == "s" else "upper left", frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)


def rig() -> Figure:
    """Return the picture of the rig and of the image points."""
    figure = Figure(figsize=(10.5, 3.7), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.1, 1, 1])
    draw_rig(left)
    draw_line(middle, "s")
    draw_line(right, "t")
    return figure


def tensor_of(texture: str) -> np.ndarray:
    """Return the eigenvalues of the structure tensor over a window, largest first, relative to their sum.

    Gradients are those of a synthetic texture that moves as the model says, with a little noise.
    """
    generator = np.random.default_rng(5)
    count = 4000
    xi, eta = generator.uniform(-1, 1, (2, count))
    g_x, g_y = generator.normal(size=(2, count)) * {"both": (1, 1), "edge": (1, 0), "none": (0, 0)}[texture][0]
    g_y = g_y if texture == "both" else np.zeros(count)
    v_x, u_x, u_y, u_z = -0.4, 0.3, 0.2, 0.1
    g_z = xi * g_x + eta * g_y
    d = np.stack([g_x, g_y, g_z, -v_x * g_x, -(u_x * g_x + u_y * g_y + u_z * g_z)])
    d += 0.02 * generator.normal(size=d.shape)
    return np.linalg.eigvalsh(d @ d.T / count)[::-1]


def eigenvalues() -> Figure:
    """Return the picture of eigenvalues for three textures."""
    figure = Figure(figsize=(10.5, 2.9), layout="constrained")
    threshold = 3e-3
    titles = {"both": "texture: 3 above", "edge": "an edge: 2 above", "none": "no texture: none above"}
    for axes, (texture, title) in zip(figure.subplots(1, 3, sharey=True), titles.items(), strict=True):
        values = tensor_of(texture)
        colours = [GREEN if value > threshold else GREY for value in values]
        axes.bar(range(1, 6), values, color=colours, width=0.6, bottom=1e-5)
        axes.axhline(threshold, color=RED, lw=1.2, ls="--")
        axes.text(5.45, threshold * 1.15, "$\\tau$", color=RED, ha="right", va="bottom")
        axes.set(yscale="log", ylim=(1e-5, 4), title=title, xticks=range(1, 6))
        axes.set_xticklabels([f"$\\lambda_{n}$" for n in range(1, 6)])
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def main(folder: Path) -> None:
    """Write both pictures."""
    style = {"font.size": 11, "svg.hashsalt": "scenetruth", "axes.titlesize": 11, "text.color": INK}
    with mpl.rc_context(style):
        for name, make in (("method_rig", rig), ("method_eigenvalues", eigenvalues)):
            make().savefig(folder / f"{name}.svg", metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "_static")
