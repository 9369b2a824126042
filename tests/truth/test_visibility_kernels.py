"""Who sees a surface point: against every triangle, one by one, by another formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.simulation import make_truth
from scenetruth.truth import TruthOptions, truth_from_world
from tests.helpers.nightly import nightly
from tests.helpers.occluding_gate import gate
from tests.helpers.scenes import cube

Array = NDArray[np.float64]


def seen_by_force(points: Array, own: NDArray[np.int64], sides: Array, corners: Array, x_mm: float) -> tuple[Any, Any]:
    """Ask every triangle whether it stands between a camera on the axis and each point (Möller and Trumbore).

    Returns which points are seen, and which rays pass within 1e-6 px (at a focal length of 400 px) of a triangle's edge
    or meet something within rounding of the point: their answer is rounding's.
    """
    origin = np.array([x_mm, 0.0, 0.0])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.einsum("ij,ij->i", normals[own], origin - points)
    seen = np.sign(facing) == sides
    unsure = np.zeros(len(points), dtype=bool)
    one, two, start = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], origin - corners[:, 0]
    # All rays start at the camera: a triple product with a ray is linear in it, one product of matrices for all.
    q = np.cross(start, one)
    of_determinant, of_u, of_share = np.cross(two, one), np.cross(two, start), np.einsum("ij,ij->i", two, q)
    for part in np.array_split(np.arange(len(points)), len(points) // 256 + 1):
        rays = points[part] - origin
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (rays @ of_determinant.T)
            u, v, share = rays @ of_u.T * inverse, rays @ q.T * inverse, of_share * inverse
        other = np.arange(len(corners)) != own[part, None]
        before = other & (share > 0) & (share < 1 - 1e-9)
        seen[part] &= ~(before & (u >= 0) & (v >= 0) & (u + v <= 1)).any(axis=1)
        # An edge is met within 1e-6 px if a barycentric coordinate is that small, of triangles of some 10 to 100 px.
        near = np.minimum(np.minimum(np.abs(u), np.abs(v)), np.abs(1 - u - v)) < 1e-7
        unsure[part] = (before & near).any(axis=1)
    return seen, unsure


def check_against_force(scene: Scene) -> dict[str, int]:
    """Compare `visible` and the occlusion masks of a scene, on an ideal stage, with brute force; return counts."""
    world = build_scene(scene)
    # One world for both: plants take seconds to build.
    truth = truth_from_world(scene, world, TruthOptions(), {})
    size = (scene.camera.height, scene.camera.width)
    counts = {"points": 0, "hidden": 0, "different": 0, "unsure": 0}
    vertices = {int(t): world.at(float(t)).vertices_mm for t in scene.frames.t}
    rays = scene.camera.ray_directions(scene.camera.pixel_grid())

    def ask(t: int, s: int, at: int) -> tuple[Any, Any, Any]:
        """Whether camera s at another time sees the points of frame t."""
        body = truth["object_id"].sel(t=t).values
        here = body >= 0
        face = world.face_offsets[body[here]] + truth["face_id"].sel(t=t).values[here]
        b = truth["barycentric"].sel(t=t).values[:, here].T
        corners, then = vertices[t][world.faces], vertices[at][world.faces]
        weights = np.column_stack([1 - b.sum(axis=1), b])
        where = np.einsum("nc,ncx->nx", weights, corners[face])
        # The points themselves: depth along the pixels' rays.
        np.testing.assert_allclose(where, rays[here] * truth["depth"].sel(t=t).values[here][:, None], atol=1e-9)
        normals = np.cross(corners[face, 1] - corners[face, 0], corners[face, 2] - corners[face, 0])
        sides = np.sign(np.einsum("ij,ij->i", normals, -where))
        points = np.einsum("nc,ncx->nx", weights, then[face])
        x_mm = float(scene.stage.x_mm[list(scene.stage.s).index(s)])
        seen, unsure = seen_by_force(points, face, sides, then, x_mm)
        pixels = scene.camera.project(points, x_mm)
        seen &= ((pixels >= -0.5) & (pixels <= np.array(size[::-1]) - 0.5)).all(axis=1)
        return here, seen, unsure

    def compare(found: Any, expected: Any, unsure: Any) -> None:
        counts["points"] += expected.size
        counts["hidden"] += int((~expected).sum())
        counts["different"] += int(((found != expected) & ~unsure).sum())
        counts["unsure"] += int(unsure.sum())

    times, cameras = scene.frames.t.tolist(), scene.stage.s.tolist()
    for t in times:
        for s in cameras:
            here, seen, unsure = ask(0, s, t)
            compare(truth["visible"].sel(s=s, t=t).values[here], seen, unsure)
            assert not truth["visible"].sel(s=s, t=t).values[~here].any()
        answers = [ask(t, s, t) for s in cameras]
        here = answers[0][0]
        count = sum(seen.astype(int) for _, seen, _ in answers)
        doubt = np.any([unsure for _, _, unsure in answers], axis=0)
        compare(truth["view_count"].sel(t=t).values[here] == count, np.ones_like(doubt), doubt)
        compare(truth["occluded_across_cameras"].sel(t=t).values[here], count < len(cameras), doubt)
        answers = [ask(t, 0, other) for other in (t - 1, t + 1) if other in times]
        lost = np.any([~seen for _, seen, _ in answers], axis=0)
        doubt = np.any([unsure for _, _, unsure in answers], axis=0)
        compare(truth["occluded_in_time"].sel(t=t).values[here], lost, doubt)
    return counts


def test_visible_against_brute_force() -> None:
    counts = check_against_force(gate())
    assert counts["different"] == 0
    assert counts["unsure"] <= 1e-3 * counts["points"]
    assert counts["hidden"] > 0.02 * counts["points"]


def test_the_reference_image_shows_its_own_points() -> None:
    scene = cube(frames={"count": 3})
    truth = make_truth(scene)
    surface = np.isfinite(truth["depth"].sel(t=0).values)
    assert (truth["visible"].sel(s=0, t=0).values == surface).all()
    assert (truth["view_count"].values[np.isfinite(truth["depth"].values)] >= 1).all()
    assert not truth["view_count"].values[np.isnan(truth["depth"].values)].any()


def test_the_other_side_of_a_sheet_is_another_surface() -> None:
    # The plane turns by 100 degrees in one frame, so that the camera looks at its back.
    item = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [40, 40]},
        "pose": {"position_mm": [0, 0, 600], "rotations": [{"axis": [0, 1, 0], "angle_deg": 10}]},
        "texture": {"kind": "uniform"},
        "motion": [{"kind": "rotation", "axis": [0, 1, 0], "rate_deg_per_frame": 150}],
    }
    truth = make_truth(gate(objects=[item]))
    surface = truth["object_id"].sel(t=0).values >= 0
    assert surface.any()
    assert truth["visible"].sel(s=0, t=0).values[surface].all()
    assert not truth["visible"].sel(s=0, t=1).values.any()
    assert truth["occluded_in_time"].sel(t=0).values[surface].all()


@pytest.mark.parametrize("views", ["reference", "all"])
def test_views_and_rows_have_their_dimensions(views: Any) -> None:
    stage = {"positions": 3, "baseline_mm": 12.0, "rows": 3, "row_spacing_mm": 9.0}
    scene = gate(stage=stage, camera={"width": 24, "height": 18, "focal_length_px": 160})
    truth = make_truth(scene, truth_views=views)
    assert truth["visible"].dims == ("s_y", "s", "t", "y", "x")
    lead = () if views == "reference" else ("s_y", "s")
    assert truth["view_count"].dims == (*lead, "t", "y", "x")
    assert int(truth["view_count"].max()) == 9


def rosette(width: int, height: int, resolution_mm: float, count: int = 3) -> Scene:
    plain: dict[str, Any] = {
        "camera": {"width": width, "height": height, "focal_length_px": 4.2 * width},
        "stage": {"positions": 3, "baseline_mm": 20.0},
        "frames": {"count": count, "frame_interval_s": 60},
        "objects": [
            {
                "name": "soil",
                "mesh": {"kind": "plane", "size_mm": [200, 160]},
                "pose": {"position_mm": [0, 0, 640]},
                "texture": {"kind": "uniform"},
            }
        ],
        "plants": [
            {
                "kind": "rosette",
                "name": "plant",
                "position_mm": [0, 0, 615],
                "leaves": 6,
                "stem_mm": 12,
                "elevation_deg": [6, 65],
                "leaf": {
                    "kind": "leaf",
                    "length_mm": 52,
                    "width_mm": 34,
                    "petiole": {"length_mm": 14, "diameter_mm": 4},
                    "bend_along_deg": -70,
                    "fold_deg": 40,
                    "resolution_mm": resolution_mm,
                },
                "texture": {"kind": "leaf", "texels_per_mm": 5.1},
                "growth": {"kind": "growth", "rate_per_hour": 0.03, "base_to_tip": [1.5, 0.5]},
                "nutation_deg": 25,
                "nutation_period_frames": 7,
            }
        ],
        "render": {"backend": "raycast"},
    }
    return Scene.from_dict(plain)


@nightly
@pytest.mark.filterwarnings("ignore:objects. the texture")
def test_visible_on_a_rosette_against_brute_force() -> None:
    counts = check_against_force(rosette(44, 34, 4.0))
    assert counts["different"] == 0
    assert counts["unsure"] <= 1e-3 * counts["points"]
    assert counts["hidden"] > 0.02 * counts["points"]


@pytest.mark.filterwarnings("ignore:objects. the texture")
def test_no_pixel_of_a_rosette_is_hidden_alone() -> None:
    scene = rosette(200, 150, 1.0, count=1)
    truth = make_truth(scene)
    for s in scene.stage.s.tolist():
        hidden = ~truth["visible"].sel(s=s, t=0).values & (truth["object_id"].sel(t=0).values >= 0)
        around = sum(np.roll(hidden, (dy, dx), axis=(0, 1)).astype(int) for dy in (-1, 0, 1) for dx in (-1, 0, 1))
        alone = (hidden & (around == 1)) | (~hidden & (around == 8))
        # Where silhouettes cross, single pixels may well be hidden or not.
        alone &= truth["boundary_distance"].sel(t=0).values > 1.5
        assert hidden.any() or s == 0
        assert not alone[1:-1, 1:-1].any()
