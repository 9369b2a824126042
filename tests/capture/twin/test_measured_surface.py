"""Surfaces of twins: smoothing within the uncertainty, cuts at discontinuities, meshes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from scenetruth.camera import Camera
from scenetruth.capture.twin import Canvas, find_parts, mesh_part, smooth_map

SHAPE = (60, 80)


def planar(a: float, b: float) -> np.ndarray:
    y, x = np.indices(SHAPE, dtype=np.float64)
    return 600 + a * (x - 40) + b * (y - 30)


def canvas(margin: int = 10) -> Canvas:
    return Canvas(Camera(width=SHAPE[1], height=SHAPE[0], focal_length_px=1000), margin)


@given(a=st.floats(-0.5, 0.5), b=st.floats(-0.5, 0.5), seed=st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_noise_of_a_plane_is_removed_without_a_bias_at_the_border(a: float, b: float, seed: int) -> None:
    plane, std = planar(a, b), 0.1
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), 2.0)
    noise *= std / noise.std()
    error = smooth_map(plane + noise, np.full(SHAPE, std)) - plane
    # Correlated over 2 px, the noise has 4800 / (4 π 2²) = 95 independent values: a plane leaves 0.18 of it.
    assert np.sqrt(np.mean(error**2)) < 0.5 * std
    # Without noise local planes are exact, also at the border.
    assert np.abs(smooth_map(plane, np.full(SHAPE, std)) - plane).max() < 1e-3 * (1 + 40 * (abs(a) + abs(b)))


def test_the_noise_of_correlated_errors_is_removed_and_a_crease_is_kept() -> None:
    """Noise that is much wider at the border, as of an estimate: the surface follows neither it nor its correlation."""
    y, x = np.indices((120, 160), dtype=np.float64)
    roof = 600 + 0.5 * np.abs(x - 80) + 0.1 * y
    border = np.minimum.reduce([x, y, 159 - x, 119 - y])
    std = 0.1 * (1 + 4 * np.exp(-border / 5))
    drawn = gaussian_filter(np.random.default_rng(4).standard_normal(roof.shape), 5.0)
    measured = roof + std * drawn / drawn.std()
    error = smooth_map(measured, std) - roof
    outside, band = np.abs(x - 80) > 20, border < 10
    # An independent measure of noise that becomes structure: bends over 6 px. 10 x 120 px have 18 independent errors.
    bends = [np.abs(np.diff(each, 2, axis=1))[:, 6:-6] for each in (error[:, ::6], (measured - roof)[:, ::6])]
    assert np.sqrt(np.mean(error[outside & band] ** 2)) < 0.5 * np.sqrt(np.mean(std[outside & band] ** 2))
    assert np.mean(bends[0][:, 0]) < 0.5 * np.mean(bends[1][:, 0])
    # A plane over the crease would be off by 0.5 x 24 / sqrt(2 pi) = 4.8 mm, twice as much as its error in the middle.
    assert np.abs(error[20:-20, 78:83]).max() < 1.5


def test_structure_above_the_uncertainty_remains() -> None:
    _, x = np.indices(SHAPE, dtype=np.float64)
    wave = 600 + 2 * np.sin(2 * np.pi * x / 20)
    rough = smooth_map(wave, np.full(SHAPE, 0.02))
    smooth = smooth_map(wave, np.full(SHAPE, 20.0))
    assert np.abs(rough - wave)[:, 10:-10].max() < 0.3
    assert np.abs(smooth - wave)[:, 10:-10].max() > 1.5


def test_gaps_are_filled_by_planes() -> None:
    plane = planar(0.2, -0.1)
    holes = plane.copy()
    holes[20:35, 30:50] = np.nan
    holes[:, :8] = np.nan
    assert np.abs(smooth_map(holes, np.full(SHAPE, 0.05)) - plane).max() < 0.05


def test_surfaces_are_cut_at_discontinuities_and_continue_behind() -> None:
    depth = planar(0.05, 0.0)
    depth[20:40, 30:60] = 550
    place = canvas()
    wall, plate = find_parts(place, depth, np.full(SHAPE, 0.05), reach_mm=10.0)
    assert not (wall.front & plate.front).any()
    # All pixels of canvas and image belong to a surface.
    assert (wall.front | plate.front).all()
    inside = place.crop(plate.front)
    assert inside.sum() == 20 * 30
    assert np.abs(place.crop(plate.depth_mm)[20:40, 30:60] - 550).max() < 1e-6
    hidden = wall.mask & ~wall.front
    # The parallax between both is 1000 x 10 x (1 / 550 - 1 / 600) = 1.5 px, and 6 px more are kept.
    assert hidden[place.margin + 30, place.margin + 30 + 6]
    assert not hidden[place.margin + 30, place.margin + 45]
    assert (wall.depth_mm[hidden] > 590).all()
    # Nothing of the plate lies in front of the wall that the reference image shows.
    assert (plate.mask == plate.front).all()


def test_a_steep_surface_is_not_cut() -> None:
    # 75° to the line of sight: tan(75°) 600 / 1000 = 2.2 mm per pixel.
    parts = find_parts(canvas(), planar(2.2, 0.0), np.full(SHAPE, 0.01), 10.0)
    assert len(parts) == 1


def test_single_pixels_are_no_surface() -> None:
    depth = planar(0.0, 0.0)
    depth[10, 10] = 300
    (part,) = find_parts(canvas(), depth, np.full(SHAPE, 0.05), 10.0)
    assert abs(part.depth_mm[20, 20] - 600) < 1e-6
    assert find_parts(canvas(), np.full(SHAPE, np.nan), np.full(SHAPE, np.nan), 10.0) == []


def test_wrong_matches_in_a_hole_are_no_surface_and_surfaces_that_touch_leave_no_gap() -> None:
    depth = planar(0.0, 0.0)
    depth[20:30, 30:40] = 610  # 100 px, at a wrong depth
    (part,) = find_parts(canvas(), depth, np.full(SHAPE, 0.05), 10.0)
    assert part.front.all()
    assert np.abs(part.depth_mm - 600).max() < 0.5
    # Behind a gap of 2 px a surface recedes by 1 mm per row from the depth of the other: both meshes reach over the gap
    # where they touch, in the first rows, as well as where it is hidden.
    depth = planar(0.0, 0.0)
    depth[:, 40:42] = np.nan
    depth[:, 42:] += np.arange(SHAPE[0])[:, None]
    parts = find_parts(canvas(), depth, np.full(SHAPE, 0.05), 10.0)
    assert len(parts) == 2
    assert (np.sum([part.mask for part in parts], axis=0)[10:65, 49:51] == 2).all()
    assert (np.sum([part.front for part in parts], axis=0) == 1).all()


@pytest.mark.parametrize(("step_mm", "count"), [(0.0, 1), (4.0, 1), (30.0, 2)])
def test_surfaces_continue_over_gaps_without_a_jump(step_mm: float, count: int) -> None:
    """Islands of valid pixels on one surface, with gaps of 6 px, are one surface, unless their depths differ."""
    depth = planar(0.2, 0.1)
    depth[:, 40:] += step_mm  # a slope of 60° is 1.04 mm per pixel at 600 mm, over 7 px
    depth[:, 37:43] = np.nan
    depth[27:33] = np.nan
    parts = find_parts(canvas(), depth, np.full(SHAPE, 0.05), 10.0)
    assert len(parts) == count
    assert sum(part.measured.sum() for part in parts) == np.isfinite(depth).sum()
    if step_mm == 0:
        assert np.abs(parts[0].depth_mm - parts[0].depth_mm.mean()).max() < 30
        assert np.abs(canvas().crop(parts[0].depth_mm) - planar(0.2, 0.1)).max() < 0.05


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_mesh_has_its_vertices_on_the_surface_and_covers_it(step: int) -> None:
    place = canvas()
    (part,) = find_parts(place, planar(0.3, 0.1), np.full(SHAPE, 0.05), 10.0)
    mesh = mesh_part(part, step)
    assert mesh is not None
    vertices = np.asarray(mesh.at_vertices(place.rays * part.depth_mm[..., None]))
    pixels = place.camera.project(vertices) + place.margin
    assert np.abs(pixels - mesh.places[:, ::-1]).max() < 1e-9
    corners = pixels[mesh.faces]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    # All triangles have one sense of rotation, and together the area of the canvas.
    assert (np.sign(area) == np.sign(area[0])).all()
    height, width = place.shape
    assert abs(np.abs(area).sum() - (height - 1) * (width - 1)) < 1e-6


def test_surfaces_end_where_they_are_not_measured_but_not_at_the_border_of_the_image() -> None:
    depth = planar(0.1, 0.0)
    depth[:8] = np.nan  # a band that a method leaves out at the border
    depth[25:32, 20:28] = np.nan  # a gap within the surface
    depth[:, 50:] = np.nan  # no surface
    place = canvas()
    (part,) = find_parts(place, depth, np.full(SHAPE, 0.05), 10.0)
    inside = place.crop(part.front)
    assert inside[:, :53].all()
    assert not inside[20:40, 54:].any()
    # The margin next to the surface belongs to it, at a distance from it nothing does.
    assert part.front[: place.margin, : place.margin + 50].all()
    assert not part.front[:, place.margin + 78 :].any()


def test_pixels_that_show_a_surface_belong_to_the_nearest_one() -> None:
    depth = planar(0.1, 0.0)
    depth[:, 40:] = np.nan
    shown = np.zeros(SHAPE, dtype=bool)
    shown[:, :48] = True
    place = canvas()
    (part,) = find_parts(place, depth, np.full(SHAPE, 0.05), 10.0, shown)
    inside = place.crop(part.front)
    assert inside[:, :48].all()
    assert not inside[20:40, 52:].any()
    assert np.abs(place.crop(part.depth_mm) - planar(0.1, 0.0))[:, :48].max() < 0.05
