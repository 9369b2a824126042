"""Draw docs/reference/conventions.svg: the camera on its stage, its image, and the pixel grid.

Run ``python docs/_make/draw_conventions.py [FILE ...]``; without arguments that SVG is written. The same
version of matplotlib writes the same bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

INK, GREY, BLUE, RED, GREEN = "#222222", "#8a8a8a", "#1f5fa8", "#b5322a", "#2c7a3f"
CAMERA_FILL, IMAGE_FILL, SURFACE_FILL = "#d9d9d9", "#eaf1fa", "#f3ead6"

Step = Callable[[Axes], None]

# The drawn set-up, in arbitrary units of length.
FOCAL, BASELINE = 2.2, 2.4
POINT = np.array([0.9, -1.2, 9.0])
VELOCITY = np.array([1.8, 1.0, -2.4])


def oblique(point: tuple[float, float, float] | np.ndarray) -> np.ndarray:
    """Project a world point (X right, Y down, Z forward) onto the paper."""
    x, y, z = point
    return np.array([x + 0.62 * z, -y + 0.40 * z])


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str = INK, width: float = 1.4) -> None:
    """Draw an arrow between two points of the paper."""
    axes.annotate(
        "",
        xy=(float(end[0]), float(end[1])),
        xytext=(float(start[0]), float(start[1])),
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0},
    )


def line(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str, style: str = "-", width: float = 1.0) -> None:
    """Draw a line between two points of the paper."""
    axes.plot([start[0], end[0]], [start[1], end[1]], color=colour, linestyle=style, linewidth=width)


def image_point(s: int, point: np.ndarray = POINT) -> np.ndarray:
    """Return where the ray from camera s to a point meets the plane Z = f."""
    origin = np.array([BASELINE * s, 0.0, 0.0])
    return np.asarray(origin + (point - origin) * FOCAL / point[2])


def draw_stage(axes: Axes) -> None:
    """Draw the stage, its five camera positions, the world frame, and one surface point."""
    line(axes, oblique((-2.6 * BASELINE, 0, 0)), oblique((2.6 * BASELINE, 0, 0)), GREY, width=5)
    for s in range(-2, 3):
        centre = oblique((BASELINE * s, 0, 0))
        reference = s == 0
        body = Rectangle((centre[0] - 0.28, centre[1] - 0.2), 0.56, 0.4, zorder=3)
        body.set(facecolor=INK if reference else CAMERA_FILL, edgecolor=INK, linewidth=1)
        axes.add_patch(body)
        label = "s = 0\nreference" if reference else f"s = {s:+d}".replace("-", "−")
        # The label of the reference camera leaves space for the axis Y.
        axes.text(centre[0] - (0.12 if reference else 0), centre[1] - 0.42, label, va="top",
                  ha="right" if reference else "center")  # fmt: skip
    low = -1.75
    left, right = oblique((BASELINE, 0, 0)), oblique((2 * BASELINE, 0, 0))
    for end in (left, right):
        line(axes, np.array([end[0], -0.85]), np.array([end[0], low - 0.1]), GREY, width=0.7)
    axes.annotate("", xy=(right[0], low), xytext=(left[0], low),
                  arrowprops={"arrowstyle": "<|-|>", "color": GREY, "shrinkA": 0, "shrinkB": 0})  # fmt: skip
    axes.text((left[0] + right[0]) / 2, low - 0.12, "baseline $V_X$", ha="center", va="top", color=INK)
    axes.text(-2.6 * BASELINE, 0.28, "linear stage, $X_s = V_X\\,s$", ha="left", va="bottom", color=INK)
    origin = oblique((0, 0, 0))
    for tip, name, shift in (
        ((1.5, 0, 0), "X", (0.02, -0.30)),
        ((0, 1.9, 0), "Y", (0.24, 0.0)),
        ((0, 0, 15.4), "Z", (0.25, 0.1)),
    ):
        if name == "Z":
            # The axis is hidden behind the surface.
            hidden, again = oblique((0, 0, 9.5)), oblique((0, 0, 13.8))
            line(axes, origin, hidden, BLUE, width=1.8)
            line(axes, hidden, again, BLUE, ":", width=1.4)
            arrow(axes, again, oblique(tip), BLUE, 1.8)
        else:
            arrow(axes, origin, oblique(tip), BLUE, 1.8)
        end = oblique(tip) + shift
        axes.text(end[0], end[1], name, color=BLUE, fontsize=12, fontweight="bold", ha="center", va="center")


def draw_surface(axes: Axes) -> None:
    """Draw the surface, its point P with its velocity, and the rays to two cameras with their image planes."""
    across, down = np.array([1.0, 0.0, -0.35]), np.array([0.0, 1.0, 0.15])
    corners = [POINT + a * across + b * down for a, b in ((-2.6, -1.5), (2.6, -1.5), (2.6, 1.5), (-2.6, 1.5))]
    patch = Polygon([oblique(corner) for corner in corners], closed=True, zorder=0)
    patch.set(facecolor=SURFACE_FILL, edgecolor=INK, linewidth=1)
    axes.add_patch(patch)
    for share in np.linspace(-1, 1, 9)[1:-1]:
        for one, other, reach, size in ((across, down, 2.6, 1.5), (down, across, 1.5, 2.6)):
            middle = POINT + share * reach * one
            start, end = oblique(middle - size * other), oblique(middle + size * other)
            axes.plot([start[0], end[0]], [start[1], end[1]], color="#d6c7a3", linewidth=0.7, zorder=0)
    point = oblique(POINT)
    axes.plot(*oblique((0, 0, FOCAL)), "+", color=INK, markersize=9, zorder=4)
    for s, colour in ((0, RED), (1, GREEN)):
        centre = np.array([BASELINE * s, 0.0, FOCAL])
        lower_left = oblique(centre + np.array([-0.95, 0.7, 0.0]))
        frame = Rectangle((lower_left[0], lower_left[1]), 1.9, 1.4, zorder=1)
        frame.set(facecolor=IMAGE_FILL, edgecolor=INK, linewidth=1)
        axes.add_patch(frame)
        hit = oblique(image_point(s))
        line(axes, oblique((BASELINE * s, 0, 0)), hit, colour, ":")
        line(axes, hit, point, colour)
        axes.plot(*hit, "o", color=colour, markersize=5, zorder=4)
    axes.plot(*point, "o", color=INK, markersize=6, zorder=5)
    axes.text(point[0] - 0.2, point[1] + 0.2, "$P = (X, Y, Z)$", ha="right", va="bottom", fontsize=11)
    tip = oblique(POINT + VELOCITY)
    arrow(axes, point, tip, INK, 2.0)
    axes.text(tip[0] + 0.15, tip[1] - 0.05, "$U = (U_X, U_Y, U_Z)$, mm per frame\nhere $U_Z < 0$: approaching",
              ha="left", va="top")  # fmt: skip
    edge = oblique((-0.95, -0.7, FOCAL))
    axes.text(edge[0] - 0.15, edge[1] + 0.05, "image at\n$Z = f$", ha="right", va="top")


def draw_image(axes: Axes) -> None:
    """Draw an image of 12 x 8 pixels with the image points of cameras 0 and 1, and the flow."""
    width, height = 12, 8
    for column in range(width + 1):
        axes.plot([column - 0.5] * 2, [-0.5, height - 0.5], color="#c9d3df", linewidth=0.7)
    for row in range(height + 1):
        axes.plot([-0.5, width - 0.5], [row - 0.5] * 2, color="#c9d3df", linewidth=0.7)
    frame = Rectangle((-0.5, -0.5), width, height, fill=False)
    frame.set(edgecolor=INK, linewidth=1.2)
    axes.add_patch(frame)
    for x, y in ((0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)):
        axes.plot(x, y, ".", color=INK, markersize=6)
    axes.text(-0.7, 0, "(0, 0)", ha="right", va="center")
    axes.text(width - 0.3, 0, "(W−1, 0)", ha="left", va="center")
    axes.text(-0.7, height - 1, "(0, H−1)", ha="right", va="center")
    axes.text(width - 0.3, height - 1, "(W−1, H−1)", ha="left", va="center")
    arrow(axes, np.array([1.6, -1.2]), np.array([4.0, -1.2]), BLUE)
    axes.text(4.2, -1.2, "x, columns", color=BLUE, ha="left", va="center")
    arrow(axes, np.array([-1.5, 1.4]), np.array([-1.5, 3.8]), BLUE)
    axes.text(-1.5, 4.1, "y, rows", color=BLUE, ha="center", va="top")
    c_x, c_y = (width - 1) / 2, (height - 1) / 2
    axes.plot(c_x, c_y, "+", color=INK, markersize=11, markeredgewidth=1.5)
    axes.text(c_x, c_y + 0.55, "$(c_x, c_y) = (\\frac{W-1}{2}, \\frac{H-1}{2})$", ha="center", va="top", fontsize=11)
    first, second, moved = np.array([8.0, 1.6]), np.array([3.0, 1.6]), np.array([10.4, 2.4])
    arrow(axes, first, second + np.array([0.18, 0.0]), GREY)
    axes.text((first[0] + second[0]) / 2, first[1] - 0.25, "disparity $d = f\\,V_X / Z > 0$", ha="center", va="bottom")
    arrow(axes, first, moved, INK)
    axes.text(9.5, 2.6, "flow (dx/dt, dy/dt)", ha="center", va="top")
    axes.plot(*first, "o", color=RED, markersize=6)
    axes.plot(*second, "o", color=GREEN, markersize=6)
    axes.text(first[0] + 0.2, first[1] - 0.25, "$x_0$, seen by s = 0", color=RED, ha="left", va="bottom")
    axes.text(second[0], second[1] + 0.3, "$x_1 = x_0 - d$\nseen by s = +1", color=GREEN, ha="center", va="top")


def draw_row(axes: Axes) -> None:
    """Draw one row of four pixels with coordinates relative to pixel centres, and to the image corner."""
    for column in range(4):
        cell = Rectangle((column - 0.5, 0), 1, 0.8)
        cell.set(facecolor=IMAGE_FILL, edgecolor=INK, linewidth=1)
        axes.add_patch(cell)
        axes.plot(column, 0.4, ".", color=INK, markersize=6)
        axes.text(column, 0.95, str(column), ha="center", va="bottom", color=BLUE)
    axes.text(-0.85, 0.95, "scenetruth, OpenCV", ha="right", va="bottom", color=BLUE)
    axes.text(1.5, 1.62, "centre 1.5 = (W−1)/2", ha="center", va="bottom", color=BLUE)
    for border in range(5):
        axes.plot([border - 0.5] * 2, [-0.12, 0], color=INK, linewidth=1)
        axes.text(border - 0.5, -0.2, str(border), ha="center", va="top", color=RED)
    axes.text(-0.85, -0.2, "OpenGL, pyrender", ha="right", va="top", color=RED)
    axes.text(1.5, -0.85, "centre 2.0 = W/2", ha="center", va="top", color=RED)
    axes.plot([1.5, 1.5], [0, 0.8], color=INK, linewidth=1, linestyle="--")
    axes.text(4.0, 0.4, "one row, W = 4: integers are pixel centres (blue),\nor pixel borders (red)", va="center")


def draw() -> Figure:
    """Return the drawing."""
    figure = Figure(figsize=(10, 12), facecolor="white")
    parts: tuple[tuple[str, tuple[float, float], tuple[float, float, float, float], tuple[Step, ...]], ...] = (
        ("The camera on its stage", (0.50, 0.465), (-6.6, 12.2, -2.3, 6.7), (draw_stage, draw_surface)),
        ("The image of the reference camera", (0.16, 0.325), (-3.4, 14.6, 7.7, -1.9), (draw_image,)),
        ("Two definitions of pixel coordinates", (0.005, 0.12), (-4.6, 10.8, -1.3, 2.1), (draw_row,)),
    )
    for title, (bottom, height), limits, steps in parts:
        axes = figure.add_axes((0.02, bottom, 0.96, height))
        for step in steps:
            step(axes)
        axes.set(xlim=limits[:2], ylim=limits[2:])
        axes.set_aspect("equal")
        axes.axis("off")
        figure.text(0.02, bottom + height, title, fontsize=12, fontweight="bold", va="bottom")
    return figure


def main(files: list[str]) -> None:
    """Write the drawing to files in the formats of their suffixes."""
    mpl.rcParams.update({"svg.hashsalt": "scenetruth", "svg.fonttype": "path", "font.family": "DejaVu Sans",
                         "font.size": 10, "text.color": INK})  # fmt: skip
    for file in files or [str(Path(__file__).parents[1] / "reference" / "conventions.svg")]:
        metadata = {"Date": None} if file.endswith(".svg") else None
        draw().savefig(file, metadata=metadata, dpi=110)


if __name__ == "__main__":
    main(sys.argv[1:])
