"""Strain in windows against homogeneous deformations, the growth rate, and the noise of least squares."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration, add_calibration_errors
from scenetruth.schema import check_dataset, label
from scenetruth.scoring import compute_growth_rate
from scenetruth.settings import ScoreSettings
from scenetruth.strain import StrainSettings, describe_missing_strain
from tests.helpers.deformed_planes import CAMERA, SHAPE, estimate_of, expected_strain, plane_points, tangent_axes
from tests.helpers.nightly import by_night

Map = NDArray[np.float64]

ANALYSIS = 1e-6
"""Agreement of strain with analysis."""
NOISE = 0.05
"""Agreement of standard deviations with theory; 20 fields have a hundred independent windows each, or 1.6 %."""
FINITE = ("green_lagrange", "hencky", "engineering")

angles = some.floats(-0.8, 0.8)
parts = some.floats(-0.2, 0.2)


def tensor(strain: xr.Dataset) -> Map:
    """Return the components at the valid points, shape (2, 2, n)."""
    valid = strain["valid"].values
    assert valid.sum() > 100
    xx, yy, xy = (strain[name].values[valid] for name in ("exx", "eyy", "exy"))
    return np.array([[xx, xy], [xy, yy]])


@settings(max_examples=20)
@given(
    tilt=some.floats(-60, 60),
    turn=some.tuples(angles, angles, angles),
    rows=some.lists(parts, min_size=9, max_size=9),
    measure=some.sampled_from(FINITE),
    weights=some.sampled_from(("uniform", "gaussian")),
    order=some.sampled_from((1, 2)),
)
def test_homogeneous_deformation_of_a_tilted_plane(
    tilt: float, turn: tuple[float, ...], rows: list[float], measure: str, weights: str, order: int
) -> None:
    points = plane_points(tilt)
    rotation = np.asarray(Rotation.from_rotvec(turn).as_matrix())
    gradient = rotation @ (np.eye(3) + np.reshape(rows, (3, 3))) - np.eye(3)
    moved = np.einsum("ij,jyx->iyx", gradient, points) + np.array([3.0, -2.0, 20.0])[:, None, None]
    strain = st.compute_strain(
        estimate_of(points[2], moved),
        displacement=moved,
        settings={"measure": measure, "window": 7, "step": 3, "weights": weights, "order": order},
    )
    expected = expected_strain(gradient, tangent_axes(points), measure)
    found = tensor(strain)
    np.testing.assert_allclose(found, np.broadcast_to(expected[:, :, None], found.shape), rtol=0, atol=ANALYSIS)
    valid = strain["valid"].values
    smaller, larger = np.linalg.eigvalsh(expected)
    np.testing.assert_allclose(strain["e1"].values[valid], larger, rtol=0, atol=ANALYSIS)
    np.testing.assert_allclose(strain["e2"].values[valid], smaller, rtol=0, atol=ANALYSIS)
    angle = strain["angle"].values[valid]
    direction = np.stack([np.cos(angle), np.sin(angle)])
    along = np.einsum("an,ab,bn->n", direction, expected, direction)
    np.testing.assert_allclose(along, larger, rtol=0, atol=ANALYSIS)


@settings(max_examples=10)
@given(turn=some.tuples(angles, angles, angles), measure=some.sampled_from(("green_lagrange", "hencky")))
def test_rigid_motion_of_a_curved_surface_is_no_strain(turn: tuple[float, ...], measure: str) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    depth = 600.0 + 8 * np.sin(x / 9.0) + 5 * np.cos(y / 7.0)
    points = plane_points(0.0) / 600.0 * depth
    rotation = np.asarray(Rotation.from_rotvec(turn).as_matrix())
    moved = np.einsum("ij,jyx->iyx", rotation - np.eye(3), points) + np.array([1.0, 2.0, 3.0])[:, None, None]
    gauge = {"measure": measure, "window": 5, "step": 2}
    strain = st.compute_strain(estimate_of(depth, moved), displacement=moved, settings=gauge)
    np.testing.assert_allclose(tensor(strain), 0, rtol=0, atol=1e-11)


def test_engineering_strain_contains_the_rotation() -> None:
    points, angle = plane_points(0.0), 0.1
    rotation = np.asarray(Rotation.from_rotvec([0, 0, angle]).as_matrix())
    moved = np.einsum("ij,jyx->iyx", rotation - np.eye(3), points)
    strain = st.compute_strain(estimate_of(points[2], moved), displacement=moved, settings={"measure": "engineering"})
    np.testing.assert_allclose(tensor(strain)[0, 0], math.cos(angle) - 1, rtol=1e-9)


@settings(max_examples=10)
@given(tilt=some.floats(-60, 60), turn=some.tuples(angles, angles, angles), rates=some.tuples(parts, parts, parts))
def test_steady_velocity_is_integrated_over_the_frame(
    tilt: float, turn: tuple[float, ...], rates: tuple[float, ...]
) -> None:
    """Growth with the rates D in its plane is the Hencky strain D after one frame; rotation of any size is none."""
    points = plane_points(tilt)
    axes = tangent_axes(points)
    growth = axes @ np.array([[rates[0], rates[2]], [rates[2], rates[1]]]) @ axes.T
    velocity = np.einsum("ij,jyx->iyx", growth, points)
    strain = st.compute_strain(estimate_of(points[2], velocity), settings={"measure": "hencky", "window": 5, "step": 3})
    expected = np.array([[rates[0], rates[2]], [rates[2], rates[1]]])[:, :, None]
    found = tensor(strain)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=0, atol=ANALYSIS)
    turning = np.einsum("ij,jyx->iyx", np.cross(np.eye(3), turn), points)
    still = st.compute_strain(estimate_of(points[2], turning), settings={"window": 5, "step": 3})
    np.testing.assert_allclose(tensor(still), 0, rtol=0, atol=1e-11)


def test_trace_of_the_rate_is_the_growth_rate_in_the_same_window() -> None:
    """Both fit the same affine functions, so that they agree to rounding, whatever the fields."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    depth = 600.0 + 5 * np.sin(x / 9.0) + 3 * np.cos(y / 7.0)
    depth[:, 50:] += 40.0
    depth[20:24, 10:14] = np.nan
    moved = 1e-2 * np.stack([np.sin(x / 17 + y / 23), np.cos(y / 13), np.sin(x / 11)])
    estimate, sigma = estimate_of(depth, moved), 3.0
    growth = compute_growth_rate(estimate, settings=ScoreSettings(growth_window_px=sigma)).values
    # The growth rate ends its Gaussian at three standard deviations.
    gauge = {"window": 19, "step": 1, "weights": "gaussian", "edge_weight": math.exp(-0.5 * 3**2)}
    strain = st.compute_strain(estimate, settings={"measure": "rate", **gauge})
    np.testing.assert_array_equal(strain["valid"].values, np.isfinite(growth))
    np.testing.assert_allclose((strain["exx"] + strain["eyy"]).values, growth, rtol=0, atol=1e-14)
    assert strain["exx"].attrs["units"] == "1/frame"


def noisy_strain(
    noise_mm: float, count: int, sigma_px: float = 0.0, stated_px: float | None = None, seed: int = 1, **settings: Any
) -> tuple[Map, xr.Dataset]:
    """Return samples (k, y, x) of exx, eyy and exy from noisy displacements, and the last strain."""
    points, rng = plane_points(0.0), np.random.default_rng(seed)
    samples = []
    for _ in range(count):
        noise = rng.standard_normal((3, *SHAPE))
        if sigma_px:
            # The mean of white noise in Gaussian windows, with its variance restored.
            noise = (
                ndimage.gaussian_filter(noise, (0, sigma_px, sigma_px), mode="wrap") * 2 * math.sqrt(math.pi) * sigma_px
            )
        estimate = estimate_of(points[2], noise_mm * noise, (noise_mm, 0.0))
        strain = st.compute_strain(
            estimate, settings={"correlation_sigma_px": sigma_px if stated_px is None else stated_px, **settings}
        )
        samples.append(np.stack([strain[name].values[0] for name in ("exx", "eyy", "exy")]))
    return np.array(samples), strain


def interior(strain: xr.Dataset) -> tuple[Any, ...]:
    """Return the points with complete windows."""
    reach = strain.attrs["window"] // 2
    return (..., slice(reach, -reach), slice(reach, -reach))


def test_white_noise_against_the_closed_form_of_least_squares() -> None:
    """A slope over n x n points at the distance a has the variance 12 s² / (a² n² (n² - 1)), and shear half of it."""
    noise, window, step = 1e-3, 7, 2
    samples, strain = noisy_strain(noise, 25, window=window, step=step)
    spacing = step * 600.0 / CAMERA.focal_length_px
    theory = noise / spacing * math.sqrt(12 / (window**2 * (window**2 - 1)))
    for component, factor in enumerate((1, 1, 1 / math.sqrt(2))):
        measured = samples[:, component][interior(strain)].std()
        assert measured == pytest.approx(factor * theory, rel=NOISE)
    stated = strain["exx_std"].values[0][interior(strain)]
    # The noise of the sample itself changes the sensitivities by 1e-3 of them.
    np.testing.assert_allclose(stated, theory, rtol=2e-3)


@pytest.mark.parametrize(
    ("measure", "order"), [("hencky", 2), *by_night(("green_lagrange", 1), ("green_lagrange", 2), ("rate", 1))]
)
def test_stated_noise_is_that_of_many_samples_at_borders_too(measure: str, order: int) -> None:
    samples, strain = noisy_strain(2e-3, 40, window=7, step=3, order=order, measure=measure)
    for component, name in enumerate(("exx", "eyy", "exy")):
        stated = strain[f"{name}_std"].values[0]
        ratio = samples[:, component].std(axis=0, ddof=1) / stated
        assert math.sqrt(np.nanmean(ratio**2)) == pytest.approx(1, rel=NOISE)
        # The first row, whose windows have half of the points.
        assert math.sqrt(np.nanmean(ratio[0, 3:-3] ** 2)) == pytest.approx(1, rel=2 * NOISE)


def test_noise_of_overlapping_windows_is_stated_with_its_correlation() -> None:
    correlated = noisy_strain(1e-3, 25, 3.0, window=9, step=2)
    measured = correlated[0][:, 0][interior(correlated[1])].std()
    stated = correlated[1]["exx_std"].values[0][interior(correlated[1])]
    assert measured == pytest.approx(float(stated.mean()), rel=NOISE)
    # Without it, the stated noise would be far too small.
    independent = noisy_strain(1e-3, 1, 3.0, 0.0, window=9, step=2)[1]
    assert measured > 2 * float(independent["exx_std"].values[0][interior(correlated[1])].mean())
    # At borders, where windows are cut, as in all points.
    ratio = correlated[0][:, 0].std(axis=0, ddof=1) / correlated[1]["exx_std"].values[0]
    assert math.sqrt(np.nanmean(ratio**2)) == pytest.approx(1, rel=NOISE)
    assert math.sqrt(np.nanmean(ratio[:, 0] ** 2)) == pytest.approx(1, rel=2 * NOISE)


def test_noise_of_depth_counts_where_the_surface_turns() -> None:
    """A surface that turns about Y moves with w_x out of its plane: a wrong slope then counts as strain."""
    points, rng, turn = plane_points(0.0), np.random.default_rng(2), 0.2
    moved = np.einsum("ij,jyx->iyx", np.cross(np.eye(3), [0, turn, 0]), points)
    samples = []
    for _ in range(20):
        depth = points[2] + 0.05 * rng.standard_normal(SHAPE)
        strain = st.compute_strain(
            estimate_of(depth, moved, (0.0, 0.05)),
            settings={"measure": "engineering", "window": 7, "step": 2, "correlation_sigma_px": 0},
        )
        samples.append(strain["exx"].values[0])
    inner = interior(strain)
    measured = math.sqrt(np.var(np.array(samples), axis=0)[inner].mean())
    assert measured == pytest.approx(float(strain["exx_std"].values[0][inner].mean()), rel=NOISE)


def test_principal_strains_of_noise_alone_are_covered() -> None:
    """Noise makes two principal values of equal strains: their RMS is √1.5 times that of a strain."""
    ratios, plain = [], []
    for seed in range(5):
        strain = noisy_strain(1e-3, 1, seed=seed, window=7, step=2)[1]
        valid = strain["valid"].values
        ratios.append(strain["e1"].values[valid] / strain["e1_std"].values[valid])
        plain.append(strain["e1"].values[valid] / strain["exx_std"].values[valid])
        assert float(strain["angle_std"].max()) <= math.pi / math.sqrt(12)
    # Five fields have some 250 independent windows: 4 % of a standard deviation.
    assert math.sqrt(np.mean(np.square(np.concatenate(ratios)))) == pytest.approx(1.05, abs=0.12)
    assert math.sqrt(np.mean(np.square(np.concatenate(plain)))) == pytest.approx(math.sqrt(1.5), abs=0.12)


def test_unknown_correlation_states_no_standard_deviation() -> None:
    points = plane_points(10.0)
    estimate = estimate_of(points[2], 0 * points, (0.01, 0.01))
    strain = st.compute_strain(estimate)
    assert "exx_std" not in strain
    assert strain.attrs["std_parts"].startswith("none")
    stated = estimate.assign_attrs(settings='{"window_sigma_px": 4.0}')
    assert "exx_std" in st.compute_strain(stated)


def test_windows_with_points_of_unknown_noise_state_none() -> None:
    points = plane_points(10.0)
    estimate = estimate_of(points[2], 0 * points, (0.01, 0.01))
    estimate = xr.concat(
        [estimate, estimate.assign_coords(t=[1])], "t", data_vars="all", coords="minimal", compat="override"
    )
    estimate["velocity_std"].values[1, 1, 30, 40] = np.nan
    strain = st.compute_strain(estimate, settings={"window": 5, "step": 1, "correlation_sigma_px": 0})
    unknown = np.isnan(strain["exx_std"].values) & strain["valid"].values
    rows, columns = np.nonzero(unknown[1])
    assert not unknown[0].any()
    assert sorted(set(rows.tolist())) == list(range(28, 33))
    assert sorted(set(columns.tolist())) == list(range(38, 43))
    # Everything else of them is valid.
    assert np.isfinite(strain["exx"].values[unknown[:, :, :]]).all()


def test_gauge_is_stated_in_px_and_mm() -> None:
    points = plane_points(0.0)
    estimate = estimate_of(points[2], 0 * points, attrs={"settings": '{"window_sigma_px": 4.0}'})
    strain = st.compute_strain(estimate, settings={"window": 9, "step": 3})
    length = 8 * 3 + 2 * math.sqrt(math.pi) * 4
    assert strain.attrs["gauge_length_px"] == pytest.approx(length)
    assert strain.attrs["gauge_length_mm"] == pytest.approx(length * 600 / 500)
    half = estimate.isel(x=slice(None, None, 2), y=slice(None, None, 2))
    assert st.compute_strain(half, settings={"window": 9, "step": 3}).attrs["step_px"] == 6


def test_windows_end_at_depth_steps_and_invalid_pixels_have_reasons() -> None:
    points = plane_points(0.0)
    depth = points[2].copy()
    depth[:, 40:] += 60.0
    moved = np.zeros((3, *SHAPE))
    # Each side moves as a rigid body; a window over both would see a strain.
    moved[0, :, 40:] = 5.0
    depth[30:34, 10:20] = np.nan
    # Segments of single pixels: the first is not in the lattice of step 3.
    depth[8, 60], depth[10, 10] = 310.0, 300.0
    strain = st.compute_strain(estimate_of(depth, moved), settings={"window": 5, "step": 1})
    assert strain["invalid_reason"].values[0, 10, 10] == 2
    assert st.compute_strain(estimate_of(depth, moved), settings={"window": 5, "step": 3})["valid"].any()
    np.testing.assert_allclose(tensor(strain), 0, atol=1e-12)
    reason = strain["invalid_reason"].values[0]
    assert (reason[30:34, 10:20] == 1).all()
    assert reason[0, 0] == 2
    assert ((reason == 0) == strain["valid"].values[0]).all()


def test_points_without_a_depth_have_no_strain() -> None:
    points = plane_points(0.0)
    for depth in (0 * points[2], -points[2]):
        strain = st.compute_strain(estimate_of(depth, 0 * points))
        assert (strain["invalid_reason"] == 1).all()


def test_missing_strain_is_explained() -> None:
    settings = StrainSettings(window=21, step=4)
    assert describe_missing_strain(np.array([1, 0, 2]), settings) == ""
    assert "2 of 2 points have no valid depth and motion; `invalid_reason`" in describe_missing_strain(
        np.array([1, 1]), settings
    )
    words = describe_missing_strain(np.array([1, 2, 2]), settings)
    assert "1 of 3 points have no valid depth and motion, 2 have too few valid points" in words
    assert "window of 21 points every 4 pixels, 81 pixels wide; reduce" in words


def test_given_displacements_replace_the_velocity() -> None:
    points = plane_points(20.0)
    gradient = np.array([[0.1, 0.05, 0], [0, -0.2, 0.02], [0.1, 0, 0]])
    moved = np.einsum("ij,jyx->iyx", gradient, points)
    estimate = estimate_of(points[2], 0 * points)
    strain = st.compute_strain(estimate, displacement=moved, displacement_std=np.full(moved.shape, 1e-3))
    expected = expected_strain(gradient, tangent_axes(points), "green_lagrange")
    np.testing.assert_allclose(tensor(strain)[0, 1], expected[0, 1], atol=ANALYSIS)
    assert strain.attrs["displacement_source"] == "given"
    assert np.isfinite(strain["exx_std"].values[strain["valid"].values]).all()


def test_strain_is_stored_and_read_back(tmp_path: Any) -> None:
    points = plane_points(20.0)
    strain = st.compute_strain(estimate_of(points[2], 0 * points))
    check_dataset(strain, "strain")
    st.save_store(strain, tmp_path / "strain.zarr")
    xr.testing.assert_identical(st.load_store(tmp_path / "strain.zarr", kind="strain"), strain)


def test_all_problems_are_reported_together() -> None:
    points = plane_points(0.0)
    estimate = estimate_of(points[2], 0 * points)
    with pytest.raises(st.ScoreError) as caught:
        st.compute_strain(estimate, settings={"window": 4, "order": 3, "measure": "log"})
    assert {problem.path for problem in caught.value.problems} == {"window", "order", "measure"}
    with pytest.raises(st.ScoreError, match="velocity: is missing"):
        st.compute_strain(estimate.drop_vars("velocity"))
    with pytest.raises(st.ScoreError, match="must have the shape"):
        st.compute_strain(estimate, displacement=np.zeros((3, 2, 2)))
    with pytest.raises(st.ScoreError, match="must not be given for the rate"):
        st.compute_strain(estimate, displacement=0 * points, settings={"measure": "rate"})
    for wrong in ("much", 1j * points):
        with pytest.raises(st.ScoreError, match="displacement: must be an array of real numbers"):
            st.compute_strain(estimate, displacement=wrong)
    with pytest.raises(st.ScoreError, match=r"displacement_std: must not be negative \(got -2\.0\)"):
        st.compute_strain(estimate, displacement=0 * points, displacement_std=0 * points - 2)
    disparity = label("estimate", {"disparity": np.ones((1, *SHAPE))}, CAMERA, t=[0])
    with pytest.raises(st.ScoreError) as caught:
        st.compute_strain(disparity)
    assert {problem.path for problem in caught.value.problems} == {"depth", "velocity"}


@pytest.mark.parametrize("measure", ["rate", "green_lagrange"])
def test_error_of_the_focal_length_is_the_common_part(measure: str) -> None:
    """With another focal length, depth and its changes scale, X and Y stay: the strain differs by its common part."""
    std_px = 2.0
    points = plane_points(35.0)
    turning = np.einsum("ij,jyx->iyx", np.cross(np.eye(3), [0.01, 0.05, 0]), points)
    velocity = turning + np.array([0.02, -0.01, 0.0])[:, None, None] * points
    stated = estimate_of(points[2], velocity, (1e-6, 1e-6), {"settings": '{"window_sigma_px": 2.0}'})
    camera = Camera(
        width=SHAPE[1], height=SHAPE[0], focal_length_px=CAMERA.focal_length_px, principal_point_px=(39.5, 29.5)
    )
    estimate = add_calibration_errors(stated, RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": std_px}))
    chosen = {"window": 5, "step": 4, "measure": measure}
    found = st.compute_strain(estimate, settings=chosen)
    scale = 1 + std_px / CAMERA.focal_length_px
    other = stated.assign_attrs(focal_length_px=CAMERA.focal_length_px + std_px)
    scales = xr.DataArray([1.0, 1.0, scale], dims="component")
    other = other.assign(depth=scale * other["depth"], velocity=scales * other["velocity"])
    changed = st.compute_strain(other, settings=chosen)
    valid = found["valid"].values
    for name in ("exx", "eyy", "exy"):
        change = abs((changed[name] - found[name]).values[valid])
        assert change.max() > 1e-5
        # One standard deviation is 0.4 %, whose square is the difference between both.
        common = found[f"{name}_std_common"].values[valid]
        np.testing.assert_allclose(common, change, rtol=0, atol=0.01 * change.max())
        assert (found[f"{name}_std"].values[valid] >= found[f"{name}_std_common"].values[valid]).all()
