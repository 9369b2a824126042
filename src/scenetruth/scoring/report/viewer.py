"""The viewer of the report: its content as plain JSON values, its colour maps and its scripts."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.html import plotly_script
from scenetruth.schema import read_intrinsics
from scenetruth.scoring.alignment import align
from scenetruth.scoring.error_pairs import compute_pixel_coordinates
from scenetruth.scoring.quantities import ENDPOINT
from scenetruth.scoring.report.hotspot_pictures import HotspotPicture, draw_hotspot
from scenetruth.scoring.report.map_packing import RELATIVE_ROUNDING, MapPacker, ViewerImages, pack_viewer_images
from scenetruth.scoring.report.viewer_layers import (
    ErrorHotspot,
    ViewerLayers,
    build_layers,
    collect_error_maps,
    find_error_hotspots,
)
from scenetruth.scoring.score_result import Score
from scenetruth.settings import ScoreSettings

__all__ = ["Viewer", "build_viewer", "json_for_script", "packed_plotly", "viewer_script"]


COLOUR_MAPS: Mapping[str, str] = {
    "viridis": "viridis",
    "cividis": "cividis",
    "magma": "magma",
    "grey": "gray",
    "blue-white-red": "RdBu_r",
    "blue-dark-red": "berlin",
}
"""Names of colour maps in the page and in matplotlib; the last two are diverging."""

_INSTEAD = {"berlin": "PuOr_r"}
"""Replacements of colour maps that older releases of matplotlib lack."""


def colour_tables() -> dict[str, str]:
    """Return 256 colours of each of `COLOUR_MAPS`, three bytes each, in base 64."""
    from matplotlib import colormaps

    tables = {}
    for name, theirs in COLOUR_MAPS.items():
        chosen = colormaps[theirs if theirs in colormaps else _INSTEAD[theirs]]
        colours = np.rint(255 * chosen(np.arange(256) / 255)[:, :3]).astype(np.uint8)
        tables[name] = base64.b64encode(colours.tobytes()).decode("ascii")
    return tables


_PARTS = ("unpack", "layers", "panels", "profile", "surface", "copies", "page")
"""The parts of the viewer's script, in this order."""


@cache
def viewer_script() -> str:
    """Return the viewer's script, wrapped in a function in strict mode."""
    folder = files("scenetruth.scoring.report") / "templates"
    text = "\n".join((folder / f"viewer_{part}.js").read_text(encoding="utf-8") for part in _PARTS)
    return f'(() => {{\n"use strict";\n{text}\n}})();\n'


@cache
def packed_plotly() -> str:
    """Return plotly's script, compressed with zlib, in base 64."""
    return base64.b64encode(zlib.compress(plotly_script().encode("utf-8"), 6)).decode("ascii")


def json_for_script(values: Mapping[str, Any]) -> str:
    """Return plain values as JSON that is safe within a script element."""
    return json.dumps(values, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


_IMAGES = 1_100_000
"""Number of characters of the page for images other than the reference image."""


@dataclass(frozen=True)
class Viewer:
    """The content of the viewer, and statistics computed with it for the reference frame, by key of `QUANTITIES`.

    ``worst``: The largest errors. ``spread``: The standard deviation of the truth over the interior. ``pictures``:
    Sections of image and errors around the largest errors.
    """

    plain: Mapping[str, Any]
    frame: int
    worst: Mapping[str, ErrorHotspot]
    spread: Mapping[str, float]
    notes: Sequence[str]
    pictures: Mapping[str, HotspotPicture] = field(default_factory=dict)


def build_viewer(
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset | None,
    score: Score | None,
    *,
    most_pixels: int = 360_000,
    most_characters: float = 3_900_000,
) -> Viewer:
    """
    Read, subsample and pack the content of the viewer.

    ``most_pixels``: Largest number of displayed pixels; larger images are subsampled.
    ``most_characters``: Number of characters of the page that maps may use.
    """
    entries = {} if score is None else score.metadata.get("score_settings") or {}
    settings = ScoreSettings(**entries)
    margin_px = float((score.metadata if score else {}).get("margin_px", settings.interior_margin_px))
    grid, camera = compute_pixel_coordinates(estimate), read_intrinsics(estimate)
    step = max(1, math.ceil(math.sqrt(grid.x.size * grid.y.size / most_pixels)))
    frames = [int(t) for t in estimate["t"].values]
    frame = 0 if 0 in frames else frames[len(frames) // 2]
    gathered = MapPacker(step, most_characters)
    # Frames closest to the reference frame come first.
    for t in sorted(frames, key=lambda t: (t != frame, abs(t - frame))):
        if not gathered.room:
            gathered.frames_left_out += 1
            continue
        one, exact = estimate.sel(t=[t]), None
        if truth is not None:
            one, exact = align(one, truth)
        grows = score is None or score.grows
        gathered.add_frame(t, [*build_layers(one, exact, settings, grows=grows, step=step)])
        if exact is not None:
            gathered.add_regions(t, exact, margin_px)
    images = pack_viewer_images(recording, estimate, frame, step, _IMAGES)
    x, y = grid.x[::step], grid.y[::step]
    plain = {
        "width": x.size,
        "height": y.size,
        "x": x.tolist(),
        "y": y.tolist(),
        "focal_length_px": camera.focal_length_px,
        "principal_point_px": [float(value) for value in camera.principal_point_px],
        "frame": frame,
        "groups": gathered.groups(),
        "regions": list(gathered.regions.values()),
        "images": {
            "units": images.units,
            "limits": images.limits,
            "cameras": images.cameras,
            "frames": sorted({*images.frames, *frames}),
            "shown": [
                {"row": one.row, "camera": one.camera, "frame": one.frame, "step": one.step,
                 "map": gathered.store(one.packed)}
                for one in images.shown
            ],
        },
        "colours": colour_tables(),
        "maps": [packed.to_dict() for packed in gathered.packed],
    }  # fmt: skip
    first = {name: layers for (name, t), layers in gathered.layers.items() if t == frame}
    interior = gathered.interior.get(frame)
    worst = find_error_hotspots(first, x, y)
    return Viewer(
        plain=plain,
        frame=frame,
        worst=worst,
        spread={
            name: float(np.std(values))
            for name, layers in first.items()
            if interior is not None and "truth" in layers.maps
            for values in [layers.maps["truth"][interior & np.isfinite(layers.maps["truth"])]]
            if values.size
        },
        notes=list(_notes(step, gathered, images)),
        pictures=dict(_pictures(images.reference, first, worst, x, y)),
    )


def _pictures(
    image: NDArray[np.float64],
    layers: Mapping[str, ViewerLayers],
    worst: Mapping[str, ErrorHotspot],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> Iterator[tuple[str, HotspotPicture]]:
    """Yield the pictures of the largest errors; images may be smaller than maps."""
    for name, errors in collect_error_maps(layers):
        place = worst.get(name)
        if name in _PICTURED and place is not None and errors.shape == image.shape:
            row, top = (int(np.argmin(np.abs(y - at))) for at in (place.y, place.top))
            column, left = (int(np.argmin(np.abs(x - at))) for at in (place.x, place.left))
            side = round(place.side_px / (float(abs(x[-1] - x[0])) / max(x.size - 1, 1)))
            yield name, draw_hotspot(image, errors, row, column, (top, left, side))


_PICTURED = ("depth", "disparity", "normal", ENDPOINT, "flow", "growth_rate", "growth_rate_windowed")
"""Quantities of the summary, whose largest errors have a picture."""


def _notes(step: int, gathered: MapPacker, images: ViewerImages) -> Iterator[str]:
    """Yield notes on rounding, subsampling and omissions."""
    share = f"{100 * RELATIVE_ROUNDING:.4f} %"
    yield f"Values are rounded by at most {share} of the initial display range; integer grey values are exact."
    if step > 1:
        yield f"All maps show every {_ordinal(step)} row and column of the images, without averaging."
    for coarser, titles in sorted(gathered.coarser.items()):
        names = ", ".join(dict.fromkeys(titles))
        yield f"To limit the size of the page, every {_ordinal(coarser * step)} row and column is shown of: {names}."
    if gathered.left_out:
        yield f"To limit the size of the page, these maps are omitted: {', '.join(gathered.left_out)}."
    if gathered.frames_left_out:
        yield f"To limit the size of the page, the estimates of {gathered.frames_left_out} further frames are omitted."
    coarse = max((one.step for one in images.shown), default=1)
    if coarse > 1:
        yield f"Images other than the reference image show every {_ordinal(coarse * step)} row and column."
    if images.left_out:
        yield f"To limit the size of the page, {images.left_out} images are omitted."


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")
