"""Windows on a lattice, compared with windows around every pixel."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined import (
    FIT_LIMITS,
    DefectFilteredFrames,
    Fit,
    ImageStack,
    RefinedState,
    Splines,
    fit_round,
    initial_parameters,
    lattice_step,
    nearest_node,
    refine,
    select_models,
)
from tests.helpers.wavy_plane import MovingPlane, turning

PLANE = MovingPlane(gradient=turning(2e-3, -1e-3, 3e-3))


def plane_images() -> ImageStack:
    """Return the images of a turning plane with noise."""
    recording = PLANE.recording(3, 5)
    noise = np.random.default_rng(0).normal(0.0, 0.01, recording["image"].shape)
    recording = recording.assign(image=(recording["image"].dims, recording["image"].values + noise))
    return ImageStack(
        Splines(DefectFilteredFrames(recording), 5).frames(0, 5),
        np.stack([recording["s"].values, np.zeros(3)], axis=-1),
        recording["t"].values.astype(float),
        PLANE.focal_px,
        ((PLANE.size[1] - 1) / 2, (PLANE.size[0] - 1) / 2),
        np.zeros((15, 4)),
    )


def refined() -> RefinedState:
    """Return the fit to the plane."""
    images = plane_images()
    return refine(images, PLANE.start(), RefinedSettings(window_sigma_px=4.5, surface="plane", max_iterations=6))


def test_the_step_follows_the_window() -> None:
    """Half the sampling frequency is beyond the pass band of the window: exp(-4 π² σ² f²) is 4e-9 there."""
    for sigma in (1.5, 2.4, 4.0, 6.0, 9.0):
        step = lattice_step(sigma)
        assert step == 1 or np.exp(-4 * np.pi**2 * sigma**2 / (2 * step) ** 2) < 4e-9
    assert (lattice_step(1.4), lattice_step(6.0)) == (1, 4)


def test_fits_of_the_lattice_are_those_of_every_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    """To a tenth of the standard deviation, the limit of the interpolation error."""
    some = refined().fit
    monkeypatch.setattr(FIT_LIMITS, "lattice_step", 0.0)
    every = refined().fit
    known = np.isfinite(every.theta).all(axis=0)
    assert (np.isfinite(some.theta).all(axis=0) == known).mean() > 0.99
    for place, number in ((0, 0), (6, 3), (9, 4), (12, 5)):
        scaled = (some.theta[place] - every.theta[place]) / np.sqrt(every.variance[number])
        assert np.sqrt(np.nanmean(scaled**2)) < 0.1
        ratio = some.variance[number] / every.variance[number]
        # Standard deviations within 5 %.
        assert np.nanquantile(np.abs(ratio - 1), 0.99) < 0.1


def test_each_surface_model_is_interpolated_between_its_own_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plane on the left, curved on the right: the fits next to the boundary are those of windows at every pixel."""
    images = plane_images()
    start = initial_parameters(PLANE.start(), accelerated=False)
    models = select_models(images, RefinedSettings())
    chosen = np.zeros(images.shape, dtype=np.int8)
    chosen[:, images.shape[1] // 2 :] = 1

    def fitted() -> Fit:
        return fit_round(images, start, models, 6.0, gains=True, variances=6, chosen=chosen)[0]

    some = fitted()
    monkeypatch.setattr(FIT_LIMITS, "lattice_step", 0.0)
    every = fitted()
    assert (np.isfinite(some.theta).all(axis=0) == np.isfinite(every.theta).all(axis=0)).all()
    # Only the model on the right has a curvature.
    curvature = np.nan_to_num(some.theta[3])
    assert (curvature[chosen == 0] == 0).all()
    assert (curvature[chosen == 1] != 0).mean() > 0.5
    scaled = (some.theta[0] - every.theta[0]) / np.sqrt(every.variance[0])
    assert np.sqrt(np.nanmean(scaled**2)) < 0.1


def test_start_values_are_near_the_fits_of_all_rows() -> None:
    """A third of the rows: standard deviations are larger by the root of three, and so are differences."""
    images = plane_images()
    start = initial_parameters(PLANE.start(), accelerated=False)
    models = select_models(images, RefinedSettings(surface="plane"))
    assert lattice_step(4.5) == 3
    (whole,) = fit_round(images, start, models, 4.5, gains=True, variances=6)
    (draft,) = fit_round(images, start, models, 4.5, gains=True, coarse=True, draft=True)
    some = (slice(None, None, 3), slice(None, None, 3))
    known = np.isfinite(whole.theta[0])
    assert (np.isfinite(draft.theta[0]) == known)[some].mean() > 0.97
    for place, number in ((0, 0), (6, 3), (9, 4), (12, 5)):
        scaled = ((draft.theta[place] - whole.theta[place]) / np.sqrt(whole.variance[number]))[some]
        assert 0.3 < np.sqrt(np.nanmean(scaled**2)) < 2.0


def test_bands_do_not_change_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows wait for the lattices below them; rounding depends on the first row of a band."""
    images = plane_images()
    start = initial_parameters(PLANE.start(), accelerated=False)
    models = select_models(images, RefinedSettings(surface="plane"))

    def fitted() -> Fit:
        return fit_round(images, start, models, 6.0, gains=False, variances=6)[0]

    whole = fitted()
    monkeypatch.setattr(FIT_LIMITS, "scratch_bytes", 1.0)
    parts = fitted()
    np.testing.assert_allclose(parts.theta[[0, 6, 9, 12]], whole.theta[[0, 6, 9, 12]], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(parts.variance[:6], whole.variance[:6], rtol=1e-8)


def test_a_mask_of_nodes_is_that_of_the_nearest_node() -> None:
    """Rows 0 and 1 belong to the node of row 0, the others to that of row 3."""
    found = np.array([[True, False], [False, True]])
    out = nearest_node(found, 3, (5, 6))
    assert out[:2, :2].all()
    assert out[2:, 2:].all()
    assert out.sum() == 4 + 12
