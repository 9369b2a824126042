"""Budgets of a small scene: parts predicted and simulated, their sum, and what cannot be."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.benchmark.design_point import ignore_scene_warnings
from scenetruth.design.uncertainty import (
    Budget,
    BudgetTask,
    Calibration,
    SimulationRun,
    budget,
    resolve_calibration,
    restrict_sources,
    simulate_run,
)
from scenetruth.errors import ArgumentError, EstimateError, OutputExistsError, SceneError, StoreError
from tests.helpers.budget_scenes import laboratory
from tests.helpers.nightly import nightly

SOME: dict[str, Any] = {
    "stage.errors": {"yaw_urad": 100.0},
    "sensor": {"noise_std": 0.004, "bit_depth": None},
    "lighting": {"drift_per_frame": 0.002},
    "frames.count": 3,
}
MORE: dict[str, Any] = {
    **SOME,
    "stage.errors": {"yaw_urad": 100.0, "pitch_urad": 50.0, "roll_urad": 300.0, "repeatability_um": 20.0},
    "stage.time_per_position_s": 0.6,
    "sensor": {"noise_std": 0.004, "bit_depth": 6},
    "camera.distortion": {"k1": -0.05},
    "shutter.readout_time_s": 6.0,
    "optics": {"vignetting": {"coefficients": [-0.1, 0, 0]}},
    "frames.count": 5,
}


@pytest.fixture(scope="module")
def scene() -> st.Scene:
    return laboratory(SOME, everything=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("budget") / "b"


@pytest.fixture(scope="module")
def found(scene: st.Scene, folder: Path) -> Budget:
    return budget(scene, output=folder, seeds=1, simulated_share=1.0, calibration={"focal_length_percent": 0.1})


def agrees(found: Budget, cause: str, quantity: str = "depth", within: float = 0.2) -> None:
    part = found.contribution(cause, quantity)
    expected = part.predicted_for_seeds if math.isfinite(part.predicted_for_seeds) else part.predicted
    assert part.simulated == pytest.approx(expected, rel=within), (cause, quantity)


@nightly
def test_what_is_predicted_is_simulated(found: Budget) -> None:
    assert not found.failures
    # For the very errors that were drawn, to what filters and windows leave.
    for cause in ("stage_yaw", "focal_length"):
        agrees(found, cause)
    # Scatter of some twenty windows.
    agrees(found, "noise", within=0.3)
    agrees(found, "brightness", "velocity_z", within=0.3)
    # Calibrations are off by plus and minus one standard deviation.
    assert found.contribution("focal_length", "depth").predicted == pytest.approx(0.72, rel=0.02)


def test_one_frame_is_predicted_too_and_calibration_is_not_simulated() -> None:
    """A single frame tells no motion: its maps are there, and empty."""
    scene = laboratory({**SOME, "frames.count": 1, "lighting": {}}, everything=False)
    found = budget(
        scene, seeds=1, simulated_share=0.0, calibration={"focal_length_percent": 0.1, "baseline_percent": 0.05}
    )
    assert found.quantities == ["depth", "disparity"]
    # In proportion to Z, of about 720 mm; disparity is what images show, whatever the focal length is said to be.
    assert found.contribution("focal_length", "depth").predicted == pytest.approx(0.72, rel=0.02)
    assert found.contribution("focal_length", "disparity").predicted == 0
    for cause in ("stage_yaw", "noise", "focal_length", "baseline"):
        part = found.contribution(cause, "depth")
        assert part.predicted > 0
        assert math.isnan(part.simulated), cause


@nightly
def test_everything_predicted_is_simulated() -> None:
    found = budget(laboratory(MORE, everything=False), seeds=4, simulated_share=1.0)
    assert not found.failures
    for cause in ("stage_yaw", "stage_position", "stage_roll", "timing", "focal_length", "baseline", "lens_residual"):
        agrees(found, cause)
    # Shifts across the stage do nothing to the first order; what they do is less than ideal images leave.
    assert found.contribution("stage_pitch", "depth").simulated < 0.2 * found.combined("depth").ideal
    for cause in ("noise", "quantisation"):
        agrees(found, cause, within=0.3)
        agrees(found, cause, "velocity_z", within=0.3)
    agrees(found, "brightness", "velocity_z", within=0.3)
    for quantity in ("depth", "velocity_x", "velocity_y", "velocity_z"):
        total = found.combined(quantity)
        assert total.root_sum_square == pytest.approx(total.simulated, rel=0.2), quantity
        assert total.signed_sum == pytest.approx(total.simulated, rel=0.1), quantity


@nightly
def test_parts_add_up_to_the_whole(found: Budget) -> None:
    for quantity in ("velocity_z", "velocity_y"):
        total = found.combined(quantity)
        # Of a single draw, parts may be alike by chance.
        assert total.root_sum_square == pytest.approx(total.simulated, rel=0.3), quantity
        assert total.signed_sum == pytest.approx(total.simulated, rel=0.1), quantity
        parts = [one.value for one in found.contributions(quantity) if math.isfinite(one.value)]
        assert total.root_sum_square == pytest.approx(float(np.linalg.norm(parts)))
        own = [found.contribution(kind, quantity).value for kind in ("slope", "curvature", "rest")]
        assert total.ideal == pytest.approx(float(np.linalg.norm(own)))
    everywhere = found.combined("depth", "all")
    assert everywhere.ideal >= found.combined("depth").ideal


@nightly
def test_it_says_what_limits(found: Budget) -> None:
    words = found.summary().splitlines()
    # The disparity is the depth again.
    assert len(words) == len(found.quantities) - 1
    depth = next(line for line in words if line.startswith("Depth: "))
    largest = found.contributions("depth")[0]
    assert largest.title in depth.lower() or largest.title in depth
    assert "reduces it to" in depth


@nightly
def test_figures_are_kept_and_not_made_again(found: Budget, scene: st.Scene, folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} >= {"index.html", "waterfall.png", "budget.csv", "runs"}
    before = {path: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()}
    again = budget(scene, output=folder, seeds=1, simulated_share=1.0, calibration={"focal_length_percent": 0.1})
    assert {path: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()} == before
    assert [one.simulated for one in again.parts] == pytest.approx([one.simulated for one in found.parts], nan_ok=True)
    frame = found.to_dataframe()
    assert set(frame["cause"]) >= {"noise", "root_sum_square", "signed_sum", "everything", "ideal_images"}
    assert len(frame) == len(found.parts) + 4 * len(found.totals)
    with pytest.raises(OutputExistsError, match="another scene"):
        budget(scene, output=folder, calibration="perfect")


@nightly
def test_little_is_simulated_where_little_matters(scene: st.Scene) -> None:
    few = budget(scene, calibration="perfect", seeds=1, simulated_share=0.0)
    assert not [one for one in few.parts if math.isfinite(one.simulated)]
    part = few.contribution("stage_yaw", "depth")
    assert part.value == part.predicted > 0
    assert ", as predicted" in few.summary().splitlines()[0]


def test_runs_are_what_simulations_of_their_scenes_are() -> None:
    scene = laboratory({"optics.defocus": None, "shutter": {"readout_time_s": 1.0}})
    job = BudgetTask("", json.dumps(scene.to_dict()), "structure_tensor", "{}", Calibration(), (), ())
    kinds = ("noise", "quantisation", "fixed_pattern", "stage_yaw")
    recording, truth = simulate_run(job, SimulationRun(kinds, 5, 0))
    with ignore_scene_warnings():
        same, exact = st.simulate(restrict_sources(scene, kinds, 5), save_radiance=True)
    np.testing.assert_array_equal(recording["image"].values, same["image"].values)
    np.testing.assert_array_equal(recording["radiance"].values, same["radiance"].values)
    np.testing.assert_array_equal(truth["depth"].values, exact["depth"].values)
    assert recording.attrs["full_scale"] == same.attrs["full_scale"]


def test_what_cannot_be_is_told_at_once(scene: st.Scene, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError) as error:
        budget(scene, calibration={"focal_percent": 1.0}, seeds=0, simulated_share=2.0, region="object_nothing")
    for word in ("seeds", "simulated_share", "focal_percent", "focal_length_percent", "object_nothing"):
        assert word in str(error.value)
    with pytest.raises(ArgumentError, match="typical"):
        resolve_calibration("exact")
    with pytest.raises(SceneError, match=r"stage\.rows"):
        budget(laboratory({"stage.rows": 2, "stage.row_spacing_mm": 5.0}, everything=False))
    with pytest.raises(SceneError, match=r"stage\.axis_tilt_urad: must be null"):
        budget(laboratory({"stage.axis_tilt_urad": [100, 0]}, everything=False))
    with pytest.raises(EstimateError, match="no_such"):
        budget(scene, method="no_such")
    # The edge of the sheet is nowhere 40 px away; without its edges in the image, the margin does not matter.
    far = {"score.interior_margin_px": 40.0, "objects.0.mesh.size_mm": [20.0, 20.0]}
    with pytest.raises(SceneError, match=r"(?s)score\.interior_margin_px: no pixel .* the region all"):
        budget(laboratory(far, everything=False), region="interior")
    # One object is no region of its own, nor is one that the camera does not see.
    with pytest.raises(ArgumentError, match=r"region: has no pixel .* must be one of all, interior "):
        budget(scene, region=f"object_{scene.objects[0].name}")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("mine")
    with pytest.raises(OutputExistsError, match="not a directory of a budget"):
        budget(scene, output=tmp_path / "mine")
    with pytest.raises(StoreError, match=r"because .*notes is not a directory"):
        budget(scene, output=tmp_path / "mine" / "notes" / "budget")


def test_calibrations_are_typical_unless_given() -> None:
    assert resolve_calibration("typical") == Calibration()
    assert resolve_calibration({"principal_point_px": 2}) == Calibration(
        focal_length_percent=0, principal_point_px=2, baseline_percent=0
    )
    assert not any(resolve_calibration("perfect").model_dump().values())


@nightly
def test_gloss_is_the_difference_from_a_matt_surface_under_the_same_lamps() -> None:
    lamp = {"kind": "point", "position_mm": [0, 0, 620], "irradiance": 0.6, "reference_distance_mm": 100}
    changes = {
        "camera": {"width": 56, "height": 48, "focal_length_px": 720},
        "frames.count": 1,
        "stage.positions": 3,
        "objects.0.pose": {"position_mm": [0, 0, 720]},
        "lighting": {"lights": [lamp]},
        "score.interior_margin_px": 0,
    }
    glossy = {"objects.0.material": {"refractive_index": 1.5, "roughness": 0.1}}
    scene = laboratory(changes | glossy, everything=False)
    found = budget(scene, method="structure_tensor", calibration="perfect", seeds=1, simulated_share=0.0)
    part = found.contribution("specular", "disparity")
    assert part.size == "roughness 0.1"
    shown = [
        st.estimate(st.simulate(each)[0], "structure_tensor")["disparity"].sel(t=0).values
        for each in (scene, laboratory(changes, everything=False))
    ]
    change = shown[0] - shown[1]
    assert part.simulated == pytest.approx(np.sqrt(np.nanmean(change**2)), rel=1e-3)
    assert part.simulated > 10 * found.contribution("shading", "disparity").simulated
