"""Images that are not where they should be: how far they are is found, and error bars hold what is left."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

import scenetruth as st
from scenetruth.estimators.method_settings import CorrectionPriors
from tests.estimators.refined.surface import MovingPlane
from tests.nightly import nightly

Array = NDArray[np.float64]
CAMERAS, FRAMES, NOISE = 5, 5, 0.01
PLANE = MovingPlane(size=(80, 112))
PRIORS = {"x_px": 0.3, "y_px": 0.3, "roll_urad": 1000.0, "scale_ppm": 300.0, "repeatability_px": 0.03}
SETTINGS = {"window_sigma_px": 4.0, "window_frames": FRAMES, "surface": "plane", "outlines": False}


def moved(seed: int) -> Array:
    """Return how far images are off, drawn as the priors say, shape (cameras, frames, 4)."""
    generator = np.random.default_rng(seed)
    fixed = generator.normal(0, 1, (CAMERAS, 1, 4)) * [0.3, 0.3, 1e-3, 3e-4]
    fresh = generator.normal(0, 0.03, (CAMERAS, FRAMES, 2))
    off = np.repeat(fixed, FRAMES, axis=1)
    off[..., :2] += fresh
    return off


def errors(seed: int, *, corrected: bool = True) -> dict[str, Array]:
    """Return errors over stated standard deviations, and those of disparity alone."""
    off = moved(seed)
    recording = PLANE.recording(CAMERAS, FRAMES, noise_std=NOISE, seed=seed, moved=off)
    found = st.estimate(recording, "refined", SETTINGS | ({"corrections": PRIORS} if corrected else {})).sel(t=0)
    truth = PLANE.truth()
    inner = found["status"].values == 2
    inner[:16], inner[-16:], inner[:, :24], inner[:, -24:] = False, False, False, False
    out = {"share": np.array(inner[16:-16, 24:-24].mean())}
    # Where the reference image is, everything is told from there: its pixels show the plane from a camera that is
    # moved, by an angle of 0.3 px / f that counts for nothing here.
    at = _shown_by_reference(off[CAMERAS // 2, FRAMES // 2])
    for name, expected in (("disparity", truth["disparity"]), ("velocity", truth["velocity"])):
        exact = _at(expected, at)
        error = (found[name].values - exact)[..., inner]
        out[name] = error
        out[f"{name}_scaled"] = error / found[f"{name}_std"].values[..., inner]
    if corrected:
        beside = off[:, FRAMES // 2] - off[CAMERAS // 2, FRAMES // 2]
        # Where the reference camera is rolled, the stage moves along its y, too: by the roll times disparity.
        along = np.arange(CAMERAS) - CAMERAS // 2
        beside[:, 1] -= off[CAMERAS // 2, FRAMES // 2, 2] * along * truth["disparity"].mean()
        shift = found["image_shift"].values.T - beside[:, :2]
        with np.errstate(invalid="ignore", divide="ignore"):
            out["shift_scaled"] = shift / found["image_shift_std"].values.T
        out["shift"] = shift
    return out


def _shown_by_reference(off: Array) -> Array:
    height, width = PLANE.size
    y, x = np.mgrid[:height, :width].astype(np.float64)
    from_x, from_y = x - (width - 1) / 2, y - (height - 1) / 2
    right, down, roll, larger = off
    return np.stack([y - down - roll * from_x - larger * from_y, x - right + roll * from_y - larger * from_x])


def _at(values: Array, at: Array) -> Array:
    from scipy.ndimage import map_coordinates

    flat = values.reshape(-1, *values.shape[-2:])
    return np.stack([map_coordinates(each, at, order=1) for each in flat]).reshape(values.shape)


def test_images_are_found_where_they_are() -> None:
    found, without = errors(1), errors(1, corrected=False)
    # Across the stage nothing but the noise limits the shift: 100 times less than the images are off.
    assert np.abs(found["shift"][:, 1]).max() < 0.01
    assert np.delete(np.abs(found["shift_scaled"]), CAMERAS // 2, axis=0).max() < 4
    assert found["share"] > 0.95
    # The images cannot tell what all disparities have in common; the rest is as good as noise allows.
    spread = found["disparity"].std()
    assert spread < 0.5 * without["disparity"].std()
    assert np.abs(found["disparity_scaled"]).max() < 6


def test_nothing_to_correct_must_not_be_asked_for() -> None:
    with pytest.raises(ValidationError, match="corrects nothing"):
        CorrectionPriors()


@nightly
def test_error_bars_hold_what_is_left() -> None:
    squares: dict[str, list[float]] = {}
    for seed in range(100):
        found = errors(seed)
        for name in ("disparity_scaled", "velocity_scaled"):
            squares.setdefault(name, []).append(float(np.square(found[name]).mean()))
        shifts = np.delete(found["shift_scaled"], CAMERAS // 2, axis=0)
        squares.setdefault("shift_scaled", []).append(float(np.square(shifts).mean()))
    for name, values in squares.items():
        # Of 100 seeds, each with one disparity that all pixels have in common.
        assert np.sqrt(np.mean(values)) == pytest.approx(1.0, abs=0.2), name
