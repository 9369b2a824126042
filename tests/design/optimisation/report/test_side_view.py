"""The side view of a rig: outlines and depths against geometry, and drawings measured with their own scale bars."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenetruth.camera import Defocus, Optics
from scenetruth.design.optimisation import (
    SideView,
    choose_round_length_mm,
    compute_depth_of_field,
    compute_outline,
    compute_side_view,
    describe_side_view,
    draw_side_views,
)
from tests.helpers.sample_design import scene

# Corners of a cube and its twelve triangles.
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
SQUARES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
FACES = np.array([[s[0], s[k], s[k + 1]] for s in SQUARES for k in (1, 2)], dtype=np.int32)


def box(size_mm: tuple[float, float, float], angle: float, distance_mm: float = 600.0) -> np.ndarray:
    """Return the corners of a box that is turned about Y."""
    x, y, z = (CORNERS * size_mm).T
    turned = [np.cos(angle) * x + np.sin(angle) * z, y, -np.sin(angle) * x + np.cos(angle) * z + distance_mm]
    return np.stack(turned, axis=-1)


@given(
    st.tuples(*[st.floats(1.0, 100.0)] * 3),
    st.floats(0.0, math.pi),
)
def test_the_outline_of_a_turned_box_has_the_area_of_its_rectangle(size_mm: Any, angle: float) -> None:
    x, near, far = compute_outline(box(size_mm, angle), FACES)
    # Its corners are places of the outline, between which it is straight: the trapezoidal rule is exact.
    area = np.trapezoid(far - near, x)
    assert area == pytest.approx(size_mm[0] * size_mm[2], rel=1e-6)
    assert (np.diff(x) > 0).all()


def span_at(x_mm: float, vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
    """Return the least and largest Z of triangles at an X, edge by edge."""
    found = []
    for face in faces:
        for k in range(3):
            (x0, _, z0), (x1, _, z1) = vertices[face[k]], vertices[face[k - 1]]
            if min(x0, x1) <= x_mm <= max(x0, x1):
                found += [z0, z1] if x0 == x1 else [z0 + (z1 - z0) * (x_mm - x0) / (x1 - x0)]
    return min(found), max(found)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_the_outline_of_any_mesh_is_that_of_its_edges_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # On a grid, some edges run along Z.
    vertices = rng.integers(-5, 6, size=(30, 3)) + [0.0, 0.0, 100.0]
    faces = rng.permuted(np.tile(np.arange(30), (20, 1)), axis=1)[:, :3].astype(np.int32)
    x, near, far = compute_outline(vertices, faces)
    for place in range(0, len(x), 7):
        assert (near[place], far[place]) == pytest.approx(span_at(x[place], vertices, faces))


@given(st.floats(0.5, 20.0), st.floats(200.0, 2000.0), st.floats(500.0, 8000.0), st.floats(0.1, 3.0))
def test_blur_reaches_its_limit_at_both_ends_of_the_depth_of_field(
    aperture_mm: float, focus_mm: float, focal_px: float, limit_px: float
) -> None:
    lens = Defocus(aperture_mm=aperture_mm, focus_distance_mm=focus_mm)
    sharp = compute_depth_of_field(Optics(defocus=lens), focal_px, limit_px)
    assert sharp is not None
    ends = np.array([sharp.near_mm, sharp.far_mm])
    finite = ends[np.isfinite(ends)]
    assert lens.blur_diameter_px(finite, focal_px) == pytest.approx(limit_px, rel=1e-9)
    if math.isinf(sharp.far_mm):
        assert lens.blur_diameter_px(np.array([1e12]), focal_px)[0] <= limit_px * (1 + 1e-6)
    assert compute_depth_of_field(Optics(), focal_px, limit_px) is None


@pytest.fixture(scope="module")
def view() -> SideView:
    return compute_side_view(scene(), 0.8, "object_sheet")


def test_the_view_is_that_of_the_scene(view: SideView) -> None:
    focal_px = 25.0 / 0.0078
    assert view.cameras_mm == (-16.0, -8.0, 0.0, 8.0, 16.0)
    assert view.reference == 2
    assert view.field_mm(600.0) == pytest.approx((320 * 600 / focal_px, 240 * 600 / focal_px))
    assert view.common_mm(600.0) == pytest.approx(320 * 600 / focal_px - 32)
    assert view.common_mm(view.common_from_mm) == pytest.approx(0, abs=1e-9)
    sheet, backdrop = view.outlines
    # A sheet 40 mm wide, turned by 25 degrees, its middle at X = 2 and Z = 600.
    assert sheet.x_mm[-1] - sheet.x_mm[0] == pytest.approx(40 * math.cos(math.radians(25)))
    assert max(sheet.far_mm) - min(sheet.near_mm) == pytest.approx(40 * math.sin(math.radians(25)))
    assert (min(backdrop.near_mm), max(backdrop.far_mm)) == pytest.approx((644, 656))
    # All of the sheet is seen, but for what lies between the points that are looked at: 2 mm.
    assert sheet.seen_mm == pytest.approx((600 - 8.452, 600 + 8.452), abs=1.0)
    assert backdrop.seen_mm == pytest.approx((644, 644))
    # The depth of one of these points.
    assert view.seen_mm[1] == pytest.approx(600, abs=1.0)
    # All that is seen is mostly the backdrop.
    assert compute_side_view(scene()).seen_mm[1] == pytest.approx(644)


def test_words_tell_the_same(view: SideView) -> None:
    text = describe_side_view(view)
    assert "5 camera positions over 32 mm along X" in text
    middle = view.seen_mm[1]
    width, height = view.field_mm(middle)
    assert f"field of view {width:.1f} x {height:.1f} mm at {middle:.0f} mm, of which all positions see" in text
    assert "blur under 0.8 px from 595 to 637 mm" in text


def corners_of(svg: str, kind: str) -> list[np.ndarray]:
    """Return the corners of all areas of a class."""
    found = re.findall(rf'<path class="{kind}"[^>]* d="M([^"]*)Z"', svg)
    return [np.array([[float(n) for n in place.split(",")] for place in one.split("L")]) for one in found]


def scale_of(svg: str) -> float:
    """Return units of the drawing per mm, by its scale bar."""
    lines = re.findall(r'<line class="bar" x1="([^"]*)" y1="([^"]*)" x2="([^"]*)" y2="([^"]*)"/>', svg)
    u0, v0, u1, v1 = map(float, lines[0])
    assert v0 == v1
    told = re.findall(r">([0-9.]+) mm</text>", svg[svg.index('class="bar"') :])[0]
    return (u1 - u0) / float(told)


@settings(max_examples=15)
@given(st.floats(0.2, 60.0), st.integers(2, 9), st.floats(6.0, 60.0))
def test_drawings_measured_by_their_scale_bars_are_the_rig(baseline_mm: float, positions: int, focal_mm: float) -> None:
    plain = scene(baseline_mm, positions)
    plain["camera"]["focal_length_mm"] = focal_mm
    drawings = {one.name: one.svg for one in draw_side_views(compute_side_view(plain))}
    assert {"whole", "upright"} <= set(drawings)
    for name, svg in drawings.items():
        # Coordinates have two decimals, of a bar of 40 units and more.
        scale = scale_of(svg)
        if name != "object":
            tips = np.array([one[0] for kind in ("camera", "camera reference") for one in corners_of(svg, kind)])
            travel = np.ptp(tips, axis=0).max() / scale
            assert travel == pytest.approx((positions - 1) * baseline_mm, rel=1e-3, abs=0.02 / scale)
        # The angle of view needs no scale.
        (field,) = corners_of(svg, "field")
        across, ahead = (np.ptp(field, axis=0)[k] for k in ((0, 1) if name == "upright" else (1, 0)))
        assert across / ahead == pytest.approx(320 * 0.0078 / focal_mm, rel=5e-3)
        (sheet, _) = corners_of(svg, "outline")
        deep = np.ptp(sheet, axis=0)[1 if name == "upright" else 0] / scale
        assert deep == pytest.approx(40 * math.sin(math.radians(25)), rel=2e-2, abs=0.05 / scale)


def test_x_goes_down_where_z_goes_right_and_right_where_z_goes_up(view: SideView) -> None:
    drawings = {one.name: one.svg for one in draw_side_views(view)}
    (lying, _), (upright, _) = (corners_of(drawings[name], "outline") for name in ("whole", "upright"))
    # The first corner is at the least X; turned by +25 degrees about Y, Z falls with X.
    assert lying[0][1] < lying[len(lying) // 2 - 1][1]
    assert lying[0][0] > lying[len(lying) // 2 - 1][0]
    assert upright[0][0] < upright[len(upright) // 2 - 1][0]
    assert upright[0][1] < upright[len(upright) // 2 - 1][1]


def test_odd_rigs_are_drawn_too() -> None:
    alone = scene()
    alone["stage"] = {"positions": 1, "baseline_mm": 1}
    del alone["optics"]
    names = [one.name for one in draw_side_views(compute_side_view(alone))]
    assert names == ["whole", "upright", "object"]
    assert "one camera position" in describe_side_view(compute_side_view(alone))
    grid = scene()
    grid["stage"] |= {"rows": 3, "row_spacing_mm": 5}
    grid["optics"]["defocus"]["aperture_mm"] = 0.05
    told = describe_side_view(compute_side_view(grid))
    assert "3 rows of positions in Y" in told
    assert "∞" in told
    # Nothing is before the camera: the objects are shown where they are.
    aside = scene()
    for one in aside["objects"]:
        one["pose"]["position_mm"][0] = 5000.0
    away = compute_side_view(aside)
    assert all(one.seen_mm is None for one in away.outlines)
    assert len(draw_side_views(away)) >= 2


@given(st.floats(1e-6, 1e6))
def test_scale_bars_have_round_lengths(most_mm: float) -> None:
    length = choose_round_length_mm(most_mm)
    assert 0.4 * most_mm <= length <= most_mm * (1 + 1e-6)
    assert f"{length:.3e}"[0] in "125"
    assert f"{length:.3e}"[1:5] == ".000"
