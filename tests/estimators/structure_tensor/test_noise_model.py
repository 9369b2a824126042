"""Error bars against the scatter of estimates from many noisy recordings, and the threshold from noise."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor import (
    PAPER,
    STRIDE,
    choose_acquisition_axes,
    gaussian_window,
    propagate_noise,
    texture_transfer,
    transfer,
)
from scenetruth.schema import STATUS_VALID
from tests.helpers.analytic_plane import Plane
from tests.helpers.nightly import by_night, nightly
from tests.helpers.noise_calibration import NOISE, Array, calibration, with_noise
from tests.helpers.scenes import cube, plaid

# From this many recordings and some 16 windows that do not overlap, scatter over prediction is known to 3 %, the share
# within 2 std to 0.01.
SEEDS = 40


@pytest.mark.parametrize(("wavelength", "u_x"), [(8, 4.0), *by_night((4, 1.0), (16, 1.0))])
def test_error_bars_on_a_plaid(wavelength: int, u_x: float) -> None:
    recording, _ = st.simulate(plaid(wavelength, (u_x, 0.0, 0.5), baseline_mm=u_x))
    inner = {"y": slice(16, -16, 3), "x": slice(16, -16, 3)}
    truth = {"depth": 100.0, "velocity": np.array([u_x, 0.0, 0.5])}
    found = calibration(recording, truth, SEEDS, inner, working_point_px=0, flow_working_point_px=(0, 0))
    for name, (ratio, within) in found.items():
        assert 0.8 <= ratio <= 1.25, name
        assert 0.91 <= within <= 0.98, name
    assert 0.93 <= np.mean([within for _, within in found.values()]) <= 0.97


@pytest.mark.parametrize(
    ("cameras", "frames", "settings"),
    [
        (5, 9, {}),
        (2, 9, {}),
        *by_night((5, 9, {"divergence": "paper"}), (5, 2, {}), (5, 9, {"noise_std": NOISE}), (7, 9, {}), (5, 5, {})),
    ],
    ids=str,
)
def test_error_bars_on_a_plane(cameras: int, frames: int, settings: dict[str, Any]) -> None:
    plane = Plane(velocity=(0.1, -0.05, 0.3), size=(64, 84))
    recording = plane.recording(np.arange(cameras) - (cameras - 1) // 2, frames)
    inner = {"y": slice(16, -16, 3), "x": slice(24, -24, 3)}
    truth = {"depth": 500.0, "velocity": np.array(plane.velocity)}
    found = calibration(recording, truth, SEEDS, inner, working_point_px=2, flow_working_point_px=(0, 0), **settings)
    for name, (ratio, within) in found.items():
        assert 0.85 <= ratio <= 1.15, name
        assert 0.91 <= within <= 0.98, name
    assert 0.93 <= np.mean([within for _, within in found.values()]) <= 0.97


@nightly
def test_error_bars_on_a_cube() -> None:
    """Slanted faces and a choice of working points: the scatter is still what is predicted."""
    recording, truth = st.simulate(cube(sensor="ideal"))
    exact = truth.sel(t=0)
    inner = {"y": slice(30, -30, 3), "x": slice(50, -50, 3)}
    values = exact.isel(inner)
    found = calibration(
        recording,
        {"depth": values["depth"].values, "velocity": values["velocity"].values},
        SEEDS,
        inner,
        noise_std=NOISE,
    )
    for name, (ratio, _) in found.items():
        assert 0.8 <= ratio <= 1.25, name


@pytest.fixture(scope="module")
def ideal_cube() -> tuple[xr.Dataset, xr.Dataset]:
    """The estimate of slanted faces without noise, and their truth."""
    recording, truth = st.simulate(cube(sensor="ideal"))
    return st.estimate(recording), truth


def test_residuals_tell_of_errors_that_are_not_noise(ideal_cube: tuple[xr.Dataset, xr.Dataset]) -> None:
    """What the model leaves unexplained predicts the size of the error."""
    estimate, truth = ideal_cube
    score = st.score(estimate, truth).regions["interior"]["depth"]
    full = estimate["status"].values == STATUS_VALID
    assert score["rmse"] is not None
    assert 0.3 <= score["rmse"] / np.sqrt(np.nanmean(estimate["depth_std"].values[full] ** 2)) <= 3


@pytest.mark.parametrize("sigma", [0.005, 0.05])
def test_noise_is_estimated_from_the_residual(sigma: float) -> None:
    recording = with_noise(Plane(size=(64, 84)).recording(np.arange(5) - 2, 9), 3, sigma)
    estimate = st.estimate(recording, working_point_px=2, tau="auto")
    # A median over some tens of windows, each with about 50 independent values.
    assert estimate.attrs["noise_std"] == pytest.approx(sigma, rel=0.15)


def test_error_bars_scale_with_the_noise() -> None:
    recording = Plane(size=(44, 60)).recording(np.arange(5) - 2, 9)
    one, two = (st.estimate(recording, working_point_px=2, noise_std=sigma) for sigma in (0.01, 0.02))
    for name in ("depth_std", "velocity_std", "disparity_std"):
        np.testing.assert_allclose(two[name], 2 * one[name], rtol=1e-5)


def test_error_bars_are_independent_of_full_scale() -> None:
    noisy = Plane(size=(44, 60)).recording(np.arange(5) - 2, 9, noise=NOISE)
    images = np.rint(noisy["image"].values * 4000)
    one = st.estimate(st.make_recording(images / 4000, 1000.0, 1.0), working_point_px=2)
    two = st.estimate(st.make_recording(images.astype(np.uint16), 1000.0, 1.0, full_scale=4000.0), working_point_px=2)
    np.testing.assert_allclose(two["depth_std"], one["depth_std"], rtol=1e-3)


@pytest.mark.parametrize(("k_x", "k_y"), [(0.3, 0.4), (1.2, 0.2), (0.05, 0.9), (np.pi / 4, np.pi / 2)])
def test_spectrum_of_a_plane_wave(k_x: float, k_y: float) -> None:
    y, x = np.mgrid[:80, :96]
    image = np.cos(k_x * x + k_y * y + 0.3).astype(np.float32)
    inner = slice(8, -8)
    of_x, of_all, wide_x, wide_y, tilted, _ = texture_transfer(image[None], StructureTensorSettings()).cropped(
        inner, inner
    )
    (d_x, s_x), (d_y, s_y) = transfer(k_x), transfer(k_y)
    # Energies of one wave ripple by exp(-(2 k sigma)^2 / 2) of themselves; 2 k sigma > 3 only for the larger k.
    ripple = 2 * np.exp(-2 * min(abs(k_x) + abs(k_y), 1.0) ** 2 * 36) + 5e-3
    # Noise passes Ŝ² around k in the band of the window; a window cut off at two sigma has side lobes.
    kappa = np.linspace(-np.pi, np.pi, 2001)
    offsets = np.arange(25) - 12
    window = gaussian_window(6.0, 25)

    def in_band(k: float, weights: Array) -> float:
        band = np.abs(np.exp(1j * np.outer(kappa, offsets)) @ weights) ** 2
        return float(np.average(transfer(k + kappa)[1] ** 2, weights=band))

    # The texture's wave number is read from its derivatives, from which blocks let some ripple through.
    expected = in_band(k_x, window) * in_band(k_y, window)
    np.testing.assert_allclose(of_x, expected, rtol=ripple + 0.02)
    np.testing.assert_allclose(of_all, expected, rtol=ripple + 0.02)
    more = [in_band(k, window * offsets) / in_band(k, window) for k in (k_x, k_y)]
    np.testing.assert_allclose(tilted, np.mean(more), rtol=0.03)
    # Derivatives are in quadrature: what blocks of 4 px let through of waves of half the length does not cancel.
    np.testing.assert_allclose(wide_x, (d_x / s_x) ** 2, rtol=ripple + 0.12)
    np.testing.assert_allclose(wide_y, (d_y / s_y) ** 2, rtol=ripple + 0.12)


def test_any_stride_of_a_texture_is_seen() -> None:
    """A wave that repeats after as many pixels as the spectrum's points are apart must not hide between them."""
    y, x = np.mgrid[:80, :96]
    for phase in (0.0, 0.8, 1.6):
        image = np.cos(2 * np.pi / (2 * STRIDE) * (x + y) + phase).astype(np.float32)
        wide = texture_transfer(image[None], StructureTensorSettings()).wave_number_x2[8:-8, 8:-8]
        np.testing.assert_allclose(wide, (np.pi / STRIDE) ** 2, rtol=1e-2)


def test_noise_of_the_constraint_against_filtering_noise() -> None:
    """Residuals and gradient of pure noise have the powers that the model states."""
    rig = choose_acquisition_axes(np.arange(5.0) - 2, 9, StructureTensorSettings())
    model = propagate_noise(rig, rig.over_s, rig.over_t, 1, StructureTensorSettings())
    generator = np.random.default_rng(0)
    noise = generator.standard_normal((5, 5, 400, 400))

    def filtered(*kernels: Array) -> Array:
        image = noise
        for kernel in kernels[:2]:
            image = np.tensordot(kernel, image, (0, 0))
        rows = sum(weight * image[k : k + 396] for k, weight in enumerate(kernels[2]))
        return np.asarray(sum(weight * rows[:, k : k + 396] for k, weight in enumerate(kernels[3])))

    s, d = PAPER.smoothing, PAPER.derivative
    g_x, g_s, g_t = filtered(s, s, s, d), filtered(d, s, s, s), filtered(s, d, s, s)
    assert np.mean(g_x**2) == pytest.approx(model.gradient, rel=0.02)
    assert np.mean((0.7 * g_x + g_s) ** 2) == pytest.approx(model.residual_s[0] + 0.49 * model.residual_s[1], rel=0.02)
    assert np.mean((0.7 * g_x + g_t) ** 2) == pytest.approx(model.residual_t[0] + 0.49 * model.residual_t[1], rel=0.02)
    window = gaussian_window(6.0, 25)
    assert model.window == pytest.approx(np.sum(np.outer(window, window) ** 2), rel=1e-12)
    # An infinitely long Gaussian's square is narrower by exactly 2, one cut off at two sigma less.
    assert 0.5 < model.moment_ratio < 0.65
    long = propagate_noise(rig, rig.over_s, rig.over_t, 1, StructureTensorSettings(window_taps_px=101))
    assert long.moment_ratio == pytest.approx(0.5, abs=1e-6)


def test_error_bars_stand_where_the_estimate_is_full(ideal_cube: tuple[xr.Dataset, xr.Dataset]) -> None:
    estimate, _ = ideal_cube
    full = estimate["status"].values == STATUS_VALID
    assert full.any()
    assert (estimate["depth_std"].values[full] >= 0).all()
    assert (estimate["velocity_std"].values[:, full] >= 0).all()
    assert np.isnan(estimate["velocity_std"].values[:, ~full]).all()


EVEN, UNEVEN, PAIR = [-2, -1, 0, 1, 2], [-2.1, -1.05, 0, 0.9, 2.02], [0, 1]


@pytest.mark.parametrize(
    ("stage", "settings"),
    [
        *((EVEN, {}), (UNEVEN, {"working_point_px": 2}), (PAIR, {"working_point_px": "auto"})),
        *by_night((UNEVEN, {}), (PAIR, {}), (EVEN, {"working_point_px": "auto"}), (EVEN, {"working_point_px": 2})),
        *by_night((UNEVEN, {"working_point_px": "auto"}), (PAIR, {"working_point_px": 2})),
    ],
    ids=str,
)
def test_noise_does_not_depend_on_how_images_are_registered(stage: list[float], settings: dict[str, Any]) -> None:
    """Several working points, and shifts by parts of a pixel, leave the same residual as the right one alone."""
    plane = Plane(velocity=(0.1, -0.05, 0.3), slope=0.2, size=(72, 96))
    recording = with_noise(plane.recording(stage, 9), 5, 0.02)
    estimate = st.estimate(recording, tau="auto", flow_working_point_px=(0, 0), **settings)
    assert estimate.attrs["noise_std"] == pytest.approx(0.02, rel=0.15)


LITTLE_NOISE = 0.002


def patterned(contrast: float, share: float = 1.0) -> xr.Dataset:
    """Return a moving texture on the left ``share`` of the image, and a blank; with the noise of a camera."""
    s, t, y, x = np.meshgrid(np.arange(5) - 2, np.arange(9) - 4, np.arange(80), np.arange(120), indexing="ij")
    moved_x, moved_y = x + 0.3 * s - 0.2 * t, y + 0.15 * t
    texture = np.cos(0.7 * moved_x + 0.2 * moved_y) * np.cos(0.6 * moved_y - 0.3 * moved_x)
    noise = np.random.default_rng(3).normal(0, LITTLE_NOISE, texture.shape)
    return st.make_recording(0.5 + contrast * texture * (x < 120 * share) + noise, 100.0, 1.0)


def full(estimate: xr.Dataset) -> float:
    inner = estimate.isel(t=0, y=slice(14, -14), x=slice(14, -14))
    return float((inner["status"] == STATUS_VALID).mean())


def test_dim_images_are_said_to_need_a_lower_threshold() -> None:
    dim = patterned(0.02)
    with pytest.warns(st.EstimateWarning, match="tau: 0.0012 is too high for .* % of the pixels"):
        lost = st.estimate(dim, working_point_px=0)
    found = st.estimate(dim, working_point_px=0, tau="auto")
    assert full(lost) == 0
    assert full(found) == 1
    # The error bars know what so little contrast is worth: the errors stay within four of them.
    inner = found.isel(t=0, y=slice(14, -14), x=slice(14, -14))
    assert float(abs((inner["disparity"] - 0.3) / inner["disparity_std"]).quantile(0.95)) < 4


def test_the_warning_tells_how_many_pixels() -> None:
    with pytest.warns(st.EstimateWarning) as caught:
        st.estimate(patterned(0.02, share=0.5), working_point_px=0)
    assert caught[0].filename == __file__
    told = float(str(caught[0].message).split(" for ")[1].split(" %")[0])
    # Half of what filters and window can reach; windows of 25 px smear the border.
    assert told == pytest.approx(50, abs=8)


@pytest.mark.parametrize(("contrast", "share"), [(0.3, 1.0), (0.3, 0.3), (0.0, 1.0)])
def test_bright_textures_and_blanks_are_no_reason_for_a_warning(contrast: float, share: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.estimate(patterned(contrast, share), working_point_px=0)


def test_nothing_is_said_of_a_threshold_from_noise() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.estimate(patterned(0.005), working_point_px=0, tau="auto")


def test_a_caller_who_makes_warnings_errors_gets_this_one() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(st.EstimateWarning):
            st.estimate(patterned(0.02), working_point_px=0)


@pytest.mark.parametrize("value", [0, 7, 30000])
def test_nothing_is_said_of_blanks_without_noise(value: int) -> None:
    """What rounding leaves of a blank is no texture, whatever its eigenvalues' ratios."""
    blank = st.make_recording(np.full((1, 3, 7, 7), value, np.uint16), 500.0, 5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.estimate(blank, window_taps_px=3)
