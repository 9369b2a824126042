"""What theory says of methods: against closed formulas, and against the scatter of estimates."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import scenetruth as st
from scenetruth.benchmark.design_point import add_noise
from scenetruth.bound import closed_form_bound, texture_gradient
from scenetruth.design import Prediction, predict
from scenetruth.design.prediction import all_method_models
from tests.helpers.nightly import nightly
from tests.helpers.prediction_scenes import wall

NOISES = 20


def test_the_envelope_is_that_of_the_closed_formulas() -> None:
    """A wall at rest, seen from in front by all images: pixels and splines take 2 % of the gradient of waves of 12 px.

    The image is large enough for the windows in its middle, and the disparity larger than them.
    """
    plain = wall(
        texture={"kind": "noise", "wavelength_mm": [6.0, 18.0], "mean": 0.5, "rms_contrast": 0.2},
        motion=[],
        mesh={"kind": "plane", "size_mm": [400, 400]},
        camera={"width": 20, "height": 16, "focal_length_px": 1200, "principal_point_px": [9.5, 7.5]},
        stage={"positions": 5, "baseline_mm": 0.2},
        score={"interior_margin_px": 0},
    )
    # The principal point alone is asked for, and no image ends near it.
    wide = plain | {"camera": {"width": 400, "height": 300, "focal_length_px": 1200}}
    found = predict(wide, window_sigma_px=4.0, motion="rigid")
    gradient = texture_gradient(0.1, (12.0, 36.0))
    told = closed_form_bound(
        focal_length_px=1200,
        baseline_mm=0.2,
        positions=5,
        frames=5,
        depth_mm=600,
        gradient=gradient,
        noise_std=0.01,
        window_sigma_px=4.0,
    )
    assert found.causes.gradient_x == pytest.approx(gradient, rel=0.02)
    assert found.precision("depth", "all").std == pytest.approx(told.depth_mm, rel=0.03)
    assert found.precision("slope_x", "all").std == pytest.approx(told.slope, rel=0.03)
    assert found.precision("flow_y", "all").std == pytest.approx(told.flow_px, rel=0.03)


def test_noise_that_stays_does_not_average_over_frames() -> None:
    """At rest, with cameras farther apart than windows: depth has the variance of (1 + T p²/σ²), motion that of noise.

    64 waves stand for the texture; what they leave of what cameras share is a few per cent.
    """
    still = {"motion": [], "stage": {"positions": 3, "baseline_mm": 20.0}}
    still |= {"camera": {"width": 300, "height": 72, "focal_length_px": 1200}}
    still |= {"mesh": {"kind": "plane", "size_mm": [300, 140]}}
    sensor = {"kind": "emva1288", "preset": "scientific_cmos", "dsnu_e": 0.0}
    with_pattern = predict(wall(sensor=sensor | {"prnu": 0.01}, **still))
    without = predict(wall(sensor=sensor | {"prnu": 0.0}, **still))
    causes = with_pattern.causes
    expected = np.sqrt(1 + 5 * (causes.pattern_std / causes.noise_std) ** 2)
    assert expected > 2
    ratio = {
        name: with_pattern.precision(name, "all").std / without.precision(name, "all").std
        for name in ("depth", "flow_x")
    }
    assert ratio["depth"] == pytest.approx(expected, rel=0.05)
    assert ratio["flow_x"] == pytest.approx(1.0, abs=0.01)


@cache
def scatter() -> tuple[dict[str, float], dict[str, Prediction]]:
    """Scatter of the structure tensor's estimates, and what is predicted."""
    plain = wall(frames={"count": 9})
    ideal, _ = st.simulate(st.Scene.from_dict(plain | {"sensor": "ideal"}))
    settings: dict[str, Any] = {"window_sigma_px": 4.0, "window_taps_px": 17}
    found = [st.estimate(add_noise(ideal, 0.01, "x", k), "structure_tensor", settings).sel(t=0) for k in range(NOISES)]
    told = {
        model: predict(plain, model=model, method="structure_tensor", window_sigma_px=4.0)
        for model in ("analytic", "maps")
    }
    half = chi2.median(NOISES - 1) / (NOISES - 1)

    def std(values: list[np.ndarray]) -> float:
        variance = np.var(np.array(values), axis=0, ddof=1)
        return float(np.sqrt(np.nanmedian(variance) / half))

    measured = {name: std([one[name].values for one in found]) for name in ("depth", "disparity")}
    measured |= {f"flow_{axis}": std([one["flow"].values[k] for one in found]) for k, axis in enumerate("xy")}
    measured["velocity_z"] = std([one["velocity"].values[2] for one in found])
    return measured, told


@pytest.mark.parametrize("model", ["analytic", "maps"])
@pytest.mark.parametrize("quantity", ["depth", "disparity", "flow_x", "flow_y", "velocity_z"])
def test_the_structure_tensor_scatters_as_predicted(model: str, quantity: str) -> None:
    """20 noises and about 40 independent windows: 3 %. The formulas leave out what noise does to its own gradients."""
    measured, told = scatter()
    assert told[model].precision(quantity, "all").std == pytest.approx(measured[quantity], rel=0.15)


def test_the_bound_is_that_of_simulated_images() -> None:
    """`cramer_rao_bound` of the recording in full."""
    from scenetruth.bound import cramer_rao_bound

    plain = wall(score={"interior_margin_px": 0})
    recording, truth = st.simulate(st.Scene.from_dict(plain), save_radiance=True)
    # Grey values are noisy in it: those without noise are found again to what noise leaves of their slope, 1e-3.
    bound = cramer_rao_bound(truth, recording, window_sigma_px=4.0, motion="growing")
    maps = predict(plain, model="maps", window_sigma_px=4.0).maps
    assert maps is not None
    for name in ("depth_std", "flow_std", "velocity_std", "slope_std", "growth_rate_std"):
        np.testing.assert_allclose(maps[name].values, bound[name].sel(t=0).values, rtol=2e-3)


def test_both_methods_are_known() -> None:
    assert sorted(all_method_models()) == ["refined", "structure_tensor"]


def growing(share: float | None, rate_per_hour: float) -> Any:
    """A wall at a slant whose area grows."""
    growth: dict[str, Any] = {"kind": "growth", "rate_per_hour": rate_per_hour}
    growth |= {} if share is None else {"along_share": share}
    slant = {"position_mm": [0, 0, 600], "rotations": [{"axis": [0, 1, 0], "angle_deg": 15}]}
    return wall(motion=[], pose=slant, deformation=[growth], frames={"count": 5, "frame_interval_s": 60})


@pytest.mark.parametrize("model", ["analytic", pytest.param("maps", marks=nightly)])
def test_growth_is_predicted_for_the_model_that_is_chosen(model: Any) -> None:
    """Isotropic growth where it is; the affine model where its noise is below the anisotropy; between them, that."""

    def std(share: float | None, rate_per_hour: float, **settings: Any) -> float:
        told = predict(growing(share, rate_per_hour), model=model, method="refined", **settings)
        return told.precision("growth_rate", "all").std

    plain, affine = (std(None, 0.1, motion=motion) for motion in ("growing", "affine"))
    assert affine > 3 * plain
    assert std(None, 0.1) == pytest.approx(plain, rel=1e-3)
    assert std(1.0, 60.0 * 1.5 * affine) == pytest.approx(affine, rel=0.1)
    weak = 0.5 * affine
    assert std(1.0, 60.0 * weak) == pytest.approx(np.hypot(plain, weak), rel=0.05)
    # The tested settings are those of the method: a motion model that is given stays.
    assert std(1.0, 60.0 * 1.5 * affine, motion="auto") == std(1.0, 60.0 * 1.5 * affine)
    assert std(1.0, 60.0 * 1.5 * affine, motion="growing") == pytest.approx(plain, rel=0.1)


def test_a_given_selection_of_the_motion_model_replaces_that_of_the_settings() -> None:
    plain = growing(1.0, 60.0) | {"estimate": {"method": "refined", "motion": "growing"}}
    told = {motion: predict(plain, motion=motion).precision("growth_rate", "all").std for motion in ("auto", "affine")}
    assert told["auto"] == pytest.approx(told["affine"], rel=0.1)
    assert predict(plain).precision("growth_rate", "all").std < 0.5 * told["affine"]
    with pytest.raises(st.SceneError, match="auto"):
        predict(plain, motion="any")  # type: ignore[arg-type]


def test_the_bias_of_isotropic_growth_has_its_share_of_the_variance() -> None:
    """The optimiser attributes it to the motion model, not to noise."""

    def told(rate_per_hour: float, motion: Any = "auto") -> Prediction:
        return predict(growing(1.0, rate_per_hour), method="refined", motion=motion)

    # An eighth of the noise of the affine model, which is not selected; in % per hour.
    rate = 0.125 * told(0.1, "affine").precision("growth_rate", "all").value / 100
    weak = told(rate)
    plain, whole = (one.precision("growth_rate", "all").value for one in (told(rate, "growing"), weak))
    assert weak.growth_bias_share["all"] == pytest.approx(1 - (plain / whole) ** 2, rel=0.1)
    assert 0.3 < weak.growth_bias_share["all"] < 0.99
    # The affine model, but at the border of the image, where its noise is larger.
    assert told(40 * rate).growth_bias_share["all"] < 0.5 * weak.growth_bias_share["all"]
    assert told(rate, "affine").growth_bias_share == {}
