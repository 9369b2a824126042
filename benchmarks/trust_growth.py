"""Sheets, saddles and leaves that grow alike, or not alike, along and across."""

from __future__ import annotations

from typing import Any

from benchmarks.trust import Plain, noise, plane, rig

__all__ = ["GROUPS", "SCENES"]


GROWTH = ("base_to_tip", "base_mm", "tip_mm")
GRADIENT: Plain = {"base_to_tip": (4.0, 0.0), "base_mm": -55, "tip_mm": 55}


def sheet(rate_per_hour: float, share: float | None, *, texture: Plain | None = None, **more: Any) -> Plain:
    """Return a scene of a growing sheet with its share of growth along X; None for isotropic growth."""
    growth: Plain = {"kind": "growth", "rate_per_hour": rate_per_hour}
    growth |= {name: more.pop(name) for name in GROWTH if name in more}
    if share is not None:
        growth["along_share"] = share
    return rig([plane(texture or noise(4, 20), deformation=[growth], **more)])


def saddle(rate_per_hour: float, share: float | None, curvature_per_mm: float = 0.01, **more: Any) -> Plain:
    """Return a scene of a growing saddle."""
    mesh = {"kind": "saddle", "size_mm": [80, 64], "curvature_per_mm": curvature_per_mm}
    return sheet(rate_per_hour, share, mesh=mesh, **more)


def leaf(rate_per_hour: float, share: float | None, **more: Any) -> Plain:
    """Return a scene of a leaf that grows faster at its base than at its tip."""
    growth: Plain = {"kind": "growth", "rate_per_hour": rate_per_hour, "base_to_tip": [1.5, 0.5]}
    if share is not None:
        growth["along_share"] = share
    mesh = {
        "kind": "leaf",
        "outline": "ovate",
        "length_mm": 56,
        "width_mm": 44,
        "bend_along_deg": -20,
        "bend_across_deg": -20,
        "fold_deg": 15,
        "resolution_mm": 0.7,
    }
    rotations = [{"axis": [0, 1, 0], "angle_deg": 8}, {"axis": [0, 0, 1], "angle_deg": 10}]
    pose = {"position_mm": [-26, 0, 600], "rotations": rotations}
    blade = {
        "name": "leaf",
        "mesh": mesh,
        "texture": {"kind": "leaf", "channel": "green"},
        "pose": pose,
        "deformation": [growth],
        **more,
    }
    soil = {
        "name": "soil",
        "mesh": {"kind": "plane", "size_mm": [200, 160]},
        "pose": {"position_mm": [0, 0, 640]},
        "texture": noise(4, 24),
    }
    return rig([blade, soil], sensor={"noise_std": 0.002})


# Rates of several per cent an hour and a minute between frames, as plants have them, and others for clear signals.
SCENES: dict[str, Plain] = {
    "sheet 0.7": sheet(0.3, 0.7),
    "sheet -0.5": sheet(0.3, -0.5),
    "sheet 2": sheet(0.3, 2.0),
    "sheet 0.9": sheet(0.3, 0.9),
    "sheet 0.3, weak": sheet(0.1, 0.3),
    "sheet 1.5": sheet(0.1, 1.5),
    "saddle 0.9": saddle(0.3, 0.9),
    "saddle 0": saddle(0.2, 0.0),
    "saddle 1.5": saddle(0.2, 1.5),
    "leaf 0.7": leaf(0.3, 0.7),
    "leaf 1": leaf(0.15, 1.0),
    "leaf 0.2": leaf(0.3, 0.2),
    "isotropic sheet": sheet(0.3, None),
    "isotropic saddle": saddle(0.2, None),
    "isotropic leaf": leaf(0.3, None),
    "isotropic sheet, slow": sheet(0.03, None),
    "still sheet": sheet(0.0, None),
    "isotropic sheet, coarse": sheet(0.2, None, texture=noise(8, 40)),
    # The bias of isotropic growth is 0.4 to 3 standard deviations of anisotropic growth.
    "sheet 0.9, 0.01": sheet(0.01, 0.9),
    "sheet 0.9, 0.02": sheet(0.02, 0.9),
    "sheet 0.1, 0.015": sheet(0.015, 0.1),
    "sheet 0.9, 0.04": sheet(0.04, 0.9),
    "sheet 0.9, 0.08": sheet(0.08, 0.9),
    "sheet 0.2, 0.05": sheet(0.05, 0.2),
    "saddle 1, 0.03": saddle(0.03, 1.0),
    "saddle 1, 0.1": saddle(0.1, 1.0),
    "saddle 0.2, 0.06": saddle(0.06, 0.2),
    "leaf 0.6, 0.03": leaf(0.03, 0.6),
    "leaf 0.6, 0.1": leaf(0.1, 0.6),
    "leaf 0.8, 0.06": leaf(0.06, 0.8),
    # Growth changes within windows: by its whole over 28 mm.
    "gradient, isotropic": saddle(0.3, None, 0.002, **GRADIENT),
    "gradient 0.7": saddle(0.3, 0.7, 0.002, **GRADIENT),
    "gradient 0.3, coarse": saddle(0.3, 0.3, 0.002, texture=noise(8, 40), **GRADIENT),
}

GROUPS: dict[str, str] = {
    "anisotropic growth: sheets, saddles, leaves": r"(sheet|saddle|leaf|gradient) -?[0-9]",
    "isotropic growth, and none": r"isotropic|still",
}
"""Rows of the summary, and what the names of their scenes contain."""
