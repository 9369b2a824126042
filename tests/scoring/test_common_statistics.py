"""Statistics of errors in common: draws of a focal length and of noise, whose effects are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

import scenetruth as st
from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration, add_calibration_errors, region_mean
from scenetruth.schema import Intrinsics, label
from scenetruth.scoring import COMMON_STATISTICS
from tests.helpers.nightly import by_night

SHAPE = (90, 120)
FOCAL_PX, STD_PX = 1000.0, 2.0
SIGMA_PX = 2.0
NOISE_MM = 0.3
CAMERA = Intrinsics(focal_length_px=FOCAL_PX, principal_point_px=(59.5, 44.5), baseline_mm=5.0)
DEPTH = 500.0 + 0.5 * np.arange(SHAPE[1]) * np.ones(SHAPE)
VELOCITY = np.stack([np.full(SHAPE, 1.0), np.zeros(SHAPE), np.full(SHAPE, -2.0)])


def truth() -> xr.Dataset:
    maps = {
        "depth": DEPTH[None], "disparity": 5000 / DEPTH[None], "velocity": VELOCITY[:, None],
        "flow": np.zeros((2, 1, *SHAPE)), "mixed": np.zeros((1, *SHAPE), dtype=bool),
    }  # fmt: skip
    return label("truth", maps, CAMERA, t=[0])


def estimate(relative: float, noise: float, seed: int = 0, *, modes: bool = True) -> xr.Dataset:
    """Return an estimate with a wrong focal length, to which depth and U_Z are in proportion."""
    generator = np.random.default_rng(seed)
    recording = st.make_recording(np.zeros((3, 1, *SHAPE)), FOCAL_PX, 5.0, principal_point_px=(59.5, 44.5))
    white = generator.standard_normal((2, *SHAPE))
    rough = gaussian_filter(white, (0, SIGMA_PX, SIGMA_PX), mode="wrap") * 2 * np.sqrt(np.pi) * SIGMA_PX
    velocity = VELOCITY * np.array([1.0, 1.0, 1 + relative])[:, None, None]
    velocity[2] += 0.01 * noise * rough[1]
    found = st.make_estimate(
        depth=DEPTH * (1 + relative) + NOISE_MM * noise * rough[0], velocity=velocity,
        depth_std=np.full(SHAPE, NOISE_MM), velocity_std=np.full((3, *SHAPE), 0.01), recording=recording,
    )  # fmt: skip
    found = found.assign_attrs(settings=json.dumps({"window_sigma_px": SIGMA_PX}))
    rig = RigCalibration.from_camera(
        Camera(width=SHAPE[1], height=SHAPE[0], focal_length_px=FOCAL_PX, principal_point_px=(59.5, 44.5)),
        [-5, 0, 5],
        std={"f": STD_PX},
    )
    done = add_calibration_errors(found, rig)
    # Without modes, the common part is that of a correction of poses, for example.
    return done if modes else done.drop_vars("calibration_modes")


def statistics(found: xr.Dataset, quantity: str, region: str = "all") -> dict[str, float]:
    values = st.score(found, truth()).regions[region][quantity]
    return {name: float(values[name] or 0.0) for name in COMMON_STATISTICS}


@pytest.mark.parametrize("modes", [True, False])
@pytest.mark.parametrize("quantity", ["depth", "velocity_z"])
def test_an_error_of_the_focal_length_is_all_in_common(quantity: str, modes: bool) -> None:
    drawn = 1.5
    found = statistics(estimate(drawn * STD_PX / FOCAL_PX, noise=0.0, modes=modes), quantity)
    size, pixel = (DEPTH.mean(), NOISE_MM) if quantity == "depth" else (2.0, 0.01)
    common = STD_PX / FOCAL_PX * size
    of_windows = pixel * np.sqrt(4 * np.pi * SIGMA_PX**2 / DEPTH.size)
    sign = 1 if quantity == "depth" else -1
    # The common part is that at the estimated depth, which is 0.3 % too large; the lattice adds 0.05 %.
    assert found["bias_z"] == pytest.approx(sign * drawn * common / np.hypot(common, of_windows), rel=4e-3)
    assert found["rms_z_pixel"] < 0.05


def test_the_deviation_of_the_mean_is_that_of_the_region() -> None:
    """`region_mean` sums the correlations of all pairs of pixels; windows at the border are not cut off here."""
    done = estimate(0.001, noise=1.0)
    mean = region_mean(done, "depth", np.ones(SHAPE, dtype=bool))
    found = statistics(done, "depth")
    bias = mean.value - DEPTH.mean()
    assert found["bias_z"] == pytest.approx(bias / mean.std, rel=0.01)


@pytest.mark.parametrize("draws", by_night(100))
def test_both_statistics_are_one_over_draws(draws: int) -> None:
    generator = np.random.default_rng(3)
    found = [
        statistics(estimate(STD_PX / FOCAL_PX * generator.standard_normal(), 1.0, seed), "depth")
        for seed in range(draws)
    ]
    means, rests = (np.array([each[name] for each in found]) for name in COMMON_STATISTICS)
    # Five standard errors; the rest has 215 independent windows.
    assert np.mean(means**2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / draws))
    assert np.sqrt(np.mean(rests**2)) == pytest.approx(
        1.0, abs=5 / np.sqrt(2 * draws * DEPTH.size / (4 * np.pi * SIGMA_PX**2))
    )


def test_the_rest_shows_noise_that_is_stated_too_small() -> None:
    # 215 independent windows: 5 % for the ratio.
    for noise in (1.0, 2.0):
        found = statistics(estimate(0.003, noise, 1), "depth")
        assert found["rms_z_pixel"] == pytest.approx(noise, rel=0.2)


def test_frames_in_blocks_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    done = estimate(0.002, 1.0)
    both = xr.concat([done, done.assign_coords(t=[1])], dim="t", data_vars="minimal", coords="minimal")
    true = xr.concat([truth(), truth().assign_coords(t=[1])], dim="t", data_vars="minimal", coords="minimal")
    at_once = st.score(both, true).regions["interior"]["depth"]
    monkeypatch.setattr("scenetruth.scoring.alignment._PIXELS", 1)
    in_blocks = st.score(both, true).regions["interior"]["depth"]
    for name in COMMON_STATISTICS:
        assert in_blocks[name] == pytest.approx(at_once[name], rel=1e-9)
    # A second frame with the same errors adds nothing.
    alone = st.score(done, truth()).regions["interior"]["depth"]
    assert alone["bias_z"] == pytest.approx(at_once["bias_z"], rel=1e-9)
    assert alone["rms_z_pixel"] == pytest.approx(at_once["rms_z_pixel"], rel=1e-9)


def test_estimates_without_a_common_part_have_none() -> None:
    plain = estimate(0.0, 1.0).drop_vars(["depth_std_common", "velocity_std_common", "calibration_modes"])
    score = st.score(plain, truth())
    assert not set(COMMON_STATISTICS) & set(score.regions["all"]["depth"])
    assert not set(COMMON_STATISTICS) & set(score.to_dataframe().columns)
    with_it = st.score(estimate(0.0, 1.0), truth())
    assert set(COMMON_STATISTICS) <= set(with_it.to_dataframe().columns)
    assert st.Score.from_json(with_it.to_json()).regions == with_it.regions
    assert with_it.value("depth", "bias_z").unit == "1"
