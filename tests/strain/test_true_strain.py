"""Exact strain of truths against growth in closed form, and scores of strain."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.strain import StrainScore, compute_true_strain

RATE, SHARE, TILT = 0.03, 0.8, 25.0


def growing(camera: dict[str, Any] | None = None, **motion: Any) -> st.Scene:
    """Return a tilted sheet that grows by different rates along X and Y, and turns; ``camera``: further fields."""
    sheet = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [90, 70], "resolution_mm": 10},
        "texture": {"kind": "uniform"},
        "pose": {"position_mm": [0, 0, 100], "rotations": [{"axis": [0, 1, 0], "angle_deg": TILT}]},
        "deformation": [{"kind": "growth", "rate_per_hour": RATE, "along_share": SHARE}],
        "motion": [{"kind": "rotation", "axis": [1, 1, 1], "rate_deg_per_frame": 7}],
    }
    plain = {
        "camera": {"width": 48, "height": 36, "focal_length_px": 80, **(camera or {})},
        "stage": {"positions": 3, "baseline_mm": 4.0},
        "frames": {"count": 3, "frame_interval_s": 3600.0},
        "objects": [sheet | motion],
        "render": {"backend": "raycast"},
    }
    return st.Scene.from_dict(plain)


@pytest.fixture(scope="module")
def scene() -> st.Scene:
    return growing()


@pytest.fixture(scope="module")
def truth(scene: st.Scene) -> xr.Dataset:
    return st.make_truth(scene, truth_content="complete")


def test_growth_of_a_sheet_is_its_hencky_strain(scene: st.Scene, truth: xr.Dataset) -> None:
    """Lengths along X grow as exp(p r t), those along Y as exp((1 - p) r t), while the sheet turns."""
    strain = compute_true_strain(truth, scene, settings={"measure": "hencky"})
    valid = strain["valid"].values
    assert valid.mean() > 0.5
    np.testing.assert_allclose(strain["e1"].values[valid], SHARE * RATE, rtol=1e-9)
    np.testing.assert_allclose(strain["e2"].values[valid], (1 - SHARE) * RATE, rtol=1e-9)
    still = compute_true_strain(truth.sel(t=[0]), scene, settings={"measure": "hencky"}, times=[-2.5])
    np.testing.assert_allclose(still["e1"].values[still["valid"].values], -2.5 * (1 - SHARE) * RATE, rtol=1e-9)


def test_rate_of_a_truth_has_its_growth_rates(truth: xr.Dataset) -> None:
    strain = compute_true_strain(truth, settings={"measure": "rate"})
    trace = (strain["exx"] + strain["eyy"]).values
    np.testing.assert_allclose(trace, truth["growth_rate"].values, rtol=1e-9)
    at = strain.sel(t=0)
    # At t = 0 the X axis of the sheet is the projection of that of the camera.
    np.testing.assert_allclose(at["exx"].values[at["valid"].values], SHARE * RATE, rtol=1e-9)
    np.testing.assert_allclose(at["exy"].values[at["valid"].values], 0, atol=1e-12)


@pytest.mark.parametrize("measure", ["green_lagrange", "hencky", "engineering"])
def test_windows_over_displacements_of_a_truth_agree_with_its_geometry(
    scene: st.Scene, truth: xr.Dataset, measure: str
) -> None:
    windowed = st.compute_strain(truth, settings={"measure": measure, "window": 5, "step": 2})
    assert windowed.attrs["displacement_source"] == "displacement_next"
    exact = compute_true_strain(truth, scene, settings={"measure": measure})
    exact = exact.sel({dim: windowed[dim].values for dim in ("t", "y", "x")})
    valid = windowed["valid"].values
    assert valid.mean() > 0.5
    for name in ("exx", "eyy", "exy", "e1", "e2"):
        np.testing.assert_allclose(windowed[name].values[valid], exact[name].values[valid], rtol=0, atol=1e-6)


def test_distortion_of_the_lens_is_no_strain() -> None:
    """Windows over pixels of a barrel lens: the same strains, and points at the places of the geometry."""
    bent = growing(camera={"distortion": {"k1": -0.4, "p1": 0.01}})
    truth = st.make_truth(bent, truth_content="complete")
    settings = {"measure": "green_lagrange", "window": 5, "step": 2}
    found = st.compute_strain(truth, settings=settings)
    exact = compute_true_strain(truth, bent, settings=settings)
    exact = exact.sel({dim: found[dim].values for dim in ("t", "y", "x")})
    valid = found["valid"].values
    assert valid.mean() > 0.3
    for name in ("exx", "eyy", "exy"):
        np.testing.assert_allclose(found[name].values[valid], exact[name].values[valid], rtol=0, atol=1e-6)
    tracks = st.track_points(bent, truth, [0.0])[0][:, 1::2, 1::2]
    at = found.sel(t=0)
    here = np.isfinite(at["point"].values[0])
    np.testing.assert_allclose(at["point"].values[:, here], tracks[:, here], rtol=0, atol=1e-9)
    # Without the lens, turning by 7 degrees per frame would appear as strain.
    pinhole = truth.assign_attrs(scene=json.dumps({"camera": {}}))
    wrong = np.abs(st.compute_strain(pinhole, settings=settings)["exx"] - found["exx"])
    assert float(wrong.max()) > 1e-4


def test_windowed_rate_of_a_truth_agrees_with_its_growth_rates(truth: xr.Dataset) -> None:
    windowed = st.compute_strain(truth, settings={"measure": "rate", "window": 5, "step": 2})
    exact = compute_true_strain(truth, settings={"measure": "rate"})
    exact = exact.sel({dim: windowed[dim].values for dim in ("t", "y", "x")})
    valid = windowed["valid"].values
    for name in ("exx", "eyy", "exy"):
        np.testing.assert_allclose(windowed[name].values[valid], exact[name].values[valid], rtol=0, atol=1e-6)


def test_score_of_an_estimate_with_known_errors(scene: st.Scene, truth: xr.Dataset, tmp_path: Any) -> None:
    """White noise of known size: no bias, the stated standard deviations fit, and rates are in per cent per hour."""
    rng, noise = np.random.default_rng(3), 1e-3
    shape = truth["velocity"].shape
    estimate = st.make_estimate(
        recording=st.make_recording(
            np.zeros((3, *truth["depth"].shape)), 80, 4.0, principal_point_px=(23.5, 17.5), frame_interval_s=3600.0
        ),
        depth=truth["depth"].values,
        velocity=truth["velocity"].values + noise * rng.standard_normal(shape),
        velocity_std=np.where(np.isfinite(truth["velocity"].values), noise, np.nan),
    )
    gauge = {"window": 7, "step": 1, "correlation_sigma_px": 0}
    found = st.score_strain(estimate, truth, settings={"measure": "rate", **gauge}, margin_px=2, allow_mismatch=True)
    assert found.units == "%/h"
    pixels, windows = found.regions["interior"]["exx"], found.regions["interior"]["exx_windowed"]
    # A thousand points of 49-fold windows are about forty independent values: 11 % of a standard deviation.
    assert pixels["rms_z"] == pytest.approx(1, abs=0.3)
    assert windows["rmse"] == pytest.approx(pixels["rmse"], rel=1e-3)
    spacing = 100.0 / 80
    theory = 100 * noise / spacing * math.sqrt(12 / (7**2 * (7**2 - 1)))
    assert found.value("eyy_windowed").value == pytest.approx(theory, rel=0.3)
    assert "%/h" in found.summary()
    again = StrainScore.load(found.save(tmp_path / "strain.json"))
    assert again.to_dict() == json.loads(json.dumps(found.to_dict()))
    assert set(found.to_dataframe()["region"]) == {"all", "interior"}
    finite = st.score_strain(
        estimate, truth, scene, settings={"measure": "hencky", **gauge}, margin_px=2, allow_mismatch=True
    )
    assert finite.units == "1"
    assert {"exx", "exx_windowed"} <= set(finite.regions["interior"])


def test_score_since_a_frame_compares_with_the_geometry_of_both_frames(scene: st.Scene, truth: xr.Dataset) -> None:
    """The trapezoidal rule over 7° per frame is the only error of exact velocities."""
    maps = {name: truth[name] for name in ("depth", "velocity")}
    estimate = xr.Dataset(maps, attrs={name: value for name, value in truth.attrs.items() if name != "scenetruth"})
    gauge = {"measure": "hencky", "window": 3, "step": 2, "subset_px": 0}
    found = st.score_strain(estimate, truth, scene, settings=gauge, since=-1, margin_px=2)
    assert found.metadata["since"] == -1
    pixels, windows = found.regions["all"]["e1"], found.regions["all"]["e1_windowed"]
    assert windows["rmse"] == pytest.approx(0, abs=1e-14)
    # (0.12 rad)³ / 12 for every frame, and half a frame less on average.
    assert pixels["rmse"] is not None
    assert 1e-6 < pixels["rmse"] < 5e-4
    assert int(pixels["count"] or 0) > 300


def test_problems_of_truths_and_scores(scene: st.Scene, truth: xr.Dataset) -> None:
    with pytest.raises(st.ScoreError, match="scene: is missing"):
        compute_true_strain(truth)
    with pytest.raises(st.ScoreError, match="truth_content='complete'"):
        compute_true_strain(truth.drop_vars("principal_growth_rates"), settings={"measure": "rate"})
    with pytest.raises(st.ScoreError, match="one for every frame"):
        compute_true_strain(truth, scene, times=[1.0])
    with pytest.raises(st.ScoreError) as caught:
        st.score_strain(None, truth, margin_px=-1)  # type: ignore[arg-type]
    assert {problem.path for problem in caught.value.problems} == {"estimate", "margin_px"}
