"""Compact encoding of maps and images for the report, with a bounded rounding error and a size budget."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.number_format import format_unit
from scenetruth.scoring.alignment import select_pixels
from scenetruth.scoring.quantities import ENDPOINT, QUANTITIES
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.report.viewer_layers import (
    FALLBACK,
    ViewerLayers,
    choose_scale,
    compute_display_ranges,
    value_limits,
)

__all__ = [
    "LEVELS",
    "RELATIVE_ROUNDING",
    "MapPacker",
    "PackedImage",
    "PackedMap",
    "ViewerImages",
    "pack_map",
    "pack_viewer_images",
    "unpack_map",
]


Map = NDArray[np.float64]
Codes = NDArray[np.uint16]

LEVELS = 8192
"""Quantisation levels of the initial display range; codes cover eight times this range."""
RELATIVE_ROUNDING = 0.5 / LEVELS
"""Largest rounding error of a map, as a fraction of the initial display range."""
_NONE, _EXACT, _FIRST = 0, 1, 2
"""Codes of a pixel without a value, of an exactly stored value, and of the lowest value."""
_CODES = 65_536 - _FIRST
_RAW, _ROWS, _PLANE = 0, 1, 2
"""Predictors of a code: none, the left neighbour, or the plane of the left, upper and upper-left neighbours."""


@dataclass(frozen=True)
class PackedMap:
    """A compressed two-dimensional map.

    A code c ≥ 2 represents ``low + (c - 2) step``, 0 no value, and 1 the next exact value in reading order. The codes
    are stored as differences from their prediction, modulo 65536, in zigzag encoding: all upper bytes, then all lower
    bytes, then the exact values (8 bytes each, little-endian), compressed with zlib.

    ``predictor``: None (0), the left neighbour (1), or the plane left + upper - upper left (2).
    ``exact``: Number of exactly stored values.
    """

    shape: tuple[int, int]
    low: float
    step: float
    predictor: int
    exact: int
    data: bytes

    @property
    def rounding(self) -> float:
        """The largest error of an unpacked value, apart from float64 rounding."""
        return 0.5 * self.step

    @property
    def size(self) -> int:
        """The number of characters in the page."""
        return 4 * -(-len(self.data) // 3)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values, with the bytes in base 64."""
        return {
            "height": self.shape[0],
            "width": self.shape[1],
            "low": self.low,
            "step": self.step,
            "predictor": self.predictor,
            "exact": self.exact,
            "data": base64.b64encode(self.data).decode("ascii"),
        }


def pack_map(values: NDArray[Any], limits: tuple[float, float] | None = None) -> PackedMap:
    """Pack a map.

    >>> packed = pack_map(np.array([[1.0, 1.5, np.nan], [2.0, 1e9, 1.25]]), limits=(1.0, 2.0))
    >>> unpack_map(packed).round(3).tolist(), packed.exact, round(packed.rounding, 6)
    ([[1.0, 1.5, nan], [2.0, 1000000000.0, 1.25]], 1, 6.1e-05)
    """
    whole = values.dtype.kind in "uib"
    numbers = values.astype(np.float64)
    known = ~np.isnan(numbers)
    finite = numbers[np.isfinite(numbers)]
    low = step = 0.0
    if finite.size:
        least, most = float(finite.min()), float(finite.max())
        low, high = (least, most) if limits is None else limits
        if whole and most - least < _CODES:
            low, step = least, 1.0
        else:
            step = high / LEVELS - low / LEVELS
            # Near the limits of float64 steps cannot be resolved; all values are then stored exactly.
            if not (math.isfinite(step * _CODES) and step >= np.finfo(np.float64).tiny):
                step = 0.0
            elif limits is not None:
                low -= step * ((_CODES - LEVELS) // 2)
                if not math.isfinite(low):
                    low = step = 0.0
    codes = np.zeros(numbers.shape, dtype=np.uint16)
    with np.errstate(over="ignore", invalid="ignore"):
        at = np.rint((numbers - low) / step) if step else np.where(numbers == low, 0.0, -1.0)
        coded = known & (at >= 0) & (at < _CODES)
    codes[coded] = at[coded].astype(np.uint16) + np.uint16(_FIRST)
    exact = known & ~coded
    codes[exact] = _EXACT
    predictor, entries = min(
        ((way, _predicted_by(codes, way)) for way in (_RAW, _ROWS, _PLANE)), key=lambda one: _cost(one[1])
    )
    entries = entries.ravel()
    content = (
        (entries >> 8).astype(np.uint8).tobytes()
        + (entries & 255).astype(np.uint8).tobytes()
        + numbers[exact].astype("<f8").tobytes()
    )
    # Searching for repeated strings in the residual differences takes time and saves little.
    packer = zlib.compressobj(6, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_FILTERED)
    data = packer.compress(content) + packer.flush()
    height, width = numbers.shape
    return PackedMap((height, width), low, step, predictor, int(exact.sum()), data)


def unpack_map(packed: PackedMap) -> Map:
    """Return the map that the viewer reconstructs, shape (y, x), NaN where undefined."""
    content = zlib.decompress(packed.data)
    height, width = packed.shape
    size = height * width
    upper, lower = (np.frombuffer(content, np.uint8, size, at * size).astype(np.uint16) for at in (0, 1))
    entries = (upper << 8 | lower).reshape(packed.shape)
    codes = (entries >> 1) ^ (np.uint16(0) - (entries & np.uint16(1)))
    if packed.predictor >= _ROWS:
        codes = np.cumsum(codes, axis=1, dtype=np.uint16)
    if packed.predictor == _PLANE:
        codes = np.cumsum(codes, axis=0, dtype=np.uint16)
    values = packed.low + (codes.astype(np.float64) - _FIRST) * packed.step
    values[codes == _NONE] = np.nan
    values[codes == _EXACT] = np.frombuffer(content, "<f8", packed.exact, 2 * size)
    return values


def _predicted_by(codes: Codes, predictor: int) -> Codes:
    """Return the zigzag-encoded differences of codes from their prediction."""
    left = codes.copy()
    if predictor >= _ROWS:
        left[:, 1:] -= codes[:, :-1]
    if predictor == _PLANE:
        left[1:] -= left[:-1].copy()
    return (left << np.uint16(1)) ^ (np.uint16(0) - (left >> np.uint16(15)))


def _cost(differences: Codes) -> float:
    """Return the approximate number of bits that differences require."""
    return float(np.log2(differences[::2].astype(np.float32) + 1).sum())


_THINNED = 1.2
"""Relative size of a subsampled image per pixel: differences between neighbours increase."""
_COARSEST_IMAGE = 4
"""Coarsest subsampling of images; beyond it, images are omitted."""


@dataclass(frozen=True)
class PackedImage:
    """One image of the viewer: its s_y, s and t, subsampling step relative to the reference image, and grey values."""

    row: int
    camera: int
    frame: int
    step: int
    packed: PackedMap


@dataclass(frozen=True)
class ViewerImages:
    """The images of a page, beginning with the reference camera at the reference frame.

    ``cameras``, ``frames``: The cameras (s_y, s) and the frames t of the recording.
    ``left_out``: Number of omitted images. ``reference``: Grey values of the first image.
    """

    shown: Sequence[PackedImage]
    cameras: Sequence[tuple[int, int]]
    frames: Sequence[int]
    left_out: int
    units: str
    limits: tuple[float, float]
    reference: NDArray[np.float64]


def pack_viewer_images(recording: xr.Dataset, estimate: xr.Dataset, frame: int, step: int, budget: int) -> ViewerImages:
    """Select and pack images."""
    every = select_pixels(recording, estimate)["image"]
    frames = [int(t) for t in every["t"].values]
    at = frame if frame in frames else 0 if 0 in frames else frames[len(frames) // 2]
    rows = [int(s) for s in every["s_y"].values] if "s_y" in every.dims else [0]
    columns = [int(s) for s in every["s"].values] if "s" in every.dims else [0]
    cameras = [(row, column) for row in rows for column in columns]

    def read(row: int, camera: int, t: int, step: int) -> NDArray[np.generic]:
        chosen = {"s_y": row, "s": camera, "t": t}
        image = every.sel({dim: value for dim, value in chosen.items() if dim in every.dims})
        grey = image.mean("channel") if "channel" in image.dims else image
        return np.asarray(grey.values[::step, ::step])

    reference = read(0, 0, at, step)
    limits = value_limits(reference.astype(np.float64))
    first = PackedImage(0, 0, at, 1, pack_map(reference, limits))
    others = [(*camera, at) for camera in cameras if camera != (0, 0)]
    others += [(0, 0, t) for t in sorted(frames, key=lambda t: abs(t - at)) if t != at]
    room = budget / max(first.packed.size, 1)
    coarser = 1 if len(others) <= room else math.ceil(math.sqrt(_THINNED * len(others) / room))
    wanted = len(others)
    if coarser > _COARSEST_IMAGE:
        coarser = _COARSEST_IMAGE
        keep = max(1, int(room * coarser**2 / _THINNED))
        # Evenly spread, so that both cameras and frames are represented.
        others = [others[n * wanted // keep] for n in range(keep)] if keep < wanted else others
    shown, used = [first], 0
    for row, camera, t in others:
        packed = pack_map(read(row, camera, t, step * coarser), limits)
        used += packed.size
        if used > _THINNED * budget:
            break
        shown.append(PackedImage(row, camera, t, coarser, packed))
    units = "DN" if every.dtype.kind in "ui" or float(recording.attrs.get("full_scale", 1.0)) > 1.0 else "1"
    left_out = wanted - len(shown) + 1
    return ViewerImages(shown, cameras, frames, left_out, units, limits, reference.astype(np.float64))


_MAIN_SHARE = 0.8
"""Fraction of the characters of the page for the main quantities."""
_COARSEST = 4
_BAND_ROWS, _BANDS = 16, 4
"""The size of maps is predicted from every fourth band of this many rows."""


class MapPacker:
    """Packs maps with a subsampling step in sequence, into at most about this number of characters of the page."""

    def __init__(self, step: int, most_characters: float) -> None:
        self.packed: list[PackedMap] = []
        self.regions: dict[str, dict[str, Any]] = {}
        self.interior: dict[int, NDArray[np.bool_]] = {}
        self.layers: dict[tuple[str, int], ViewerLayers] = {}
        self.coarser: dict[int, list[str]] = {}
        self.frames_left_out = 0
        self.left_out: list[str] = []
        self._step = step
        self._left = self._all = most_characters
        self._groups: dict[str, dict[str, Any]] = {}

    @property
    def room(self) -> bool:
        """Whether another frame may fit."""
        return self._left > 0.05 * self._all

    def store(self, packed: PackedMap) -> int:
        """Store a packed map and return its index."""
        self.packed.append(packed)
        return len(self.packed) - 1

    def add_frame(self, t: int, found: list[ViewerLayers]) -> None:
        """Pack the main maps of a frame, and the others as the budget allows."""
        first = not self._groups
        for main in (True, False):
            some = [layers for layers in found if layers.main == main]
            share = _MAIN_SHARE if first and main else 1.0
            for layers, step in _thinnings(some, share * self._left):
                if first:
                    self.layers[layers.name, t] = layers
                if step == 0:
                    self.left_out.append(f"{layers.title}, t = {t}")
                    continue
                if step > 1:
                    self.coarser.setdefault(step, []).append(layers.title)
                self._add(t, layers, step)
        if first:
            self._add_lengths()

    def add_regions(self, t: int, truth: xr.Dataset, margin_px: float) -> None:
        """Pack the region masks of a frame, whose outlines can be drawn."""
        step = self._step
        inside = main_regions(truth, margin_px)["interior"][0, ::step, ::step]
        self.interior[t] = inside
        masks = {
            "interior": (f"interior, {margin_px:g} px from discontinuities", inside),
            "edges": ("discontinuities (mixed pixels)", truth["mixed"].values[0, ::step, ::step].astype(bool)),
        }
        if {"occluded_across_cameras", "occluded_in_time"} <= set(truth):
            hidden = np.zeros(inside.shape, dtype=bool)
            for name in ("occluded_across_cameras", "occluded_in_time"):
                hidden |= np.nan_to_num(truth[name].values[0, ::step, ::step]).astype(bool)
            masks["hidden"] = (
                "occluded in a camera or frame",
                hidden & np.isfinite(truth["depth"].values[0, ::step, ::step]),
            )
        for name, (title, mask) in masks.items():
            if mask.any():
                region = self.regions.setdefault(name, {"name": name, "title": title, "maps": {}})
                region["maps"][str(t)] = self.store(pack_map(mask))

    def groups(self) -> list[dict[str, Any]]:
        """Return the description and the map indices of every quantity."""
        return list(self._groups.values())

    def _add(self, t: int, layers: ViewerLayers, step: int) -> None:
        group = self._groups.setdefault(
            layers.name,
            {
                "name": layers.name,
                "title": layers.title,
                "symbol": layers.symbol,
                "units": format_unit(layers.units) or "1",
                "codes": {str(code): word for code, word in layers.codes.items()},
                "limits": compute_display_ranges(layers),
                "maps": {},
            },
        )
        numbers: dict[str, Any] = {"step": step}
        for what, values in _stored(layers):
            packed = pack_map(values[::step, ::step], group["limits"].get(choose_scale(what)))
            self._left -= packed.size
            numbers[what] = self.store(packed)
        group["maps"][str(t)] = numbers

    def _add_lengths(self) -> None:
        """Add the endpoint errors of vectors, which the page computes from their components."""
        for name, title, parts in (
            (ENDPOINT, QUANTITIES[ENDPOINT].title, ("velocity_x", "velocity_y", "velocity_z")),
            ("flow_endpoint", "Optical flow endpoint", ("flow_x", "flow_y")),
        ):
            if all("error" in self._groups.get(part, {}).get("limits", {}) for part in parts):
                high = math.hypot(*(self._groups[part]["limits"]["error"][1] for part in parts))
                self._groups[name] = {
                    "name": name,
                    "title": title,
                    "symbol": "",
                    "units": format_unit(QUANTITIES[parts[0]].units) or "1",
                    "codes": {},
                    "limits": {"error": (0.0, high)},
                    "length_of": parts,
                    "maps": {},
                }


def _stored(layers: ViewerLayers) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the stored maps: given truth and error, the estimate is their sum; then those of fallback values."""
    maps = layers.maps
    for what, values in maps.items():
        if what == "estimate" and "error" in maps:
            rest = np.where(np.isfinite(maps["error"]), np.nan, values)
            if np.isfinite(rest).any():
                yield "rest", rest
        else:
            yield what, values
    for what, values in layers.fallback.items():
        yield FALLBACK + what, values


def _thinnings(found: Sequence[ViewerLayers], room: float) -> Iterator[tuple[ViewerLayers, int]]:
    """Yield each quantity and the subsampling step with which all fit; 0 where it does not fit."""
    sizes = []
    for layers in found:
        limits = compute_display_ranges(layers)
        sizes.append(sum(_predicted_size(values, limits.get(choose_scale(what))) for what, values in _stored(layers)))
    whole = sum(sizes)
    step = next((step for step in range(1, _COARSEST + 1) if whole * _share(step) <= room), _COARSEST)
    for layers, size in zip(found, sizes, strict=True):
        room -= size * _share(step)
        yield layers, step if room >= 0 else 0


def _share(step: int) -> float:
    """Return the relative size of a subsampled map."""
    # Differences between neighbours increase with their distance.
    return 1.0 if step == 1 else 1.2 / step**2


def _predicted_size(values: NDArray[Any], limits: tuple[float, float] | None) -> float:
    """Return the approximate number of characters of a map, predicted from a subset of its rows."""
    rows = values.shape[0]
    some = np.arange(rows) // _BAND_ROWS % _BANDS == 0 if rows >= 2 * _BAND_ROWS * _BANDS else np.ones(rows, dtype=bool)
    return float(pack_map(values[some], limits).size * rows / some.sum())
