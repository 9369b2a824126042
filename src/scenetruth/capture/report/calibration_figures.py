"""Figures of a calibration: residuals, coverage of image and depth, error of the depth and its sources."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration import RigCalibration, RigFit, RigSolution
from scenetruth.capture.report.error_budget import DepthBudget
from scenetruth.capture.report.suggestions import PoseEffect, place_targets
from scenetruth.number_format import format_two_digits
from scenetruth.scoring.figures import FigureInfo
from scenetruth.scoring.figures.figure_style import (
    BLUE,
    GREY,
    ORANGE,
    VOID,
    colorbar,
    map_height,
    new_figure,
    pixel_axes,
    save,
    show_map,
    style,
)

__all__ = ["CalibrationData", "draw_calibration"]

Array = NDArray[np.float64]

_CELL_PX = 12  # cells of the map of residuals along the larger side
_LONGEST = 0.04
"""Length of the vector of a residual of three standard deviations, as a share of the image width."""
_SHOWN_VECTORS = 1500
_FEWEST_IN_CELL = 4
_TOO_FEW = "#b9bfc7"


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """Everything that the figures of a calibration show.

    ``surface_mm``: Depth range of the measured surface; None if it is unknown.
    """

    calibration: RigCalibration
    solution: RigSolution
    budget: DepthBudget
    poses: tuple[PoseEffect, ...]
    surface_mm: tuple[float, float] | None = None

    @property
    def fit(self) -> RigFit:
        """The fit of the calibration."""
        return self.solution.fit


def draw_calibration(data: CalibrationData, folder: Path) -> list[FigureInfo]:
    """Draw all figures of a calibration into an existing directory."""
    draws: list[Callable[[CalibrationData, Path], FigureInfo]] = [
        _draw_residuals, _draw_images, _draw_coverage, _draw_budget, _draw_depth_error,
    ]  # fmt: skip
    with style():
        return [draw(data, folder) for draw in draws]


def _draw_residuals(data: CalibrationData, folder: Path) -> FigureInfo:
    fit, calibration = data.fit, data.calibration
    pixels, residual, z = fit.given.pixels, fit.residuals_px, fit.z
    size = np.zeros((calibration.height, calibration.width))
    figure = new_figure(11.0, map_height(size, 4.7, 0.9))
    left, right = figure.subplots(1, 2)
    typical = float(np.sqrt((residual**2).mean()))
    factor = _LONGEST * calibration.width / (3 * typical)
    factor = float(f"{factor:.1g}")
    step = max(len(pixels) // _SHOWN_VECTORS, 1)
    chosen = np.s_[::step]
    left.quiver(
        *pixels[chosen].T, *(factor * residual[chosen]).T, np.hypot(*z[chosen].T), angles="xy", scale_units="xy",
        scale=1, width=0.0015, cmap="viridis", clim=(0, 3),
    )  # fmt: skip
    _frame(left, calibration)
    left.set_title(f"Residuals, {factor:g} times enlarged")
    cells = _cells(calibration)
    counts, total = (np.zeros(cells) for _ in range(2))
    places = tuple(
        np.clip(pixels[:, axis] / side * cells[1 - axis], 0, cells[1 - axis] - 1).astype(int)
        for axis, side in ((1, calibration.height), (0, calibration.width))
    )
    np.add.at(counts, places, 2.0)
    np.add.at(total, places, (z**2).sum(axis=1))
    mean = np.where(counts >= 2 * _FEWEST_IN_CELL, total / np.maximum(counts, 1), np.nan)
    extent = (-0.5, calibration.width - 0.5, calibration.height - 0.5, -0.5)
    drawn = show_map(right, np.log2(mean), extent=extent, cmap="RdBu_r", vmin=-2, vmax=2)
    # A colour that the scale lacks.
    right.set_facecolor(_TOO_FEW)
    right.set_title("Mean squared residual in units of its variance")
    _frame(right, calibration)
    bar = colorbar(figure, drawn, right, "", extend="both")
    bar.set_ticks([-2, -1, 0, 1, 2], labels=["1/4", "1/2", "1", "2", "4"])
    save(figure, folder / "residuals.png")
    factor_text = format_two_digits(calibration.variance_factor)
    return FigureInfo(
        "residuals.png", "Residuals of the calibration",
        f"Detected minus projected points, {format_two_digits(typical)} px "
        f"rms (at most {_SHOWN_VECTORS:,} are drawn); colours: "
        "length in standard deviations, from 0 (dark) "
        "to 3 (bright). Right: 1 if the stated noise explains the residuals; red regions are not described by the "
        f"model of the lens, or their light or sharpness differs; grey: fewer than {_FEWEST_IN_CELL} points. "
        f"Chi-squared per degree of freedom: {factor_text}. {_verdict(calibration.variance_factor)}",
    )  # fmt: skip


_AS_STATED = (0.7, 1.4)
"""Chi-squared per degree of freedom of residuals that the stated noise explains."""


def _verdict(factor: float) -> str:
    """Return the meaning of chi-squared per degree of freedom as a sentence."""
    if factor < _AS_STATED[0]:
        return (
            "The residuals are smaller than the stated noise: the standard deviations of the calibration are too large."
        )
    if factor > _AS_STATED[1]:
        return "The residuals are larger than the stated noise: the model of the lens, the board or a pose is in error."
    return "The stated noise explains the residuals."


def _cells(calibration: RigCalibration) -> tuple[int, int]:
    longer = max(calibration.width, calibration.height)
    rows, columns = (max(round(_CELL_PX * side / longer), 2) for side in (calibration.height, calibration.width))
    return rows, columns


def _frame(axes: Any, calibration: RigCalibration) -> None:
    axes.set_xlim(-0.5, calibration.width - 0.5)
    axes.set_ylim(calibration.height - 0.5, -0.5)
    axes.set_aspect("equal")
    pixel_axes(axes)


def _draw_images(data: CalibrationData, folder: Path) -> FigureInfo:
    """Draw the residuals of every image."""
    fit = data.fit
    views = [view for view in data.solution.observed.views if view.target == 0]
    squares = {view.name: view for view in fit.views}
    poses = list(dict.fromkeys(view.pose for view in views))
    count = len(fit.given.positions_mm)
    ratio, lost = np.full((count, len(poses)), np.nan), []
    for view in views:
        at = view.position, poses.index(view.pose)
        ratio[at] = np.sqrt(squares[view.name].mean_square)
        if not squares[view.name].consistent:
            lost.append(at)
    figure = new_figure(min(2.2 + 0.55 * len(poses), 11.0), 1.3 + 0.35 * count)
    axes = figure.subplots()
    drawn = show_map(axes, np.log2(ratio), cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes.set_facecolor(_TOO_FEW)
    for row, column in lost:
        axes.annotate("×", (column, row), ha="center", va="center", fontsize=14)
    axes.set_xticks(range(len(poses)), [str(pose) for pose in poses])
    axes.set_yticks(range(count), [f"{x:g}" for x in fit.given.positions_mm])
    axes.set_xlabel("pose of the board")
    axes.set_ylabel("position [mm]")
    axes.set_title("Residuals by image, in units of the stated noise")
    bar = figure.colorbar(drawn, ax=axes, extend="both", label="RMS")
    bar.set_ticks([-1, -0.5, 0, 0.5, 1], labels=["0.5", "0.7", "1", "1.4", "2"])
    bar.outline.set_linewidth(0.6)
    save(figure, folder / "board_images.png")
    text = (
        "1 if the stated noise explains the residuals. A row that stands out: a position that moved, a column: a pose "
    )
    text += "that moved or is not in focus. Grey: no image, or no board detected."
    if lost:
        text += " Crossed images contradict the others, and are not used."
    return FigureInfo("board_images.png", "Residuals by image", text)


def _draw_coverage(data: CalibrationData, folder: Path) -> FigureInfo:
    fit, calibration = data.fit, data.calibration
    size = np.zeros((calibration.height, calibration.width))
    figure = new_figure(11.0, map_height(size, 4.4, 0.9))
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    placed = place_targets(fit)
    depth = np.concatenate([placed[number][:, 2] for number in range(len(fit.given.views))])
    order = np.argsort(-depth)
    drawn = left.scatter(*fit.given.pixels[order].T, c=depth[order], s=3, cmap="cividis", linewidths=0)
    _frame(left, calibration)
    left.set_title("Points in the image")
    colorbar(figure, drawn, left, "distance [mm]")
    tilts = [pose.tilt_deg for pose in data.poses]
    for number, pose in enumerate(data.poses):
        views = [place for place, view in enumerate(fit.given.views) if view.pose == pose.pose]
        z = np.concatenate([placed[place][:, 2] for place in views])
        right.plot([number, number], [z.min(), z.max()], color=BLUE, linewidth=4, solid_capstyle="butt")
        label = f"{pose.tilt_deg:.0f}°"
        right.annotate(label, (number, z.max()), (0, 3), textcoords="offset points", ha="center", fontsize=8)
    if data.surface_mm is not None:
        right.axhspan(*data.surface_mm, color=ORANGE, alpha=0.25, linewidth=0, label="measured surface")
        right.legend(loc="lower right")
    right.set_xticks(range(len(data.poses)), [str(pose.pose) for pose in data.poses])
    right.set_xlabel("pose of the board")
    right.set_ylabel("distance [mm]")
    right.margins(x=0.05, y=0.12)
    right.grid(axis="y")
    right.set_title("Depth and tilt of the poses")
    save(figure, folder / "board_coverage.png")
    text = "Every point of the board in every image. Right: depth range of each pose, with its tilt"
    least = min(tilts, default=0.0)
    text += f" ({least:.0f} to {max(tilts, default=0.0):.0f}°; 35 to 40° determine the focal length best)"
    return FigureInfo("board_coverage.png", "Coverage of image and depth", text + ".")


def _draw_budget(data: CalibrationData, folder: Path) -> FigureInfo:
    budget = data.budget
    shown = [part for part in budget.parts if part.mean_mm > 0.01 * budget.total.mean_std]
    figure = new_figure(8.5, 1.1 + 0.32 * (len(shown) + 1))
    axes = figure.subplots()
    total = budget.total.mean_std
    for row, part in enumerate(shown):
        axes.barh(row, part.mean_mm, color=BLUE, height=0.65)
        text = f"{format_two_digits(part.mean_mm)}  (halved: total {format_two_digits(part.halved_mm)})"
        axes.annotate(text, (part.mean_mm, row), (5, 0), textcoords="offset points", va="center", fontsize=8)
    axes.barh(len(shown), total, color=GREY, height=0.65)
    axes.annotate(
        format_two_digits(total), (total, len(shown)), (5, 0), textcoords="offset points", va="center", fontsize=8
    )
    axes.set_yticks(range(len(shown) + 1), [*(part.title for part in shown), "root sum of squares"])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.25 * total)
    axes.set_xlabel("standard deviation of the mean depth [mm]")
    axes.set_title(f"Common error of the depth at {budget.depth_mm:.0f} mm by source")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    save(figure, folder / "depth_budget.png")
    text = "Contribution of every tolerance, of the noise of the points, and of the repeatability of new visits in the "
    text += (
        "measurement, to the error that all pixels have in common. In brackets: the total if the source were half as "
    )
    return FigureInfo("depth_budget.png", "Sources of the depth error", text + "large, with the calibration repeated.")


def _draw_depth_error(data: CalibrationData, folder: Path) -> FigureInfo:
    budget, calibration = data.budget, data.calibration
    size = np.zeros((calibration.height, calibration.width))
    figure = new_figure(11.0, map_height(size, 4.3, 0.9))
    panels = figure.subplots(1, 2)
    covariance = budget.total.covariance
    # Variance of the departure of each pixel from the mean over the image.
    rest = np.diag(covariance) - 2 * covariance.mean(axis=1) + covariance.mean()
    maps = (("Standard deviation", budget.total.std), ("Departure from the mean", np.sqrt(np.maximum(rest, 0.0))))
    x, y = (np.unique(budget.pixels[:, axis]) for axis in (0, 1))
    for axes, (title, values) in zip(panels, maps, strict=True):
        drawn = axes.contourf(x, y, values.reshape(budget.shape), levels=12, cmap="cividis")
        axes.set_facecolor(VOID)
        _frame(axes, calibration)
        axes.set_title(title)
        colorbar(figure, drawn, axes, "depth error [mm]")
    save(figure, folder / "depth_error.png")
    text = (
        f"Depth of a frontal plane at {budget.depth_mm:.0f} mm, by the calibration and by the repeatability with which "
        "the stage visits its positions again. Left: of each pixel. Right: of its difference from the mean depth, by "
        "which a map is tilted and bent."
    )
    return FigureInfo("depth_error.png", "Depth error over the image", text)
