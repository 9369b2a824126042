"""Principal growth as it is predicted, against the truth, the other level, and the errors of estimates."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.benchmark.design_point import add_noise
from scenetruth.design import predict
from scenetruth.design.prediction.surface_samples import sample_surface
from scenetruth.resources import Limits, limited_objects
from tests.design.predict.scenes import wall
from tests.nightly import by_day, nightly

STRAIN, NOISE, WINDOW = 0.003, 0.0005, 4.0
PER_HOUR = 100 * 60.0


def rubber(strain: float = STRAIN, noise: float = NOISE) -> dict[str, Any]:
    """A wall of rubber that is pulled along X by a strain per frame of a minute, and narrows by half of it."""
    growth = {"kind": "growth", "rate_per_hour": 0.5 * strain * 60, "along_share": 2.0}
    return wall(
        camera={"width": 176, "height": 72, "focal_length_px": 5000},
        stage={"positions": 3, "baseline_mm": 6.0},
        frames={"count": 5, "frame_interval_s": 60.0},
        mesh={"kind": "plane", "size_mm": [80, 50]},
        pose={"position_mm": [0, 0, 660]},
        texture={"kind": "noise", "wavelength_mm": [0.8, 2.4]},
        deformation=[growth],
        motion=[],
        sensor={"noise_std": noise, "bit_depth": None},
    )


def test_points_have_the_truth_s_growth_of_length() -> None:
    scene = st.Scene.from_dict(rubber())
    look = sample_surface(scene, limited_objects(scene, Limits()))
    # Differences over a frame of exp(0.003 t) are off by 0.003² / 24 of themselves.
    np.testing.assert_allclose(look.principal_growth_rates[0], STRAIN, rtol=1e-5)
    np.testing.assert_allclose(look.principal_growth_rates[1], -STRAIN / 2, rtol=1e-5)


def test_growth_of_length_is_told_where_any_gradient_may_be() -> None:
    told = predict(rubber(), window_sigma_px=WINDOW, motion="affine")
    largest, least = (told.precision(f"growth_{name}", "all") for name in ("principal_1", "principal_2"))
    assert (largest.unit, largest.value_unit) == ("1/frame", "%/h")
    assert largest.signal_value == pytest.approx(PER_HOUR * STRAIN, rel=1e-3)
    assert least.signal_value == pytest.approx(PER_HOUR * STRAIN / 2, rel=1e-3)
    assert "growth_principal_1" not in predict(rubber(), window_sigma_px=WINDOW, motion="growing").quantities


def test_what_noise_pushes_apart_is_told() -> None:
    def notes(strain: float) -> str:
        return " ".join(predict(rubber(strain), window_sigma_px=WINDOW, motion="affine").notes)

    assert "biases them" not in notes(STRAIN)
    assert "biases them" in notes(STRAIN / 1000)


@cache
def normalised(noises: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors of estimates over their prediction, in the middle, which all cameras see; and that prediction."""
    plain = rubber()
    maps = predict(plain, model="maps", window_sigma_px=WINDOW, motion="affine").maps
    assert maps is not None
    ideal, _ = st.simulate(st.Scene.from_dict(plain | {"sensor": "ideal"}))
    settings: dict[str, Any] = {"motion": "affine", "surface": "plane", "window_sigma_px": WINDOW, "window_frames": 5}
    settings |= {"acceleration": False, "photometric_model": "none"}
    middle = (..., slice(10, -10), slice(56, -56))
    std = maps["principal_growth_rates_std"].values[middle]
    truth = np.array([STRAIN, -STRAIN / 2])[:, None, None]
    found = [st.estimate(add_noise(ideal, NOISE, "x", k), "refined", settings).sel(t=0) for k in range(noises)]
    return np.array([(one["principal_growth_rates"].values[middle] - truth) / std for one in found]), std


def check(noises: int, tolerance: float) -> None:
    errors, _ = normalised(noises)
    for k in range(2):
        known = errors[:, k][np.isfinite(errors[:, k])]
        assert known.size > 0.9 * errors[:, k].size
        assert 1.4826 * np.median(np.abs(known)) == pytest.approx(1.0, rel=tolerance)


@by_day
def test_estimates_err_as_predicted() -> None:
    """About 17 independent windows and one noise: 17 % of an rms, hence 50 % for three times as much."""
    check(1, 0.5)


@nightly
def test_many_estimates_err_as_predicted() -> None:
    """12 noises of 17 windows: 5 %; what errors of inclination and turn do together is not normal: 15 % more."""
    check(12, 0.2)


def test_both_levels_agree() -> None:
    """Windows hold two waves, and the images end near them: a factor of two is what medians promise here."""
    told = predict(rubber(), window_sigma_px=WINDOW, motion="affine")
    _, std = normalised(1)
    for k, name in enumerate(("principal_1", "principal_2")):
        assert told.precision(f"growth_{name}", "all").std == pytest.approx(float(np.median(std[k])), rel=1.0)
