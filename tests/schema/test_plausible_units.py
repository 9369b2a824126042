"""Values in another unit are asked for by name; plausible rigs are not."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

import scenetruth as st
from scenetruth.schema.plausible_units import (
    describe_disparities,
    describe_distance,
    describe_estimated_depth,
    describe_positions,
    describe_rig,
)

DISPARITY_PX = 4
FOCAL_PX, BASELINE_MM = 800.0, 5.0
DEPTH_MM = FOCAL_PX * BASELINE_MM / DISPARITY_PX


def plane(focal_px: float = FOCAL_PX, baseline_mm: float = BASELINE_MM, **given: Any) -> xr.Dataset:
    """Return real images of a plane at `DEPTH_MM`, with the intrinsics of a user."""
    texture = gaussian_filter(np.random.default_rng(3).uniform(0, 1, (60, 140)), 1.2)
    texture = (texture - texture.min()) / np.ptp(texture)
    images = [[texture[:, 30 + DISPARITY_PX * s : 110 + DISPARITY_PX * s]] * 3 for s in (-1, 0, 1)]
    return st.make_recording(np.array(images), focal_px, baseline_mm, **given)


def messages(call: Any) -> list[str]:
    """Return the texts of the warnings of a call."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return [str(item.message) for item in caught]


def test_plausible_images_are_not_asked_for_anything() -> None:
    assert messages(lambda: st.estimate(plane(), "plane_sweep")) == []
    assert messages(lambda: st.estimate(plane(attrs={"distance_mm": 1.5 * DEPTH_MM}), "plane_sweep")) == []


@pytest.mark.parametrize("method", ["plane_sweep", "structure_tensor"])
def test_a_focal_length_in_mm_is_named_after_the_estimate(method: str) -> None:
    # 25 mm on pixels of 31.25 µm; a field of view of 116° alone is no reason.
    recording = plane(25.0)
    (text,) = messages(lambda: st.estimate(recording, method))
    assert text.startswith(f"method '{method}': depth: the median of 31.")
    assert "6.2" in text or "6.3" in text
    assert "is focal_length_px (25) in mm?" in text


@pytest.mark.parametrize(
    ("focal_px", "baseline_mm", "distance_mm", "expected"),
    [
        (FOCAL_PX, 0.005, None, "is baseline_mm (0.005) in m?"),
        (FOCAL_PX, 4900.0, None, "is baseline_mm (4900) in µm"),
        (FOCAL_PX, 0.2, 40_000.0, "or baseline_mm = 200 (stated: 0.2) would agree; is the baseline in m?"),
        (200.0, BASELINE_MM, DEPTH_MM, "focal_length_px = 800 (stated: 200)"),
    ],
)
def test_a_depth_of_another_unit_is_named(
    focal_px: float, baseline_mm: float, distance_mm: float | None, expected: str
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SceneWarning)
        recording = plane(focal_px, baseline_mm, attrs={} if distance_mm is None else {"distance_mm": distance_mm})
    found = messages(lambda: st.estimate(recording, "plane_sweep"))
    assert [text for text in found if expected in text], found


def test_depths_in_m_of_another_program_are_named() -> None:
    recording = plane()
    (text,) = messages(lambda: st.make_estimate(recording=recording, depth=np.full((3, 60, 80), DEPTH_MM / 1000)))
    assert "the median of 1 mm is a disparity of 4000 px between neighbouring images of 80 px width" in text
    assert text.endswith("is depth in m?")
    assert messages(lambda: st.make_estimate(recording=recording, depth=np.full((3, 60, 80), DEPTH_MM))) == []


def test_simulated_recordings_have_the_units_of_their_scene() -> None:
    recording = plane(25.0)
    recording.attrs["scene_hash"] = "0" * 16
    assert messages(lambda: st.estimate(recording, "plane_sweep")) == []


@pytest.mark.parametrize(
    ("method", "settings", "expected"),
    [
        ("plane_sweep", {"disparity_px": (0.0, 400.0)}, "disparity_px: disparities of 0 to 400 px"),
        ("structure_tensor", {"working_point_px": 4}, ""),
        ("plane_sweep", {"disparity_px": (2.0, 6.0)}, ""),
    ],
)
def test_disparities_beyond_the_image_are_asked_for(method: str, settings: dict[str, Any], expected: str) -> None:
    recording = plane()
    found = messages(lambda: st.estimators.prepare(recording, method, settings))
    assert (not found) if not expected else [text for text in found if text.startswith(expected)]


def test_disparities_of_a_near_depth_are_asked_for() -> None:
    (text,) = describe_disparities(8.0, 12.0, plane(30.0))
    assert "mean a depth below 3.8 baselines of 5 mm; is focal_length_px (30) in mm?" in text
    # The disparity per step of s is that of the baseline, here four times the distance of the positions.
    recording = plane(baseline_mm=20.0, stage_x_mm=[-5.0, 0.0, 5.0])
    assert describe_disparities(4.0, 300.0, recording) == []
    assert describe_disparities(4.0, 330.0, recording)


@pytest.mark.parametrize("height", [60, 480])
@pytest.mark.parametrize(
    ("focal_px", "width", "unit"),
    [(12.0, 64, "mm"), (50.0, 640, "mm"), (900.0, 640, ""), (200.0, 640, ""), (5_000_000.0, 640, "µm")],
)
def test_fields_of_view_of_no_lens(focal_px: float, width: int, height: int, unit: str) -> None:
    found = describe_rig(focal_px, 5.0, width, height)
    assert (not found) if not unit else f"is it in {unit}" in found[0]


def test_positions_in_another_unit_than_the_baseline() -> None:
    with pytest.warns(st.SceneWarning, match=r"stage_x_mm: is 0\.005 mm .* is stage_x_mm in m\?"):
        plane(stage_x_mm=[-0.005, 0.0, 0.005])
    assert "in µm?" in describe_positions(np.array([0.0, 5000.0]), 5.0)[0]
    assert describe_positions(np.array([-30.0, 0.0, 10.0]), 5.0) == []
    assert describe_positions(None, 5.0) == []


@pytest.mark.parametrize(
    ("distance_mm", "baseline_mm", "focal_px", "expected"),
    [
        (0.66, 5.0, 5000.0, "is it in m, or the baseline in µm"),
        (0.66, 5.0, None, "is it in m, or the baseline in µm"),
        (660.0, 60.0, 9000.0, "more than their width of 640 px"),
        (660.0, 5000.0, None, "is it in m, or the baseline in µm"),
        (660_000.0, 0.005, 50.0, "from which no depth follows"),
        (660.0, 5.0, 5000.0, ""),
        (660.0, 5.0, None, ""),
    ],
)
def test_distances_that_do_not_fit_the_rig(
    distance_mm: float, baseline_mm: float, focal_px: float | None, expected: str
) -> None:
    found = describe_distance(distance_mm, focal_px, baseline_mm, 640, 5)
    assert any(expected in text for text in found) if expected else not found
    assert describe_distance(distance_mm, focal_px, baseline_mm, 640, 1) == []


def test_nothing_is_said_without_a_depth() -> None:
    recording = plane(25.0)
    for depth in (np.nan, -1.0, 0.0, np.inf):
        assert describe_estimated_depth(depth, recording) == []


# The plaid has the camera of a sinusoid that is known in closed form, with a focal length of 10 px.
RIGS = [path for path in sorted((Path(__file__).parents[2] / "scenes").glob("*.yaml")) if path.stem != "plaid"]


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_rigs_of_the_bundled_scenes_are_plausible(path: Path) -> None:
    scene = st.load_scene(path)
    camera, stage = scene.camera, scene.stage
    assert describe_rig(camera.focal_px, stage.baseline_mm, camera.width, camera.height) == []
    for item in scene.objects:
        distance = item.pose.position_mm[2]
        assert describe_distance(distance, camera.focal_px, stage.baseline_mm, camera.width, stage.positions) == []
