"""Scenes that stand in for real captures: sharp outlines at many depths, thin things, slants and untextured patches.

One time, five views, 480 x 360 pixels. What real captures have is in all of them: every view 2 % brighter than the one
before, views that are turned so that each is off the reference by 0.2 px along x and along y (root of the mean square;
the recording does not know), noise, 8 bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["SCENES", "UNTEXTURED", "scene_of"]

FOCAL_PX = 600.0
# Disparity is 12 px per step at 1 m.
BASELINE_MM = 20.0
# Along x and along y, both of the reference and of the other view.
OFF_PX = 0.2 / 2**0.5
# Objects whose names begin with this have no texture.
UNTEXTURED = "bare"
Plain = dict[str, Any]
Turns = tuple[tuple[tuple[int, int, int], float], ...]
TILT, TURN, SPIN = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def item(name: str, mesh: Plain, at_px: tuple[float, float], depth_mm: float, turns: Turns = ()) -> Plain:
    """Return an object whose origin is seen at a place in px from the image's middle."""
    pixel_mm = depth_mm / FOCAL_PX
    position = [at_px[0] * pixel_mm, at_px[1] * pixel_mm, depth_mm]
    # Waves of 2.5 to 60 px with the same power in every octave, as in natural images; each object is as bright as no
    # other nearby.
    tone = sum(map(ord, name)) % 5
    noise = {"kind": "noise", "wavelength_mm": [2.5 * pixel_mm, 60 * pixel_mm], "spectrum_exponent": -2}
    texture: Plain = {**noise, "mean": 0.3 + 0.08 * tone, "rms_contrast": 0.13}
    if name.startswith(UNTEXTURED):
        texture = {"kind": "uniform", "radiance": 0.3 + 0.08 * tone}
    rotations = [{"axis": list(axis), "angle_deg": angle} for axis, angle in turns]
    return {"name": name, "mesh": mesh, "texture": texture, "pose": {"position_mm": position, "rotations": rotations}}


def board(
    name: str, at_px: tuple[float, float], size_px: tuple[float, float], depth_mm: float, turns: Turns = ()
) -> Plain:
    """Return a rectangle that has this size in the image if it faces the camera."""
    size_mm = [each * depth_mm / FOCAL_PX for each in size_px]
    return item(name, {"kind": "plane", "size_mm": size_mm}, at_px, depth_mm, turns)


def twig(
    name: str,
    at_px: tuple[float, float],
    width_px: float,
    length_px: float,
    depth_mm: float,
    lean_deg: float,
    tilt_deg: float,
) -> Plain:
    """Return a thin cylinder, upright but for its lean in the image and its tilt away from the camera."""
    pixel_mm = depth_mm / FOCAL_PX
    mesh = {"kind": "cylinder", "radius_mm": width_px * pixel_mm / 2, "length_mm": length_px * pixel_mm, "caps": True}
    mesh["resolution_mm"] = width_px * pixel_mm / 6
    return item(name, mesh, at_px, depth_mm, ((TILT, tilt_deg), (SPIN, lean_deg)))


def wall(depth_mm: float = 2400.0, turns: Turns = ()) -> Plain:
    """Return a background beyond the edges of all images."""
    return board("wall", (0, 0), (1200, 900), depth_mm, turns)


def stairs() -> list[Plain]:
    """Return boards one in front of the other, each with its left and its upper edge in view."""
    depths = (2100.0, 1850.0, 1600.0, 1400.0, 1200.0, 1050.0)
    corners = [(-195 + 62 * k, -140 + 46 * k) for k in range(len(depths))]
    return [wall()] + [
        board(f"step-{k}", (x + 400, y + 300), (800, 600), depth)
        for k, ((x, y), depth) in enumerate(zip(corners, depths, strict=True))
    ]


def bars() -> list[Plain]:
    """Return bars of 8 to 30 px, upright, leaning and level."""
    rows = (
        (-205, 30, 1100, 0), (-150, 8, 1500, 6), (-105, 20, 1000, -4), (-50, 12, 1300, 0), (0, 26, 1700, 14),
        (55, 10, 1050, 0), (110, 16, 1600, -18), (160, 8, 1200, 0), (205, 22, 1400, 5),
    )  # fmt: skip
    upright = [board(f"bar-{x}", (x, 0), (width, 700), depth, ((SPIN, lean),)) for x, width, depth, lean in rows]
    level = [board("rail-high", (0, -110), (900, 14), 1900.0), board("rail-low", (0, 100), (900, 9), 1850.0)]
    return [wall(2200.0), *upright, *level]


def twigs() -> list[Plain]:
    """Return twigs of 4 to 10 px in all directions."""
    drawn = np.random.default_rng(7)
    rows = zip(np.linspace(-210, 210, 14), np.tile((4, 6, 8, 10, 5, 7, 9), 2), strict=True)
    made = []
    for number, (x, width) in enumerate(rows):
        y, depth, length = drawn.uniform(-90, 90), drawn.uniform(1000, 1600), drawn.uniform(200, 420)
        lean, tilt = drawn.uniform(-80, 80), drawn.uniform(-25, 25)
        made.append(twig(f"twig-{number}", (float(x), y), float(width), length, depth, lean, tilt))
    return [wall(2000.0), *made]


def slanted() -> list[Plain]:
    """Return a floor, a cube with an edge towards the camera, and boards turned by up to 65 degrees."""
    cube = {"kind": "box", "size_mm": [260, 260, 260]}
    return [
        wall(2400.0, ((TURN, 20.0),)),
        board("floor", (0, 110), (900, 497), 1500.0, ((TILT, -75.0),)),
        item("cube", cube, (-120, 20), 1350.0, ((TURN, 40.0), (TILT, 20.0))),
        board("board-right", (130, -20), (230, 190), 1250.0, ((TURN, -60.0),)),
        board("board-high", (-40, -120), (200, 160), 1500.0, ((TILT, 65.0),)),
    ]


def untextured() -> list[Plain]:
    """Return bare patches of 12 to 100 px on a slanted wall and on a board before it, and a bare board."""
    turned = 20.0
    wall_mm = 2000.0
    front = board("front", (110, 40), (190, 200), 1250.0)
    things = [wall(wall_mm, ((TURN, turned),)), front]
    for x, y, size in ((-190, -120, 50), (-110, -110, 100), (-20, -130, 25), (30, -120, 12), (-200, 0, 12)):
        # Where the wall is seen at (x, y), 1 mm before it; x / f = X / (Z - X tan).
        sight = x / FOCAL_PX
        depth = wall_mm / (1 + sight * np.tan(np.radians(turned))) - 1
        things.append(board(f"{UNTEXTURED}-wall-{x}", (x, y), (size, size), depth, ((TURN, turned),)))
    for x, y, size in ((60, -10, 25), (130, 10, 70), (60, 90, 50), (150, 100, 12)):
        things.append(board(f"{UNTEXTURED}-front-{y}", (x, y), (size, size), 1249.0))
    return [*things, board(f"{UNTEXTURED}-board", (-120, 80), (70, 110), 1500.0)]


def still_life() -> list[Plain]:
    """Return a bit of everything."""
    ball = {"kind": "sphere", "radius_mm": 110, "resolution_mm": 5}
    cube = {"kind": "box", "size_mm": [220, 220, 220]}
    return [
        wall(2300.0, ((TURN, -15.0),)),
        board("floor", (0, 110), (900, 497), 1500.0, ((TILT, -75.0),)),
        item("ball", ball, (90, 70), 1300.0),
        item("cube", cube, (-70, 50), 1500.0, ((TURN, 35.0), (TILT, 15.0))),
        board("sheet", (170, -70), (120, 160), 1700.0, ((TURN, -50.0),)),
        board("bare-sheet", (20, -90), (90, 80), 1900.0),
        *(
            twig(f"twig-{k}", (x, -20.0), width, 420.0, depth, lean, tilt)
            for k, (x, width, depth, lean, tilt) in enumerate(
                ((-170.0, 6.0, 1150.0, 12.0, 10.0), (-140.0, 4.0, 1250.0, -30.0, -8.0), (210.0, 9.0, 1050.0, 4.0, 0.0))
            )
        ),
        board("bar", (-20, 0), (16, 700), 1080.0, ((SPIN, -10.0),)),
    ]


SCENES = {each.__name__: each for each in (stairs, bars, twigs, slanted, untextured, still_life)}
"""What stands in each scene, by name."""


def scene_of(name: str, parts: int = 1) -> Plain:
    """Return a scene with all that goes wrong in a real capture; one of ``parts`` > 1 is smaller in pixels.

    Brightness drifts from view to view because the stage takes as long for a position as a frame lasts.
    """
    focal = FOCAL_PX / parts
    off_urad = 1e6 * OFF_PX / focal
    return {
        "camera": {"width": 480 // parts, "height": 360 // parts, "focal_length_px": focal},
        "stage": {
            "positions": 5,
            "baseline_mm": BASELINE_MM,
            "time_per_position_s": 1.0,
            "errors": {"pitch_urad": off_urad, "yaw_urad": off_urad},
        },
        "frames": {"count": 1, "frame_interval_s": 1.0},
        "objects": SCENES[name](),
        "lighting": {"drift_per_frame": 0.02},
        "sensor": {"bit_depth": 8, "noise_std": 0.006},
        "seed": 11 + list(SCENES).index(name),
    }
