"""Leaves as sheets: triangles, outline, form."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene.leaf import LeafMesh, LeafShape, compute_entire_margin, compute_half_width_mm, compute_margin
from scenetruth.scene.mesh import TriangleMesh
from tests.helpers.nightly import nightly
from tests.helpers.scenes import cube

OUTLINES = ["ovate", "lanceolate", "cordate", "elliptic"]
WITH_LOBES = [*OUTLINES, "palmate"]
STALK = {"length_mm": 20.0, "diameter_mm": 2.0}


def leaf(**changes: Any) -> TriangleMesh:
    return leaf_entry(**changes).make()


def leaf_entry(**changes: Any) -> LeafMesh:
    return LeafMesh.model_validate({"kind": "leaf", "length_mm": 60.0, "resolution_mm": 1.5, **changes})


def corner_angles(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    corners = points[faces]
    to_next, to_last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = np.sum(to_next * to_last, axis=2) / np.linalg.norm(to_next, axis=2) / np.linalg.norm(to_last, axis=2)
    angles: NDArray[np.float64] = np.degrees(np.arccos(cosine))
    return angles


def edges_of(faces: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(pairs, axis=0, return_counts=True)
    return edges, counts


def check_sheet(mesh: TriangleMesh, entry: LeafMesh) -> None:
    assert mesh.material_mm is not None
    flat, faces = mesh.material_mm, mesh.faces
    corners = flat[faces]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    assert areas.max() < 0, "all faces wind towards -Z"
    assert len(np.unique(flat, axis=0)) == len(flat)
    assert len(np.unique(faces)) == len(flat)
    edges, counts = edges_of(faces)
    assert counts.max() == 2
    rim = edges[counts == 1]
    # One closed loop: every vertex of the boundary has two of its edges, and following them visits all.
    assert (np.bincount(rim.ravel())[np.unique(rim)] == 2).all()
    assert len(flat) - len(edges) + len(faces) == 1, "Euler's number of a disc"
    # The midrib is a line of edges from end to end.
    axis = np.flatnonzero(flat[:, 1] == 0)
    axis = axis[np.argsort(flat[axis, 0])]
    present = {tuple(edge) for edge in edges.tolist()}
    assert all((min(i, j), max(i, j)) in present for i, j in pairwise(axis))
    behind = 0.0 if entry.petiole is None else -entry.petiole.length_mm
    np.testing.assert_allclose(flat[axis[[0, -1]], 0], [behind, entry.length_mm])
    # The smallest of 300 random leaves was 22.2 degrees.
    assert corner_angles(flat, faces).min() > 15


@pytest.mark.parametrize("outline", WITH_LOBES)
@pytest.mark.parametrize("full", [False, True])
def test_triangles_are_even_and_follow_the_margin(outline: str, full: bool) -> None:
    more = {"serration": {"count_per_side": 9, "depth_mm": 0.8}, "petiole": STALK} if full else {}
    entry = leaf_entry(outline=outline, resolution_mm=1.0, **more)
    mesh = leaf(outline=outline, resolution_mm=1.0, **more)
    check_sheet(mesh, entry)
    assert mesh.material_mm is not None
    edges, _ = edges_of(mesh.faces)
    lengths = np.linalg.norm(np.diff(mesh.material_mm[edges], axis=1)[:, 0], axis=1)
    assert np.median(lengths) == pytest.approx(1.0, abs=0.02)
    assert 0.3 < lengths.min() < lengths.max() < 2.0
    # The polygon of the margin has the mesh's area but for the chords, h² / 8 of the curvature along the margin.
    corners = mesh.material_mm[mesh.faces]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2
    x, y = compute_margin(entry).points_mm.T
    assert area == pytest.approx(2 * np.trapezoid(y, x), rel=0.01)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    outline=some.sampled_from(OUTLINES),
    tip=some.sampled_from(["acuminate", "acute", "round", None]),
    width=some.floats(20, 60),
    teeth=some.integers(0, 10),
    depth=some.floats(0.1, 1.0),
    stalk=some.floats(0, 2.5),
    resolution=some.floats(0.8, 1.4),
)
def test_sheets_of_any_leaf_are_sound(
    outline: str, tip: str | None, width: float, teeth: int, depth: float, stalk: float, resolution: float
) -> None:
    entry = leaf_entry(
        outline=outline,
        tip=tip,
        width_mm=width,
        serration={"count_per_side": teeth, "depth_mm": depth} if teeth else None,
        petiole={"length_mm": 12.0, "diameter_mm": stalk} if stalk > 1.3 else None,
        resolution_mm=resolution,
    )
    check_sheet(entry.make(), entry)


@nightly
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    lobes=some.sampled_from([5, 7, 9, 11]),
    cut=some.floats(0, 0.7),
    tip=some.sampled_from(["acuminate", "acute", None]),
    width=some.floats(75, 120),
    teeth=some.integers(0, 4),
    depth=some.floats(0.1, 0.5),
    stalk=some.floats(0, 3.0),
)
def test_sheets_of_any_palmate_leaf_are_sound(
    lobes: int, cut: float, tip: str | None, width: float, teeth: int, depth: float, stalk: float
) -> None:
    entry = leaf_entry(
        outline="palmate",
        lobes=lobes,
        lobe_cut=cut,
        tip=tip,
        width_mm=width,
        serration={"count_per_side": teeth, "depth_mm": depth} if teeth else None,
        petiole={"length_mm": 20.0, "diameter_mm": stalk} if stalk > 1.3 else None,
        resolution_mm=0.75,
    )
    check_sheet(entry.make(), entry)
    margin = compute_entire_margin(entry)
    assert margin[0].tolist() == [0, 0]
    assert margin[-1].tolist() == [60, 0]
    # Half a step between the points of the margin, or less than that, is missing at the tip.
    assert margin[:, 1].max() == pytest.approx(width / 2, abs=0.1)


@pytest.mark.parametrize("lobes", [5, 7, 9, 11])
def test_lobes_are_as_many_as_asked_and_their_sinuses_as_deep(lobes: int) -> None:
    entry = leaf_entry(outline="palmate", lobes=lobes, lobe_cut=0.6)
    margin = compute_entire_margin(entry, 20_000)
    away = np.hypot(*margin.T)
    inner = away[1:-1]
    tips = 1 + np.flatnonzero((inner > away[:-2]) & (inner > away[2:]))
    sinuses = 1 + np.flatnonzero((inner < away[:-2]) & (inner < away[2:]))
    assert len(tips) == len(sinuses) == (lobes - 1) // 2
    # From the hindmost lobe on, which is the shortest, to the middle one; over about 300 degrees together.
    lengths = away[[*tips, len(away) - 1]]
    assert (np.diff(lengths) > 0).all()
    assert 270 < 2 * np.degrees(np.arctan2(*margin[tips[0], ::-1])) < 310
    # The line through a sinus half-way between two tips, crossed by the line that joins these.
    tops = margin[[*tips, len(margin) - 1]]
    for one, other, sinus in zip(tops[:-1], tops[1:], sinuses, strict=True):
        middle = one / np.hypot(*one) + other / np.hypot(*other)
        middle /= np.hypot(*middle)
        share, crossing = np.linalg.solve(np.column_stack([one - other, middle]), one)
        assert 0 < share < 1
        # Points of the margin stand 0.02 mm apart at most, and the sinus is flat there.
        assert away[sinus] == pytest.approx(0.4 * crossing, rel=0.05)
        assert away[sinus] <= 0.4 * crossing + 0.02


def test_deeper_cuts_leave_less_of_the_leaf() -> None:
    areas = []
    for cut in (0.0, 0.2, 0.4, 0.6, 0.7):
        x, y = compute_entire_margin(leaf_entry(outline="palmate", lobe_cut=cut, resolution_mm=0.5)).T
        areas.append(float(np.sum((x[:-1] - x[1:]) * (y[:-1] + y[1:]))))
    assert (np.diff(np.abs(areas)) < 0).all()


def test_width_along_the_midrib_is_refused_for_lobes() -> None:
    with pytest.raises(ValueError, match="not a function of the position"):
        compute_half_width_mm(leaf_entry(outline="palmate"), np.array([1.0]))


@pytest.mark.parametrize("outline", OUTLINES)
def test_outline_has_its_length_and_width(outline: str) -> None:
    entry = leaf_entry(outline=outline, width_mm=31.0)
    margin = compute_entire_margin(entry)
    assert margin[0].tolist() == [0, 0]
    assert margin[-1].tolist() == [60, 0]
    # The formula is scaled by the largest of 4001 points.
    assert margin[:, 1].max() == pytest.approx(15.5, rel=1e-6)
    assert compute_half_width_mm(entry, np.array([-5.0, 0.0, 60.0, 61.0])).tolist() == [0, 0, 0, 0]
    assert margin[:, 0].min() == pytest.approx(-0.16 * 60 if outline == "cordate" else 0, abs=1e-3)


def test_teeth_point_to_the_tip_and_stay_within_the_outline() -> None:
    entry = leaf_entry(serration={"count_per_side": 10, "depth_mm": 1.0})
    plain, toothed = compute_entire_margin(entry), compute_margin(entry).points_mm
    cut = np.linalg.norm(plain - toothed, axis=1)
    assert 0.95 < cut.max() <= 1.0 + 1e-12
    middle = slice(len(cut) // 4, 3 * len(cut) // 4)
    # Towards the tip, margins rise slowly to the tip of a tooth and fall quickly behind it.
    assert np.mean(np.diff(cut[middle]) < 0) > 0.65


def test_chart_and_uv_are_the_flat_sheet() -> None:
    mesh = leaf(outline="cordate", petiole=STALK, bend_along_deg=80, fold_deg=30)
    assert mesh.material_mm is not None
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.chart_mm, mesh.material_mm[mesh.faces])
    blade = mesh.material_mm[mesh.faces][..., 0].min(axis=1) > -9
    assert mesh.uv[blade].min() == pytest.approx(0, abs=0.01)
    assert mesh.uv[blade].max() == pytest.approx(1, abs=0.01)
    assert mesh.crease_deg == 60


@pytest.mark.parametrize("bend", [{"bend_along_deg": 150.0}, {"bend_across_deg": -120.0}])
def test_bending_keeps_lengths_at_second_order(bend: dict[str, float]) -> None:
    changes = []
    for resolution in (1.5, 0.75):
        mesh = leaf(resolution_mm=resolution, petiole=STALK, **bend)
        assert mesh.material_mm is not None
        edges, _ = edges_of(mesh.faces)
        flat = np.linalg.norm(np.diff(mesh.material_mm[edges], axis=1)[:, 0], axis=1)
        bent = np.linalg.norm(np.diff(mesh.vertices_mm[edges], axis=1)[:, 0], axis=1)
        changes.append(np.abs(bent / flat - 1).max())
    # A chord is shorter than its arc by (k h)² / 24, edges are up to about 1.4 h long.
    curvature = max(np.radians(150) / 60, np.radians(120) / (0.62 * 60))
    assert changes[0] < (curvature * 1.5 * 1.5) ** 2 / 24
    assert changes[0] / changes[1] == pytest.approx(4, rel=0.3)


def test_metric_of_bending_is_exact() -> None:
    """The first fundamental form, by central differences in extended precision, is the identity."""
    step = np.longdouble(1e-6)
    generator = np.random.default_rng(1)
    a, b = generator.uniform(-20, 60, 50).astype(np.longdouble), generator.uniform(-15, 15, 50).astype(np.longdouble)
    for shape in (LeafShape(along_per_mm=0.03), LeafShape(across_per_mm=-0.05)):

        def at(x: Any, y: Any, shape: LeafShape = shape) -> NDArray[np.longdouble]:
            points = np.stack(shape((x, y, 0 * x), np.zeros(1)))
            assert points.dtype == np.longdouble
            return points

        along = (at(a + step, b) - at(a - step, b)) / (2 * step)
        across = (at(a, b + step) - at(a, b - step)) / (2 * step)
        # Truncation (k step)² / 6 = 1e-16, rounding 1e-19 * 60 / 1e-6.
        for found, expected in (((along**2).sum(0), 1), ((across**2).sum(0), 1), ((along * across).sum(0), 0)):
            np.testing.assert_allclose(found.astype(float), expected, atol=1e-11)


def test_form_has_the_stated_signs_and_angles() -> None:
    """Positive values lift tip and margins towards the upper side, -Z."""

    def ends(**changes: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        mesh = leaf(outline="elliptic", width_mm=30, **changes)
        assert mesh.material_mm is not None
        tip = np.argmax(mesh.material_mm[:, 0])
        side = np.argmax(mesh.material_mm[:, 1])
        return mesh.vertices_mm[tip], mesh.vertices_mm[side]

    tip, _ = ends(bend_along_deg=90.0)
    radius = 60 / (np.pi / 2)
    np.testing.assert_allclose(tip, [radius, 0, -radius])
    _, side = ends(bend_across_deg=180.0)
    assert side[2] == pytest.approx(-15 / (np.pi / 2), rel=0.02)
    _, side = ends(fold_deg=60.0, fold_width_mm=0.01)
    assert side[2] == pytest.approx(-15 * np.sin(np.radians(30)), rel=0.01)
    assert leaf(undulation={"amplitude_mm": 2.0}).vertices_mm[:, 2].max() == pytest.approx(2, rel=0.1)
    assert np.ptp(leaf().vertices_mm[:, 2]) == 0


@pytest.mark.parametrize(
    ("changes", "path", "message"),
    [
        ({"width_mm": 0}, "width_mm", "greater than 0"),
        ({"width_mm": 500}, "width_mm", "must be between 1/50 and 2"),
        ({"outline": "ovate", "lobe_depth": 0.2}, "lobe_depth", "only a cordate outline has lobes"),
        ({"serration": {"depth_mm": 20}}, "serration", "depth_mm must not exceed"),
        ({"serration": {"count_per_side": 60, "depth_mm": 0.1}}, "resolution_mm", "teeth and petiole to be resolved"),
        ({"petiole": {"length_mm": 20, "diameter_mm": 30}}, "petiole", "diameter_mm must not exceed"),
        ({"outline": "ovate", "lobes": 7}, "lobes", "requires a palmate outline, not ovate"),
        ({"lobe_cut": 0.4}, "lobe_cut", "requires a palmate outline, not ovate"),
        ({"outline": "palmate", "lobes": 6}, "lobes", "must be odd"),
        ({"outline": "palmate", "lobes": 13}, "lobes", "less than or equal to 11"),
        ({"outline": "palmate", "lobe_cut": 0.8}, "lobe_cut", "less than or equal to 0.7"),
        (
            {"outline": "palmate", "lobes": 11, "lobe_cut": 0.7, "resolution_mm": 2},
            "resolution_mm",
            "narrower for a deeper cut",
        ),
        ({"outline": "palmate", "tip": "round"}, "tip", "acuminate or acute"),
        ({"outline": "palmate", "width_mm": 30}, "width_mm", "must be at least 48"),
        ({"outline": "palmate", "serration": {"depth_mm": 3}}, "serration", "an eighth of the narrowest lobe"),
        ({"outline": "palmate", "petiole": {"length_mm": 20, "diameter_mm": 5}}, "petiole", "a twentieth"),
        ({"bend_along_deg": 360}, "bend_along_deg", "less than 360"),
        ({"bend_along_deg": -300, "petiole": STALK}, "bend_along_deg", "blade and petiole together by 400"),
        ({"bend_across_deg": -360}, "bend_across_deg", "greater than -360"),
        ({"resolution_mm": 30}, "resolution_mm", "must not exceed"),
        ({"resolution_mm": 0.001}, "resolution_mm", "triangles, more than 5e6"),
    ],
)
def test_impossible_leaves_are_refused_with_their_path(changes: dict[str, Any], path: str, message: str) -> None:
    mesh = {"kind": "leaf", "length_mm": 60.0, **changes}
    plain = cube().to_dict()
    plain["objects"][0]["mesh"] = mesh
    with pytest.raises(st.SceneError) as caught:
        st.scene.Scene.from_dict(plain)
    (problem,) = caught.value.problems
    assert problem.path == f"objects.0.mesh.{path}"
    assert message in problem.message


def test_small_leaf_with_default_resolution_is_told_to_be_finer() -> None:
    with pytest.raises(ValueError, match=r"must not exceed 0\.31"):
        LeafMesh.model_validate({"kind": "leaf", "length_mm": 2.0})
