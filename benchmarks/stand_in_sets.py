"""More stand-ins for real captures: bare surfaces, repeated things, steps of 2 to 30 px, 3 to 9 views.

Views have 280 x 210 pixels. Every second one is held out: it is looked at only to confirm what was
chosen on the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.stand_in_scenes import FOCAL_PX, OFF_PX, SPIN, TILT, TURN, board, item, twig, wall

__all__ = ["SETS", "list_sets"]

Plain = dict[str, Any]
MIDDLE_MM = 1300.0


def coplanar(
    name: str, at_px: tuple[float, float], size_px: tuple[float, float], wall_mm: float, radiance: float
) -> Plain:
    """Return a bare patch 1 mm before a wall that faces the camera."""
    patch = board(name, at_px, size_px, wall_mm - 1)
    return {**patch, "texture": {"kind": "uniform", "radiance": radiance}}


def repeated(thing: Plain, texture: Plain) -> Plain:
    """Return an object with a texture of its own."""
    return {**thing, "texture": texture}


def _on_wall(
    name: str, at_px: tuple[float, float], size_px: tuple[float, float], wall_mm: float, turn_deg: float
) -> Plain:
    """Return a board 1 mm before a wall that is turned about the vertical, in its plane."""
    depth = wall_mm / (1 + at_px[0] / FOCAL_PX * np.tan(np.radians(turn_deg))) - 1
    return board(name, at_px, size_px, depth, ((TURN, turn_deg),))


def bare_room() -> list[Plain]:
    """Return a bare wall and floor between textured boards at their rims."""
    return [
        board("bare-wall", (0, 0), (1200, 900), 2000.0, ((TURN, 15.0),)),
        board("floor", (0, 120), (900, 497), 1500.0, ((TILT, -75.0),)),
        _on_wall("picture-left", (-90, -50), (60, 50), 2000.0, 15.0),
        _on_wall("picture-right", (80, -60), (50, 60), 2000.0, 15.0),
        board("bare-front", (10, 20), (70, 60), 1250.0, ((TURN, -20.0),)),
        board("front-label", (0, 15), (16, 16), 1235.0, ((TURN, -20.0),)),
    ]


def square_before_blank() -> list[Plain]:
    """Return a textured square before a blank wall."""
    return [board("bare-wall", (0, 0), (1200, 900), 1900.0), board("square", (5, -5), (110, 100), 1200.0)]


def books() -> list[Plain]:
    """Return upright boxes with repeated patterns, side by side at slightly different depths."""
    made = [wall(2000.0)]
    for k in range(9):
        depth = 1300.0 + 25.0 * (k % 3)
        wave = (6 + k % 4) * depth / FOCAL_PX
        plaid = {"kind": "plaid", "wavelength_mm": [wave, 3 * wave], "mean": 0.3 + 0.05 * (k % 5), "amplitude": 0.15}
        made.append(repeated(board(f"book-{k}", (-120 + 29 * k, 15), (27, 110 + 9 * (k % 4)), depth), plaid))
    return [*made, board("shelf", (0, 100), (400, 30), 1250.0)]


def fine_twigs() -> list[Plain]:
    """Return twigs of 2 to 5 px before a textured wall."""
    rows = zip((-110, -75, -40, -10, 25, 60, 90, 120), (2, 3, 4, 5, 2.5, 3.5, 4.5, 3), strict=True)
    return [
        wall(2000.0),
        *(twig(f"twig-{x}", (x, 0.0), w, 300.0, 1050.0 + 60 * k, -60.0 + 23 * k, 8.0) for k, (x, w) in enumerate(rows)),
    ]


def boxes() -> list[Plain]:
    """Return slanted boxes on a floor."""
    made = [wall(2100.0, ((TURN, -10.0),)), board("floor", (0, 90), (900, 420), 1500.0, ((TILT, -72.0),))]
    for k, (x, y, edge, turn) in enumerate(((-80, 20, 150, 30.0), (20, 40, 120, 50.0), (95, 0, 170, -25.0))):
        mesh = {"kind": "box", "size_mm": [edge, edge, edge]}
        made.append(item(f"box-{k}", mesh, (x, y), 1250.0 + 100 * k, ((TURN, turn), (TILT, 15.0))))
    return made


def painted() -> list[Plain]:
    """Return a wall with bare fields of many grey values, in its own plane, and a board before it."""
    depth = 1500.0
    fields = [
        coplanar(f"bare-{k}", (-105 + 52 * (k % 5), -60 + 60 * (k // 5)), (40, 46), depth, 0.15 + 0.07 * ((k * 7) % 11))
        for k in range(15)
    ]
    return [wall(depth), *fields, board("front", (60, 40), (60, 70), 1100.0)]


def shelf() -> list[Plain]:
    """Return a bit of everything for strong changes of brightness."""
    ball = {"kind": "sphere", "radius_mm": 80, "resolution_mm": 5}
    return [
        wall(2000.0, ((TURN, 12.0),)),
        item("ball", ball, (60, 40), 1300.0),
        board("sheet", (-60, -30), (70, 90), 1500.0, ((TURN, -50.0),)),
        board("bare-sheet", (40, -60), (60, 50), 1700.0),
        twig("twig", (-110.0, 0.0), 6.0, 300.0, 1100.0, 10.0, 5.0),
        board("bar", (-10, 0), (12, 400), 1150.0, ((SPIN, -10.0),)),
    ]


def far_and_near() -> list[Plain]:
    """Return few surfaces with large disparities."""
    return [
        wall(1700.0, ((TURN, 10.0),)),
        board("left", (-80, 20), (70, 110), 1150.0, ((TURN, 35.0),)),
        board("bare-right", (70, -20), (70, 80), 1300.0, ((TURN, -15.0),)),
        board("low", (20, 85), (110, 40), 1050.0),
    ]


def bare_bodies() -> list[Plain]:
    """Return bare bodies before a textured wall."""
    ball = {"kind": "sphere", "radius_mm": 90, "resolution_mm": 5}
    cube = {"kind": "box", "size_mm": [130, 130, 130]}
    return [
        wall(1900.0, ((TURN, -12.0),)),
        item("bare-ball", ball, (-70, 20), 1350.0),
        item("bare-cube", cube, (60, 10), 1400.0, ((TURN, 35.0), (TILT, 20.0))),
        board("board", (0, -70), (110, 50), 1500.0, ((TILT, 30.0),)),
    ]


def layers() -> list[Plain]:
    """Return boards in layers, every second one bare."""
    made = [wall(2200.0)]
    for k in range(6):
        name = f"{'bare-' if k % 2 else ''}layer-{k}"
        made.append(board(name, (-90 + 40 * k, -30 + 18 * k), (90, 80), 2050.0 - 170.0 * k))
    return made


def blank_square() -> list[Plain]:
    """Return a blank square before a textured wall."""
    return [wall(1800.0, ((TURN, 25.0),)), board("bare-square", (-5, 5), (100, 90), 1250.0)]


def twigs_before_blank() -> list[Plain]:
    """Return twigs and a slanted board before a blank wall."""
    rows = zip((-110, -60, -15, 30, 80), (5, 8, 4, 10, 6), strict=True)
    return [
        board("bare-wall", (0, 0), (1200, 900), 2000.0),
        board("board", (60, 70), (130, 60), 1500.0, ((TILT, -50.0),)),
        *(
            twig(f"twig-{x}", (x, -10.0), w, 260.0, 1100.0 + 90 * k, -40.0 + 25 * k, -6.0)
            for k, (x, w) in enumerate(rows)
        ),
    ]


def _scene(make: Callable[[], list[Plain]], step_px: float, views: int, drift: float, noise: float) -> Plain:
    """Return a scene with disparities of about ``step_px`` per step."""
    off_urad = 1e6 * OFF_PX / FOCAL_PX
    return {
        "camera": {"width": 280, "height": 210, "focal_length_px": FOCAL_PX},
        "stage": {
            "positions": views,
            "baseline_mm": step_px * MIDDLE_MM / FOCAL_PX,
            "time_per_position_s": 1.0,
            "errors": {"pitch_urad": off_urad, "yaw_urad": off_urad},
        },
        "frames": {"count": 1, "frame_interval_s": 1.0},
        "objects": make(),
        "lighting": {"drift_per_frame": drift},
        "sensor": {"bit_depth": 8, "noise_std": noise},
        "seed": 29,
    }


SETS: dict[str, Plain] = {
    make.__name__: _scene(make, *values)
    for make, values in {
        bare_room: (8, 5, 0.02, 0.006),
        layers: (3, 9, 0.03, 0.006),
        square_before_blank: (10, 5, 0.02, 0.005),
        boxes: (20, 3, 0.05, 0.004),
        books: (5, 7, 0.02, 0.006),
        twigs_before_blank: (6, 7, 0.02, 0.006),
        painted: (10, 5, 0.03, 0.008),
        blank_square: (4, 7, 0.05, 0.006),
        shelf: (6, 5, 0.10, 0.006),
        fine_twigs: (3, 9, 0.02, 0.004),
        far_and_near: (30, 3, 0.02, 0.006),
        bare_bodies: (8, 5, 0.04, 0.006),
    }.items()
}
"""Scenes by name."""


def list_sets(*, held_out: bool) -> dict[str, Plain]:
    """Return the sets that are held out, or the others."""
    return {name: scene for number, (name, scene) in enumerate(SETS.items()) if (number % 2 == 1) == held_out}
