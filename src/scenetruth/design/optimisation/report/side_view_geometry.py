"""Geometry of the side view of a rig, along Y: cameras, outlines, fields of view and depth of field."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Optics
from scenetruth.design.prediction.surface_samples import SurfaceSamples, sample_surface
from scenetruth.resources import Limits, limited_objects
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene

__all__ = ["DepthOfFieldRange", "Outline", "SideView", "compute_depth_of_field", "compute_outline", "compute_side_view"]


Array = NDArray[np.float64]

_PLACES = 161  # number of sampled X coordinates of an outline, which is linear between them
_FEW = 200  # largest number of vertices of a mesh whose vertices are sampled too, to preserve corners


def compute_outline(vertices_mm: Array, faces: NDArray[np.int32]) -> tuple[Array, Array, Array]:
    """Return the depth range of a mesh over X.

    ``vertices_mm``: Vertices, shape (n, 3).
    ``faces``: Triangles, shape (m, 3).
    Returns: X in ascending order, smallest Z and largest Z, in mm; only X with mesh points.
    """
    corners = vertices_mm[:, ::2]
    first, second = (faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel())
    start, end = corners[first], corners[second]
    turned = start[:, 0] > end[:, 0]
    start[turned], end[turned] = end[turned], start[turned].copy()
    places = np.linspace(corners[:, 0].min(), corners[:, 0].max(), _PLACES)
    if len(corners) <= _FEW:
        places = np.union1d(places, corners[:, 0])
    low = np.searchsorted(places, start[:, 0], side="left")
    high = np.searchsorted(places, end[:, 0], side="right")
    counts = high - low
    edge = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + low[edge]
    across = (end - start)[edge, 0]
    steep = across <= 0  # both ends of an edge parallel to Z are used
    share = np.where(steep, 0.0, (places[place] - start[edge, 0]) / np.where(steep, 1.0, across))
    z_mm = start[edge, 1] + share * (end - start)[edge, 1]
    near, far = np.full(len(places), np.inf), np.full(len(places), -np.inf)
    for depths in (z_mm, np.where(steep, end[edge, 1], z_mm)):
        np.minimum.at(near, place, depths)
        np.maximum.at(far, place, depths)
    there = np.isfinite(near)
    return places[there], near[there], far[there]


@dataclass(frozen=True)
class Outline:
    """An object seen along Y: smallest and largest Z by X."""

    name: str
    x_mm: tuple[float, ...]
    near_mm: tuple[float, ...]
    far_mm: tuple[float, ...]
    seen_mm: tuple[float, float] | None  # depth range visible from the reference camera; None if not visible


@dataclass(frozen=True)
class DepthOfFieldRange:
    """The depth of field of a thin lens: depths with a blur disc up to a limit; ``far_mm`` may be infinite."""

    focus_mm: float
    near_mm: float
    far_mm: float
    limit_px: float


@dataclass(frozen=True)
class SideView:
    """A rig seen along Y at the reference frame."""

    cameras_mm: tuple[float, ...]  # X at Z = 0, in order along the stage
    reference: int  # index of the reference position
    left: float  # slopes X / Z and Y / Z of the rays at the image borders
    right: float
    top: float
    bottom: float
    outlines: tuple[Outline, ...]
    seen_mm: tuple[float, float, float]  # smallest, median (measured region), and largest visible depth
    sharp: DepthOfFieldRange | None  # depth of field; None for a scene without defocus
    rows: int  # of camera positions in Y

    @property
    def travel_mm(self) -> float:
        """Distance between the outermost camera positions."""
        return max(self.cameras_mm) - min(self.cameras_mm)

    @property
    def common_from_mm(self) -> float:
        """Smallest depth with a field of view common to all positions."""
        return self.travel_mm / (self.right - self.left)

    def field_mm(self, z_mm: float) -> tuple[float, float]:
        """Return the width and height of the reference camera's field of view at a depth."""
        return (self.right - self.left) * z_mm, (self.bottom - self.top) * z_mm

    def common_mm(self, z_mm: float) -> float:
        """Return the width of the field of view common to all positions at a depth; 0 if there is none."""
        return max(self.field_mm(z_mm)[0] - self.travel_mm, 0.0)


def compute_side_view(plain: Mapping[str, Any], limit_px: float = 1.0, region: str = "all") -> SideView:
    """Return the side view of the rig of a scene."""
    scene = Scene.from_dict(plain)
    # Overflows of invalid motions are reported by other checks.
    with np.errstate(all="ignore"):
        look = sample_surface(scene, limited_objects(scene, Limits()))
    camera, stage = scene.camera, scene.stage
    c_x, c_y = camera.principal_point
    borders = [(-0.5, c_y), (camera.width - 0.5, c_y), (c_x, -0.5), (c_x, camera.height - 0.5)]
    (left, _, _), (right, _, _), (_, top, _), (_, bottom, _) = camera.ray_directions(borders).tolist()
    outlines = _outlines(scene, look)
    return SideView(
        tuple(stage.x_mm.tolist()),
        stage.s.tolist().index(0),
        left,
        right,
        top,
        bottom,
        outlines,
        _seen(look, outlines, region),
        compute_depth_of_field(scene.optics, camera.focal_px, limit_px),
        stage.rows,
    )


def compute_depth_of_field(optics: Optics, focal_px: float, limit_px: float) -> DepthOfFieldRange | None:
    """Return the depth of field of a lens, whose blur disc is f A |1/Z - 1/Z_f| px (`scenetruth.camera.Defocus`)."""
    lens = optics.defocus
    if lens is None:
        return None
    focus, off = 1 / lens.focus_distance_mm, limit_px / (focal_px * lens.aperture_mm)
    far = 1 / (focus - off) if focus > off else math.inf
    return DepthOfFieldRange(lens.focus_distance_mm, 1 / (focus + off), far, limit_px)


def _outlines(scene: Scene, look: SurfaceSamples) -> tuple[Outline, ...]:
    outlines = []
    for body in build_scene(scene, painted=False).bodies:
        x, near, far = compute_outline(body.positions_at(0.0), body.faces)
        depths = _depths(look, body.name)
        seen = (float(depths.min()), float(depths.max())) if len(depths) else None
        outlines.append(Outline(body.name, tuple(x.tolist()), tuple(near.tolist()), tuple(far.tolist()), seen))
    return tuple(outlines)


def _depths(look: SurfaceSamples, name: str) -> NDArray[np.float64]:
    own = [look.names[number] == name for number in look.body.tolist()]
    return look.depth_mm[np.array(own, dtype=np.bool_)]


def _seen(look: SurfaceSamples, outlines: tuple[Outline, ...], region: str) -> tuple[float, float, float]:
    if len(look):
        depths = look.depth_mm
    else:
        # No object is visible at the reference frame: the depths of all objects are used.
        depths = np.array([depth for one in outlines for depth in (*one.near_mm, *one.far_mm)])
    measured = _depths(look, region.removeprefix("object_"))
    return float(depths.min()), float(np.median(measured if len(measured) else depths)), float(depths.max())
