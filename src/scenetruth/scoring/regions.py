"""The regions of the image over which errors are evaluated."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import read_object_names
from scenetruth.settings import ScoreSettings

__all__ = [
    "REGIONS",
    "describe_region",
    "edge_distance",
    "further_regions",
    "is_further_region",
    "main_regions",
    "region_masks",
    "title_region",
    "visible_throughout",
]

Mask = NDArray[np.bool_]

REGIONS = ("all", "interior")
"""Names of the regions of every score, in the order of reports."""

_NUMBER = r"[0-9][0-9.e+-]*"
_FURTHER = re.compile(
    rf"nonoccluded|occluded|specular|shadow_boundary|(slope|boundary)_{_NUMBER}_({_NUMBER}|inf)|contrast_(low|mid|high)|object_.+"
)


def region_masks(
    depth: NDArray[np.floating],
    mixed: Mask,
    margin_px: float = 20.0,
    distance_px: NDArray[np.floating] | None = None,
) -> dict[str, Mask]:
    """Return the boolean masks of the regions ``all`` and ``interior`` by name, each of the shape (..., y, x).

    ``all`` holds every pixel with a surface in the truth. ``interior`` holds those whose centre is at least
    ``margin_px`` from the centre of every mixed pixel of the same frame, that is, from silhouettes and creases. The
    image border is not excluded.

    ``depth``: True depth in mm; NaN where there is no surface.
    ``distance_px``: Distance of every pixel to the nearest mixed pixel; default: computed from ``mixed``. Required for
      parts of an image and for subsampled images.

    >>> depth, mixed = np.ones((1, 5)), np.array([[True, False, False, False, False]])
    >>> region_masks(depth, mixed, margin_px=3)["interior"]
    array([[False, False, False,  True,  True]])
    """
    if not (math.isfinite(margin_px) and margin_px >= 0):
        raise ScoreError([Problem("margin_px", "must be a finite number, not negative", margin_px)])
    seen = np.isfinite(depth)
    distance = edge_distance(mixed) if distance_px is None else distance_px
    return {"all": seen, "interior": seen & (distance >= margin_px)}


def main_regions(truth: xr.Dataset, margin_px: float) -> dict[str, Mask]:
    """Return `region_masks` of an aligned truth, which may cover only a part of the image."""
    mixed = truth["mixed"].values.astype(bool)
    return region_masks(truth["depth"].values, mixed, margin_px, truth["boundary_distance"].values)


def edge_distance(mixed: Mask) -> NDArray[np.float64]:
    """Return the distance in px from every pixel centre to the nearest mixed pixel centre of its frame, or infinity."""
    edges = np.asarray(mixed, dtype=bool)
    distance = np.full(edges.shape, np.inf)
    for frame in np.ndindex(edges.shape[:-2]):
        # The distance transform is undefined without mixed pixels.
        if edges[frame].any():
            distance[frame] = ndimage.distance_transform_edt(~edges[frame])
    return distance


def is_further_region(name: str) -> bool:
    """Return whether a name belongs to a region of `further_regions`."""
    return _FURTHER.fullmatch(name) is not None


def visible_throughout(truth: xr.Dataset) -> Mask | None:
    """Return where the point at t = 0 is visible to all cameras in all frames, (y, x); None without ``visible``."""
    if "visible" not in truth:
        return None
    visible = truth["visible"]
    others = [str(dim) for dim in visible.dims if dim not in ("y", "x")]
    throughout = np.ones([visible.sizes[dim] for dim in ("y", "x")], dtype=bool)
    for place in np.ndindex(*(visible.sizes[dim] for dim in others)):
        throughout &= _flags(visible.isel(dict(zip(others, place, strict=True))))
    return throughout


def further_regions(
    truth: xr.Dataset,
    interior: Mask,
    settings: ScoreSettings,
    *,
    throughout: Mask | None = None,
    contrast: NDArray[np.float64] | None = None,
) -> dict[str, Mask]:
    """Return the masks of the regions that depend on the content of the truth.

    - ``nonoccluded``: pixels whose point is visible to all cameras in this frame and to the reference camera in the
      frames before and after; at t = 0, if ``throughout`` is given, to all cameras in all frames. ``occluded``: the
      other pixels with a surface.
    - ``slope_LOW_HIGH`` (degrees): classes LOW ≤ angle < HIGH of the angle between ``normal`` and the optical axis,
      over the visible pixels of the interior; ``contrast_low``, ``contrast_mid``, ``contrast_high`` (of the texture)
      and ``object_NAME`` (if there are several) over the same pixels.
    - ``specular``: visible pixels of the interior whose radiance has a share of at least ``settings.specular_share`` of
      specular light in any band, and ``shadow_boundary``: those within ``settings.shadow_width_px`` of a border of a
      shadow.
    - ``boundary_LOW_HIGH`` (px): classes of the distance to the nearest mixed pixel, over all visible pixels.

    Without occlusion maps all pixels are treated as visible. ``contrast`` is a fraction of full scale, (t, y, x).
    """
    seen = np.isfinite(truth["depth"].values)
    visible = seen
    regions: dict[str, Mask] = {}
    if "occluded_across_cameras" in truth and "occluded_in_time" in truth:
        visible = seen & ~_flags(truth["occluded_across_cameras"]) & ~_flags(truth["occluded_in_time"])
        if throughout is not None:
            visible[truth["t"].values == 0] &= throughout
        regions |= {"nonoccluded": visible, "occluded": seen & ~visible}
    inner = interior & visible
    if "normal" in truth:
        facing = np.abs(truth["normal"].sel(component="Z").values)
        angle = np.degrees(np.arccos(np.minimum(facing, 1.0)))
        # An angle of 90 degrees (edge-on) belongs to the last class.
        bounds = settings.slope_classes_deg
        regions |= _classes("slope", np.where(angle == bounds[-1], np.nextafter(bounds[-1], 0), angle), bounds, inner)
    if "boundary_distance" in truth:
        distance = truth["boundary_distance"].values
    else:
        distance = edge_distance(truth["mixed"].values.astype(bool))
    regions |= _classes("boundary", distance, (*settings.boundary_classes_px, math.inf), visible)
    if "specular_share" in truth:
        # NaN on black surfaces.
        shining = truth["specular_share"].fillna(0) >= settings.specular_share
        regions["specular"] = inner & (shining.any("channel") if "channel" in shining.dims else shining).values
    if "shadow_distance" in truth:
        regions["shadow_boundary"] = inner & (truth["shadow_distance"].values <= settings.shadow_width_px)
    if contrast is not None:
        low, high = settings.contrast_classes
        regions |= {
            "contrast_low": inner & (contrast < low),
            "contrast_mid": inner & (contrast >= low) & (contrast < high),
            "contrast_high": inner & (contrast >= high),
        }
    return regions | _objects(truth, inner)


def _objects(truth: xr.Dataset, among: Mask) -> dict[str, Mask]:
    names = read_object_names(truth)
    if "object_id" not in truth or len(names) < 2:
        return {}
    # Indices read as floats are NaN where there is no object.
    number = np.nan_to_num(truth["object_id"].values.astype(np.float64), nan=-1)
    masks = {f"object_{name}": among & (number == index) for index, name in enumerate(names)}
    return {region: mask for region, mask in masks.items() if mask.any()}


def _classes(name: str, values: NDArray[np.float64], bounds: Sequence[float], among: Mask) -> dict[str, Mask]:
    return {
        f"{name}_{low:g}_{high:g}": among & (values >= low) & ((values < high) | (high == math.inf))
        for low, high in pairwise(bounds)
    }


def _flags(values: xr.DataArray) -> Mask:
    """Return flags as booleans; flags read as floats are NaN where undefined."""
    return np.asarray(np.nan_to_num(values.values).astype(bool))


def title_region(region: str) -> str:
    """Return the title of a region in a table.

    >>> tuple(title_region(name) for name in ("all", "occluded", "boundary_0_5", "object_leaf 3"))
    ('all', 'occluded or outside an image', '0 to 5 px from an edge', 'object “leaf 3”')
    """
    if region in REGIONS:
        return region
    words = describe_region(region)
    for start in ("where the point is ", "where the ", "on the ", "within ", "in ", "on ", "at "):
        if words.startswith(start) and not words.startswith("at least"):
            words = words.removeprefix(start)
            break
    return words.replace(" of an edge", " from an edge")


def describe_region(region: str) -> str:
    """Return the position of a region as text.

    >>> tuple(describe_region(name) for name in ("boundary_0_5", "boundary_20_inf", "slope_45_70", "object_leaf 3"))
    ('within 0 to 5 px of an edge', 'at least 20 px from an edge', 'on slopes of 45 to 70°', 'on the object “leaf 3”')
    """
    fixed = {
        "nonoccluded": "where the point is visible in all images",
        "occluded": "where the point is occluded or outside an image",
        "specular": "in highlights",
        "shadow_boundary": "at borders of shadows",
        "contrast_low": "where the contrast is low",
        "contrast_mid": "where the contrast is medium",
        "contrast_high": "where the contrast is high",
    }
    if region in fixed:
        return fixed[region]
    if region.startswith("object_"):
        return f"on the object “{region.removeprefix('object_')}”"
    bounds = re.fullmatch(r"(slope|boundary)_([^_]+)_([^_]+)", region)
    if bounds is None:
        return f"in the region “{region}”"
    kind, low, high = bounds.groups()
    if kind == "slope":
        return f"on slopes of {low} to {high}°"
    return f"at least {low} px from an edge" if high == "inf" else f"within {low} to {high} px of an edge"
