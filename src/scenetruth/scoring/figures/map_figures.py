"""Figures of maps: estimate, truth and error side by side, or the estimate alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import (
    REASONS,
    STATUS_FALLBACK,
    STATUS_INVALID,
    STATUS_NORMAL,
    STATUS_VALID,
    read_intrinsics,
)
from scenetruth.scoring.alignment import align
from scenetruth.scoring.error_pairs import percent_per_hour
from scenetruth.scoring.figures.figure_arrays import FigureArrays
from scenetruth.scoring.figures.figure_style import (
    BLUE,
    ORANGE,
    VOID,
    FigureInfo,
    colorbar,
    hatch,
    hatched_swatch,
    map_height,
    new_figure,
    pixel_axes,
    robust_limits,
    save,
    show_map,
    swatch,
    symmetric_limit,
    unit_label,
    void_legend,
)
from scenetruth.scoring.growth_rate import compute_growth_maps, compute_growth_rate
from scenetruth.scoring.quantities import QUANTITIES
from scenetruth.scoring.score_result import Score
from scenetruth.settings import ScoreSettings

__all__ = [
    "draw_coherence",
    "draw_comparison",
    "draw_depth",
    "draw_disparity",
    "draw_estimated_growth",
    "draw_flow",
    "draw_growth",
    "draw_image",
    "draw_velocity_z",
    "draw_velocity_z_row",
    "growth_limits",
    "pick_row",
]


def draw_comparison(views: FigureArrays, names: tuple[str, ...], file: Path, *, signed: bool = False) -> str:
    """Draw quantities, one per row: the estimate and, if there is a truth, the truth and the error."""
    columns = 3 if views.truth else 1
    # Without truth, single-panel rows would waste the width.
    rows = len(names) if views.truth else 1
    columns = columns if views.truth else len(names)
    height = map_height(views.image, 2.75 if columns == 3 else 4.4, 0.65)
    figure = new_figure(11.0 if columns == 3 else 5.6 * columns, 0.3 + rows * height)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for place, name in enumerate(names):
        row = panels[place] if views.truth else panels[0, place : place + 1]
        _draw_quantity(figure, row, views, name, signed=signed)
    for axes in panels.flat:
        pixel_axes(axes, label_y=axes in panels[:, 0])
    hatched = views.fallback is not None and any(name in ("depth", "disparity") for name in names)
    extra = (hatched_swatch("fallback value"),) if hatched else ()
    void_legend(figure, "no valid estimate, or no surface" if views.truth else "no valid estimate", extra)
    save(figure, file)
    scale = "The scale is symmetric about zero. " if signed else ""
    if not views.truth:
        return f"{scale}Each scale spans {98 if signed else 99} % of the estimates."
    return (
        f"Estimate and truth share one scale. {scale}The scale of the error is symmetric about zero and spans 98 % of "
        "the errors; red is too large, blue too small."
    )


def _draw_quantity(figure: Any, row: Any, views: FigureArrays, name: str, *, signed: bool) -> None:
    entry = QUANTITIES[name]
    shown = views.panels(name)
    if signed:
        bound = symmetric_limit(*shown.values())
        options = {"cmap": "RdBu_r", "vmin": -bound, "vmax": bound}
    else:
        low, high = robust_limits(*shown.values(), percent=0.5)
        options = {"cmap": "cividis", "vmin": low, "vmax": high}
    label = f"${entry.symbol}${unit_label(entry.units)}"
    for axes, (what, values) in zip(row, shown.items(), strict=False):
        drawn = show_map(axes, values, extent=views.grid.extent, **options)
        axes.set_title(f"{entry.title}, {what}")
        colorbar(figure, drawn, axes, label, extend="both")
    # The fallback has no other quantities.
    fallback = views.fallback if name in ("depth", "disparity") else None
    if fallback is not None:
        hatch(row[0], fallback, views.grid.x, views.grid.y)
    if "truth" in shown:
        error = shown["estimate"] - shown["truth"]
        bound = symmetric_limit(error)
        drawn = show_map(row[2], error, extent=views.grid.extent, cmap="RdBu_r", vmin=-bound, vmax=bound)
        row[2].set_title("Error, estimate − truth")
        if fallback is not None:
            hatch(row[2], fallback, views.grid.x, views.grid.y)
        colorbar(figure, drawn, row[2], f"error of {label}", extend="both")


def draw_image(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the image of the reference camera."""
    title = f"Image of the reference camera, t = {views.image_frame}"
    figure = new_figure(6.4, map_height(views.image, 5.15, 0.75))
    axes = figure.add_subplot(title=title)
    drawn = axes.imshow(views.image, cmap="gray", extent=views.grid.extent)
    pixel_axes(axes)
    colorbar(figure, drawn, axes, "grey value [DN]" if views.image_is_digital else "linear radiance / full scale")
    save(figure, folder / "image.png")
    return FigureInfo(
        "image.png",
        title,
        f"The image at s = 0 and t = {views.image_frame}. Black and white are its minimum and maximum.",
    )


def draw_depth(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the estimated depth and, if there is a truth, the true depth and the error."""
    caption = draw_comparison(views, ("depth",), folder / "depth.png")
    return FigureInfo("depth.png", _title(views, "Depth"), f"{caption} A larger depth is farther from the camera.")


def draw_disparity(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the estimated disparity and, if there is a truth, the true disparity and the error."""
    caption = draw_comparison(views, ("disparity",), folder / "disparity.png")
    return FigureInfo(
        "disparity.png", _title(views, "Disparity"), f"{caption} A larger disparity is closer to the camera."
    )


def draw_flow(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw both components of the estimated optical flow and, if there is a truth, the true flow and the errors."""
    caption = draw_comparison(views, ("flow_x", "flow_y"), folder / "flow.png", signed=True)
    return FigureInfo(
        "flow.png",
        _title(views, "Optical flow"),
        f"{caption} Red is motion to the right (x) or downwards (y), blue to the left or upwards.",
    )


def _title(views: FigureArrays, name: str) -> str:
    return f"{name}: estimate{', truth and error' if views.truth else ''}, t = {views.frame}"


def pick_row(views: FigureArrays) -> int:
    """Return the row closest to the image centre among those with nearly the maximum number of valid pixels."""
    counts = np.isfinite(views.estimate["velocity_z"]).sum(axis=1)
    rows = np.flatnonzero(counts >= 0.95 * counts.max())
    return int(rows[np.argmin(np.abs(rows - (len(counts) - 1) / 2))])


def draw_velocity_z(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the estimated velocity in Z twice: in grey with the selected row marked, and in diverging colours."""
    from matplotlib.lines import Line2D

    row = views.grid.y[pick_row(views)]
    title = f"Estimated velocity in Z, t = {views.frame}"
    values = views.estimate["velocity_z"]
    low, high = robust_limits(values)
    bound = symmetric_limit(values)
    figure = new_figure(10.8, map_height(values, 4.3, 1.0))
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    drawn = show_map(left, values, cmap="gray", vmin=low, vmax=high, extent=views.grid.extent)
    left.set_title("Velocity in Z, grey values")
    left.axhline(row, color=ORANGE, linewidth=1.2)
    colorbar(figure, drawn, left, "$U_Z$ [mm/frame]", extend="both")
    drawn = show_map(right, values, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=views.grid.extent)
    right.set_title("Velocity in Z, sign and magnitude")
    colorbar(figure, drawn, right, "$U_Z$ [mm/frame]", extend="both")
    pixel_axes(left)
    pixel_axes(right, label_y=False)
    void_legend(figure, extra=(Line2D([], [], color=ORANGE, linewidth=1.2, label=f"row {row:g}"),))
    save(figure, folder / "velocity_z.png")
    caption = (
        "Left: the grey scale spans the central 98 % of the estimates, so that small differences are visible; "
        f"the next figure shows the profile of row {row:g}. Right: the scale is symmetric about zero; blue "
        "(negative) approaches the camera, red recedes, and white has no velocity in Z."
    )
    return FigureInfo("velocity_z.png", title, caption)


def draw_velocity_z_row(views: FigureArrays, folder: Path) -> FigureInfo:
    """Draw the velocity in Z along the selected row: the estimate and, if there is one, the truth."""
    from matplotlib import rc_context

    row = pick_row(views)
    title = f"Velocity in Z along row {views.grid.y[row]:g}, t = {views.frame}"
    lines = {what: values[row] for what, values in views.panels("velocity_z").items()}
    estimate, x = lines["estimate"], views.grid.x
    low, high = robust_limits(*lines.values(), percent=0.5)
    pad = 0.15 * (high - low)
    low, high = low - pad, high + pad
    outside = int(np.sum((estimate < low) | (estimate > high)))

    figure = new_figure(8.4, 3.4)
    # The power of ten of very low velocities stands above the axes; the title must leave space for it.
    with rc_context({"axes.titley": None}):
        axes = figure.add_subplot(title=title)
    mixed = views.mixed[row]
    if mixed.any():
        axes.fill_between(
            x, 0, 1, where=mixed, step="mid", transform=axes.get_xaxis_transform(),
            color="#c3c8cf", linewidth=1.2, label="mixed pixels of the truth",
        )  # fmt: skip
    if "truth" in lines:
        axes.plot(x, lines["truth"], color=ORANGE, linewidth=1.6, label="truth")
    axes.plot(x, estimate, color=BLUE, linewidth=0.9, label="estimate")
    axes.set_xlim(*views.grid.extent[:2])
    axes.set_ylim(low, high)
    axes.set_xlabel("x [px]")
    axes.set_ylabel("$U_Z$ [mm/frame]")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(axis="y")
    figure.legend(loc="outside lower left", ncols=4)
    save(figure, folder / "velocity_z_row.png")
    caption = "The estimate along the selected row; gaps have no valid estimate."
    if "truth" in lines:
        caption = (
            "Estimate and truth along the selected row. Grey bands mark mixed pixels, whose footprint crosses a "
            "silhouette or a crease; gaps have no valid estimate."
        )
    if outside:
        caption += f" {outside} estimate{'s lie' if outside > 1 else ' lies'} outside the plotted range."
    return FigureInfo("velocity_z_row.png", title, caption)


Map = NDArray[np.float64]

_STD = "standard deviation"


@dataclass(frozen=True)
class _GrowthFigure:
    """The content of the figure for one frame, in %/h."""

    found: Map
    exact: Map
    third: Map | None
    third_title: str
    error: Map
    error_title: str
    void: str
    caption: str


def draw_growth(
    views: FigureArrays, estimate: xr.Dataset, truth: xr.Dataset, score: Score, folder: Path
) -> FigureInfo | None:
    """Draw the growth rate of one frame, or return None where it is undefined.

    A growth rate of the estimate is compared with the truth of every pixel, a growth rate computed from depth and
    velocity with the truth in the same window.
    """
    estimate, truth = align(estimate.sel(t=[views.frame]), truth)
    extent = views.grid.extent
    if "growth_rate" in estimate:
        shown = _estimated(views)
    else:
        shown = _windowed(estimate, truth, ScoreSettings(**score.metadata.get("score_settings", {})))
    if shown is None or not np.isfinite(shown.found).any():
        return None
    low, high = growth_limits(shown.found, shown.exact)
    known = shown.found[np.isfinite(shown.found)]
    bound = symmetric_limit(shown.error)

    figure = new_figure(8.6, 2 * map_height(shown.error, 3.2, 0.65) + 0.3)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    named = ((shown.found, "estimate"), (shown.exact, "truth"), (shown.third, shown.third_title))
    for axes, (values, name) in zip(panels.flat, named, strict=False):
        if values is None:
            axes.remove()
            continue
        limits = (0.0, robust_limits(values)[1]) if name == _STD else (low, high)
        drawn = show_map(axes, values, cmap="cividis", vmin=limits[0], vmax=limits[1], extent=extent)
        axes.set_title(f"Growth rate, {name}")
        colorbar(figure, drawn, axes, "growth rate [%/h]", extend="both")
    last = panels[1, 1]
    drawn = show_map(last, shown.error, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=extent)
    last.set_title(f"Error, {shown.error_title}")
    colorbar(figure, drawn, last, "error [%/h]", extend="both")
    for axes in figure.axes:
        if axes in panels.flat:
            pixel_axes(axes, label_y=axes in panels[:, 0])
    void_legend(figure, shown.void)
    save(figure, folder / "growth_rate.png")
    beyond = float(np.mean(np.abs(known - 0.5 * (low + high)) > 0.5 * (high - low)))
    caption = (
        f"Relative growth rate of the surface area. {shown.caption} Estimate and truth share one scale: up to twice "
        "the largest true rate, or 98 % of the estimates if nothing grows. "
        f"{100 * beyond:.0f} % of the estimates lie beyond the scale. "
        "The scale of the error is symmetric about zero and spans 98 % of the errors."
    )
    return FigureInfo("growth_rate.png", f"Growth rate: estimate, truth and error, t = {views.frame}", caption)


def _estimated(views: FigureArrays) -> _GrowthFigure | None:
    """Return the growth rate that the estimate contains, and the truth of every pixel."""
    if "growth_rate" not in views.truth:
        return None
    found, exact = views.estimate["growth_rate"], views.truth["growth_rate"]
    return _GrowthFigure(
        found,
        exact,
        views.stds.get("growth_rate"),
        _STD,
        found - exact,
        "estimate − truth",
        "no surface, or no valid estimate",
        "The growth rate is estimated by the method at every pixel.",
    )


def _windowed(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> _GrowthFigure | None:
    """Return the growth rate computed from estimated and from true depth and velocity."""
    maps = compute_growth_maps(estimate, truth, settings)
    if maps is None:
        return None
    factor = percent_per_hour(read_intrinsics(estimate))
    found, exact, windowed = (factor * values[0] for values in (maps.estimate, maps.truth, maps.truth_windowed))
    return _GrowthFigure(
        found,
        exact,
        windowed,
        "truth in the same window",
        found - windowed,
        "estimate − truth in the same window",
        "no surface, or too few valid pixels in the window",
        f"It is computed from depth and velocity in a Gaussian window of {settings.growth_window_px:g} px standard "
        "deviation. The truth is shown for every pixel's surface element, and as computed from the true depth and "
        "velocity in the same windows.",
    )


def draw_estimated_growth(views: FigureArrays, estimate: xr.Dataset, folder: Path) -> FigureInfo | None:
    """Draw the growth rate of one frame of an estimate without truth; None where no window has enough valid pixels."""
    settings = ScoreSettings()
    own = "growth_rate" in views.estimate
    if own:
        found = views.estimate["growth_rate"]
    else:
        rate = compute_growth_rate(estimate.sel(t=[views.frame]), settings=settings).values[0]
        found = percent_per_hour(read_intrinsics(estimate)) * rate
    if not np.isfinite(found).any():
        return None
    bound = symmetric_limit(found)
    figure = new_figure(6.4, map_height(found, 5.1, 1.0))
    axes = figure.add_subplot(title="Growth rate, estimate")
    drawn = show_map(axes, found, cmap="RdBu_r", vmin=-bound, vmax=bound, extent=views.grid.extent)
    colorbar(figure, drawn, axes, "growth rate [%/h]", extend="both")
    pixel_axes(axes)
    void_legend(figure, "no valid estimate" if own else "too few valid pixels in the window")
    save(figure, folder / "growth_rate.png")
    window = f"from depth and velocity in a Gaussian window of {settings.growth_window_px:g} px standard deviation"
    origin = "as estimated by the method at every pixel" if own else window
    caption = (
        f"Relative growth rate of the surface area, {origin}. The scale is symmetric about zero and spans 98 % of the "
        "estimates; red grows, blue shrinks. Noise appears as growth of either sign."
    )
    return FigureInfo("growth_rate.png", f"Growth rate: estimate, t = {views.frame}", caption)


def growth_limits(found: NDArray[np.float64], exact: NDArray[np.float64]) -> tuple[float, float]:
    """Return limits that show the truth, independent of the noise of the estimate."""
    low, high = robust_limits(found, exact)
    grows = float(np.nanmax(np.abs(exact), initial=0.0))
    if grows > 1e-9 * max(abs(low), abs(high)):
        return max(low, -2 * grows), min(high, 2 * grows)
    return low, high


Mask = NDArray[np.bool_]
Panel = Callable[[Any, Any], None]
Extent = tuple[float, float, float, float]

_CODES = {
    STATUS_VALID: (BLUE, "valid"),
    STATUS_NORMAL: ("#e69f00", "normal component only"),
    STATUS_FALLBACK: ("#56b4e9", "fallback"),
    STATUS_INVALID: (VOID, "invalid"),
}
_TITLES = {"status": "Status", "status_disparity": "Status of disparity", "status_motion": "Status of motion"}
_REASON_COLOURS = {
    "none": "#ffffff",
    "border": "#bbbbbb",
    "low_texture": "#8c6d31",
    "ambiguous_match": "#e69f00",
    "occlusion": "#009e73",
    "model_violation": "#b0006d",
    "masked": "#000000",
    "saturated": "#f0e442",
    "not_converged": "#cc79a7",
    "not_determined": "#777777",
}


def draw_coherence(views: FigureArrays, folder: Path) -> FigureInfo | None:
    """Draw coherence, status and reason for invalidity; None for an estimate without any of them."""
    # The status is the lower of the two specific statuses.
    statuses = {name: status for name, status in views.statuses.items() if name != "status" or len(views.statuses) < 3}
    extent = views.grid.extent
    panels, legend, names = [], [], []
    caption = "Quality measures of the method, computed without the truth."
    if views.coherence is not None:
        # Without a window within the image there is no coherence.
        border = None if views.reasons is None else views.reasons == REASONS.index("border")
        shown_coherence = views.coherence if border is None else np.where(border, np.nan, views.coherence)
        panels.append(_coherence_panel(shown_coherence, extent))
        names.append("coherence")
        caption += " The coherence is between 0 and 1; larger is better."
    if statuses:
        panels += [_status_panel(name, status, extent) for name, status in statuses.items()]
        names.append("status")
        shown = [
            code for code in _CODES if code != STATUS_INVALID and any((one == code).any() for one in statuses.values())
        ]
        legend += [swatch(_CODES[code][0], _CODES[code][1]) for code in shown]
        caption += (
            " The status of a pixel is valid, normal component only (the component along the grey-value gradient, "
            "because of the aperture problem), fallback (a coarser value, which is not scored) or invalid. "
            f"Fractions of the image: {_fractions(statuses)}."
        )
    if views.reasons is not None:
        counts = np.bincount(views.reasons.ravel(), minlength=len(REASONS))
        panels.append(_reason_panel(views.reasons, extent))
        names.append("reason for invalidity")
        occurring = [(name, count) for name, count in zip(REASONS, counts.tolist(), strict=True) if count]
        stated = [(name.replace("_", " "), name, count) for name, count in occurring if name != "none"]
        legend += [swatch(_REASON_COLOURS[name], words) for words, name, _ in stated]
        caption += " The reason for invalidity is white where the estimate is valid." + (
            " Fractions of the image: "
            + ", ".join(f"{words} {_percent(count / views.reasons.size)}" for words, _, count in stated)
            + "."
            if stated
            else ""
        )
    if not panels:
        return None
    columns = min(len(panels), 2)
    rows = math.ceil(len(panels) / columns)
    figure = new_figure(4.4 * columns + 0.6, 0.35 + rows * map_height(views.image, 3.9, 0.65))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, draw in zip(axes, panels, strict=False):
        draw(figure, place)
        pixel_axes(place)
    for place in axes[len(panels) :]:
        place.remove()
    void_legend(figure, "invalid, or no value" if statuses else "no value", tuple(legend), columns=2 * columns)
    save(figure, folder / "coherence.png")
    *most, last = names
    title = f"{', '.join(most)} and {last}" if most else last
    return FigureInfo("coherence.png", f"{title.capitalize()} of the estimate, t = {views.frame}", caption)


def _fractions(statuses: dict[str, NDArray[np.int64]]) -> str:
    """Format the fraction of the image with each status."""
    return "; ".join(
        (f"{_TITLES[name].lower()}, " if len(statuses) > 1 else "")
        + ", ".join(f"{label} {_percent(float(np.mean(status == code)))}" for code, (_, label) in _CODES.items())
        for name, status in statuses.items()
    )


def _percent(fraction: float) -> str:
    """Return a fraction of the image; under 0.05 % it is not 0.0 %."""
    text = f"{100 * fraction:.1f}" if fraction == 0 or fraction >= 5e-4 else "under 0.1"
    return f"{text} %"


def _coherence_panel(coherence: Map, extent: Extent) -> Panel:
    def draw(figure: Any, axes: Any) -> None:
        drawn = show_map(axes, coherence, cmap="cividis", vmin=0, vmax=1, extent=extent)
        axes.set_title("Coherence")
        colorbar(figure, drawn, axes, "coherence")

    return draw


def _status_panel(name: str, status: NDArray[np.int64], extent: Extent) -> Panel:
    from matplotlib.colors import BoundaryNorm, ListedColormap

    colours = ListedColormap([_CODES[code][0] for code in sorted(_CODES)])
    norm = BoundaryNorm(np.arange(-0.5, len(_CODES)), len(_CODES))

    def draw(_: Any, axes: Any) -> None:
        axes.imshow(status, cmap=colours, norm=norm, extent=extent)
        axes.set_title(_TITLES[name])

    return draw


def _reason_panel(reasons: NDArray[np.int64], extent: Extent) -> Panel:
    from matplotlib.colors import BoundaryNorm, ListedColormap

    colours = ListedColormap([_REASON_COLOURS[name] for name in REASONS])
    norm = BoundaryNorm(np.arange(-0.5, len(REASONS)), len(REASONS))

    def draw(_: Any, axes: Any) -> None:
        axes.imshow(reasons, cmap=colours, norm=norm, extent=extent)
        axes.set_title("Reason for invalidity")

    return draw
