"""Preview of the depth map and the reference image of a run, drawn with coloured characters."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from scenetruth.pipeline import RunDirectory

__all__ = ["downsample", "print_picture", "render_rows", "shows_pictures"]

_COLOURS = ("truecolor", "256")
_MOST_COLUMNS, _LEAST_COLUMNS, _GAP = 100, 40, 2
_UPPER, _LOWER = "▀", "▄"
_TAILS = (2, 98)
"""Percentiles of depth for the darkest and the brightest colour."""


def shows_pictures(console: Console) -> bool:
    """Return whether a console is a terminal that supports the required colours and characters."""
    if not (console.is_terminal and sys.stdout.isatty()) or console.no_color:
        return False
    return console.color_system in _COLOURS and "utf" in console.encoding.lower() and console.width >= _LEAST_COLUMNS


def print_picture(folder: RunDirectory, method: str, console: Console) -> None:
    """Print the image of the reference camera at the reference frame, and the estimated depth."""
    if not shows_pictures(console):
        return
    from matplotlib import colormaps

    from scenetruth.storage import open_store

    estimate = open_store(folder.paths(method).estimate, kind="estimate")
    frame = _nearest_zero(estimate["t"].values)
    image = _plane(open_store(folder.recording, kind="recording")["image"], float(estimate["t"][frame]))
    panels, captions = [_grey(image)], ["image"]
    if "depth" in estimate:
        depth = np.asarray(estimate["depth"].isel(t=frame).values, dtype=np.float64)
        if np.isfinite(depth).any():
            low, high = np.nanpercentile(depth, _TAILS)
            part = np.clip((depth - low) / max(high - low, 1e-300), 0, 1)
            panels.append(np.where(np.isfinite(depth)[..., None], colormaps["cividis"](part)[..., :3], np.nan))
            captions.append(f"depth, {low:.4g} (dark) to {high:.4g} mm")
    columns = (min(console.width, _MOST_COLUMNS) - _GAP) // 2
    rows = [render_rows(downsample(panel, columns)) for panel in panels]
    for line in zip(*rows, strict=False):
        for number, piece in enumerate(line):
            console.print(piece, end="\n" if number == len(line) - 1 else " " * _GAP)
    console.print("".join(f"{caption:{columns + _GAP}}" for caption in captions).rstrip(), soft_wrap=True)


def downsample(picture: NDArray[np.floating[Any]], columns: int) -> NDArray[np.float64]:
    """Return an image downsampled to at most ``columns`` columns, by means over pixels.

    ``picture``: Values, shape (height, width, channels); NaN where invalid.
    """
    height, width, _ = picture.shape
    columns = min(columns, width)
    lines = max(round(height * columns / width), 1)
    # Each pixel is assigned by its centre.
    down, across = (np.arange(height) * lines // height, np.arange(width) * columns // width)
    cells = (down[:, None] * columns + across[None]).ravel()
    there = np.isfinite(picture).all(axis=2).ravel()
    values = np.where(there[:, None], picture.reshape(-1, picture.shape[2]), 0.0)
    counts = np.bincount(cells, weights=there, minlength=lines * columns)
    sums = [np.bincount(cells, weights=channel, minlength=lines * columns) for channel in values.T]
    enough = counts >= np.bincount(cells, minlength=lines * columns) / 2
    means = np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None]
    return np.asarray(np.where(enough[:, None], means, np.nan).reshape(lines, columns, -1), dtype=np.float64)


def render_rows(picture: NDArray[np.float64]) -> list[Text]:
    """Return lines of characters with two vertically adjacent pixels each; NaN keeps the terminal's background.

    ``picture``: Red, green and blue in [0, 1], shape (height, width, 3).
    """
    from rich.text import Text

    if len(picture) % 2:
        picture = np.concatenate([picture, np.full_like(picture[:1], np.nan)])
    there: NDArray[np.bool_] = np.asarray(np.isfinite(picture).all(axis=2))
    bytes_ = np.rint(255 * np.clip(np.where(there[..., None], picture, 0), 0, 1)).astype(int)
    lines = []
    for upper in range(0, len(picture), 2):
        line = Text(no_wrap=True)
        for column in range(picture.shape[1]):
            above, below = (
                f"#{''.join(f'{part:02x}' for part in bytes_[row, column])}" if there[row, column] else ""
                for row in (upper, upper + 1)
            )
            if above:
                line.append(_UPPER, style=f"{above} on {below}" if below else above)
            else:
                line.append(_LOWER if below else " ", style=below)
        lines.append(line)
    return lines


def _nearest_zero(times: NDArray[Any]) -> int:
    return int(np.argmin(np.abs(times)))


def _plane(images: Any, t: float) -> NDArray[np.float64]:
    found = images.sel(t=t, method="nearest")
    for name in ("s", "s_y"):
        if name in found.dims:
            found = found.isel({name: _nearest_zero(found[name].values)})
    return np.asarray(found.values, dtype=np.float64)


def _grey(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return grey values or colours from 0 to 1, shape (y, x, 3); other channels are averaged."""
    if image.ndim == 3 and image.shape[2] != 3:
        image = image.mean(axis=2)
    values = image - min(float(np.nanmin(image)), 0.0)
    part = np.clip(values / max(float(np.nanpercentile(values, 99)), 1e-300), 0, 1)
    return part if part.ndim == 3 else np.repeat(part[..., None], 3, axis=2)
