"""Figures of the noise of a capture: of the sensor, its fixed patterns, and standard deviations of the depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.image_reading import FrameMoments
from scenetruth.capture.radiometry import SensorNoise
from scenetruth.number_format import format_number
from scenetruth.scoring.figures import FigureInfo
from scenetruth.scoring.figures.figure_style import (
    BLUE,
    GREY,
    ORANGE,
    colorbar,
    map_height,
    new_figure,
    pixel_axes,
    robust_limits,
    save,
    show_map,
    style,
    void_legend,
)

__all__ = ["draw_depth_std", "draw_noise", "noise_words", "split_std"]

Array = NDArray[np.float64]

_BINS = 24
_LEAST_IN_BIN = 50
_COLOURS = {"dark": "#000000", "flat": BLUE, "static": ORANGE}


def draw_noise(folder: CaptureFolder, noise: SensorNoise | None, target: Path) -> list[FigureInfo]:
    """Draw the noise of the frames of a capture into an existing directory; nothing without repeated frames."""
    sets = {
        name: [each for level in frames.levels if (each := frames.moments(level)).mean.ndim == 2]
        for name, frames in folder.sets.items()
    }
    repeated = {name: [each for each in found if each.count > 1] for name, found in sets.items()}
    found = []
    with style():
        if any(repeated.values()):
            found.append(_draw_transfer(repeated, noise, target))
        patterns = {name: maps[0].mean for name in ("dark", "flat") if (maps := sets.get(name))}
        if "flat" in patterns:
            level = folder.flat_level()
            patterns["flat"] = patterns["flat"] if level is None else folder.light_of_flat(level)
        if patterns:
            found.append(_draw_patterns(patterns, target))
    return found


def noise_words(folder: CaptureFolder, noise: SensorNoise | None) -> list[str]:
    """Return the measured noise as lines, or what is missing for it."""
    if noise is not None:
        return noise.describe()
    lacking = [name for name in ("dark", "flat") if name not in folder.sets]
    if not lacking:
        return ["The frames do not determine the noise: two dark frames and two flat fields at least are required."]
    return [f"Not measured: add {' and '.join(f'files.{name}' for name in lacking)}."]


def _draw_transfer(sets: dict[str, list[FrameMoments]], noise: SensorNoise | None, target: Path) -> FigureInfo:
    figure = new_figure(7.5, 4.0)
    axes = figure.subplots()
    highest = 0.0
    for name, levels in sets.items():
        for number, moments in enumerate(levels):
            mean, variance, std = _binned(moments)
            if len(mean) == 0:
                continue
            highest = max(highest, float(mean.max()))
            axes.errorbar(
                mean, variance, 2 * std, fmt="o", markersize=3, linewidth=0.8, color=_COLOURS[name],
                label=None if number else f"{name} frames",
            )  # fmt: skip
    if noise is not None and np.isfinite(noise.gain_dn_per_e):
        grey = np.linspace(noise.black_level_dn, highest, 50)
        label = f"K = {noise.gain_dn_per_e:.4g} DN per electron"
        axes.plot(grey, noise.variance_dn2(grey), color=GREY, linewidth=1.2, label=label)
    axes.set_xlabel("mean grey value [DN]")
    axes.set_ylabel("temporal variance [DN²]")
    axes.set_title("Photon transfer")
    axes.set_ylim(bottom=0)
    axes.grid()
    axes.legend()
    save(figure, target / "photon_transfer.png")
    text = "Temporal variance of pixels with nearly the same mean, with two standard deviations. "
    if noise is not None and np.isfinite(noise.gain_dn_per_e):
        text += (
            "Linear sensors lie on the line, by which every pixel of a board image is weighted. A bend shows gamma, a "
            "fall at the right end saturation."
        )
    else:
        text += "No gain is determined: all pixels of a board image have the same weight."
    return FigureInfo("photon_transfer.png", "Noise of the sensor", text)


def _binned(moments: FrameMoments) -> tuple[Array, Array, Array]:
    """Return mean, temporal variance and its standard uncertainty of pixels grouped by their mean."""
    mean, variance = moments.mean.ravel(), moments.variance.ravel()
    order = np.argsort(mean, kind="stable")
    groups = [group for group in np.array_split(order, _BINS) if len(group) >= _LEAST_IN_BIN]
    rows = [(mean[g].mean(), variance[g].mean(), variance[g].std() / np.sqrt(len(g))) for g in groups]
    found = np.array(rows).reshape(-1, 3)
    return found[:, 0], found[:, 1], found[:, 2]


def _draw_patterns(patterns: dict[str, Array], target: Path) -> FigureInfo:
    first = next(iter(patterns.values()))
    figure = new_figure(5.6 * len(patterns), map_height(first, 4.3, 0.9))
    panels = figure.subplots(1, len(patterns), squeeze=False)[0]
    texts = []
    for axes, (name, values) in zip(panels, patterns.items(), strict=True):
        shown, label, title = _pattern(name, values)
        low, high = robust_limits(shown)
        drawn = show_map(axes, shown, cmap="cividis", vmin=low, vmax=high)
        axes.set_title(title)
        pixel_axes(axes)
        colorbar(figure, drawn, axes, label, extend="both")
        unit = "" if name == "flat" else " DN"
        texts.append(f"{title.lower()}: {format_number(low)} to {format_number(high)}{unit}")
    save(figure, target / "fixed_patterns.png")
    text = (
        f"Removed from every image by the correction ({'; '.join(texts)} for 98 % of the pixels). The flat field shows "
    )
    text += "vignetting, dust and uneven light."
    return FigureInfo("fixed_patterns.png", "Fixed patterns", text)


def _pattern(name: str, values: Array) -> tuple[Array, str, str]:
    if name == "dark":
        return np.asarray(values - values.mean()), "DN", "Dark frame less its mean"
    return np.asarray(values / values.mean()), "", "Flat field over its mean"


def split_std(frame: xr.Dataset) -> dict[str, Array]:
    """Return the standard deviations of the depth of a frame: of single pixels, and in common with all pixels."""
    if "depth_std" not in frame:
        return {}
    whole = frame["depth_std"].values.astype(np.float64)
    if "depth_std_common" not in frame:
        return {"of single pixels": whole}
    common = frame["depth_std_common"].values.astype(np.float64)
    return {"of single pixels": np.sqrt(np.maximum(whole**2 - common**2, 0.0)), "in common": common}


def draw_depth_std(estimate: xr.Dataset, target: Path) -> list[FigureInfo]:
    """Draw the standard deviations of the depth of the middle frame; nothing if the estimate has none."""
    parts = split_std(estimate.isel(t=estimate.sizes["t"] // 2))
    if not any(np.isfinite(values).any() for values in parts.values()):
        return []
    first = next(iter(parts.values()))
    with style():
        figure = new_figure(5.6 * len(parts), map_height(first, 4.3, 1.1))
        panels = figure.subplots(1, len(parts), squeeze=False)[0]
        for axes, (title, values) in zip(panels, parts.items(), strict=True):
            low, high = robust_limits(values)
            drawn = show_map(axes, values, cmap="cividis", vmin=low, vmax=high)
            axes.set_title(f"Standard deviation of depth, {title}")
            pixel_axes(axes)
            colorbar(figure, drawn, axes, "mm", extend="both")
        void_legend(figure)
        save(figure, target / "depth_std.png")
    text = "Left: scatter from pixel to pixel, by the noise of the images." if len(parts) > 1 else ""
    if len(parts) > 1:
        text += (
            " Right: errors of calibration, stage and lens, which neighbouring pixels share: differences within the "
        )
        text += "map, and changes from frame to frame, have a smaller part of them."
    return [FigureInfo("depth_std.png", "Standard deviation of depth", text)]
