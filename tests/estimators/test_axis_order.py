"""Recordings whose axes or baseline are in the wrong order are recognised by the displacement of their images."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter
from scipy.ndimage import shift as displaced

import scenetruth as st
from scenetruth.errors import EstimateWarning
from scenetruth.estimators import prepare
from scenetruth.estimators.axis_order import describe_likely_causes, measure_shift, share_of_valid
from scenetruth.pipeline.runner import write_estimate
from tests.helpers.nightly import by_night

DISPARITY_PX, FLOW_PX = 3.0, (0.2, 0.5)


def images(disparity_px: float = DISPARITY_PX) -> np.ndarray[Any, Any]:
    """Return images (s, t, y, x) of a plane with a disparity and a flow."""
    texture = gaussian_filter(np.random.default_rng(0).standard_normal((150, 190)), 1.5)
    texture = 0.5 * texture / np.abs(texture).max()
    return np.array(
        [
            [displaced(texture, (FLOW_PX[1] * t, FLOW_PX[0] * t - disparity_px * s), mode="wrap")[30:100, 40:140]
             for t in range(5)]
            for s in range(5)
        ]
    )  # fmt: skip


def recording(given: np.ndarray[Any, Any], baseline_mm: float = 5.0, **more: Any) -> xr.Dataset:
    return st.make_recording(given, focal_length_px=1000, baseline_mm=baseline_mm, **more)


RIGHT = images()
WRONG = {
    "s and t are swapped": recording(RIGHT.transpose(1, 0, 2, 3)),
    "rows and columns are swapped": recording(RIGHT.transpose(0, 1, 3, 2)),
    "the sign of baseline_mm": recording(RIGHT, -5.0),
    "or the order of s": recording(images(-DISPARITY_PX)),
}


@pytest.mark.parametrize("cause", WRONG)
@pytest.mark.parametrize("method", ["structure_tensor", *by_night("refined", "plane_sweep")])
def test_an_estimate_without_valid_pixels_names_the_likely_cause(cause: str, method: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = st.estimate(WRONG[cause], method)
    # The plane sweep matches some pixels of other places by chance.
    assert found["valid"].mean() < (0.2 if method == "plane_sweep" else 0.01)
    (message,) = [one for one in caught if "Likely" in str(one.message)]
    assert cause in str(message.message)
    assert f"method '{method}'" in str(message.message)
    assert message.filename == __file__
    assert issubclass(message.category, EstimateWarning)


def test_an_estimate_that_is_written_frame_by_frame_warns_as_well(tmp_path: Path) -> None:
    with pytest.warns(EstimateWarning, match="s and t are swapped"):
        write_estimate(prepare(WRONG["s and t are swapped"], "structure_tensor"), tmp_path / "estimate.zarr")


def test_one_message_names_all_changes_that_would_explain_the_images() -> None:
    # Against the baseline between the cameras, along it between the frames.
    both = np.stack([np.roll(RIGHT[:, 0], 6 * s, axis=-1) for s in range(4)])
    text = describe_likely_causes(recording(both))
    assert "the axes s and t are swapped" in text
    assert "the sign of baseline_mm" in text
    assert "(x, y) = (6.0, 0.0) px between neighbouring cameras (s) and (-3.0, 0.0) px" in text


@pytest.mark.parametrize("baseline_mm", [5.0, -5.0])
def test_images_in_the_right_order_give_no_cause(baseline_mm: float) -> None:
    assert describe_likely_causes(recording(images(DISPARITY_PX * np.sign(baseline_mm)), baseline_mm)) == ""


@pytest.mark.parametrize(
    "given",
    [
        np.zeros((3, 3, 40, 50)),
        np.random.default_rng(0).uniform(-1, 1, (3, 3, 40, 50)),
        np.broadcast_to(RIGHT[0, 0], (3, 3, 70, 100)),
        np.broadcast_to(np.sin(np.arange(60) / 2)[:, None], (3, 3, 60, 50)),
        np.full((3, 3, 40, 50), np.nan),
    ],
    ids=["black", "noise", "at rest", "stripes", "not finite"],
)
def test_images_that_tell_nothing_give_no_cause(given: np.ndarray[Any, Any]) -> None:
    assert describe_likely_causes(recording(given, full_scale=1.0)) == ""


def test_invalid_borders_do_not_hide_the_order_of_the_axes() -> None:
    swapped = RIGHT.transpose(1, 0, 2, 3).astype(np.float32)
    swapped[0, :, :, :4] = swapped[1:, :, -3:] = np.nan
    assert "the axes s and t are swapped" in describe_likely_causes(recording(swapped))


def test_pixels_that_the_user_excludes_do_not_count() -> None:
    mask = np.ones((70, 100), dtype=bool)
    mask[:10, :10] = False  # 100 pixels
    masked = recording(RIGHT, exclusion_mask=mask)
    estimate = st.make_estimate(recording=masked, disparity=np.full((70, 100), 3.0))
    assert share_of_valid(50, estimate, masked) == 0.5
    assert share_of_valid(0, estimate, masked) == 0
    assert share_of_valid(50, estimate, recording(RIGHT)) == 50 / 7000
    assert share_of_valid(0, estimate, recording(RIGHT, exclusion_mask=np.ones_like(mask))) == 1


def test_images_whose_displacement_is_not_certain_count_only_without_valid_pixels() -> None:
    noise = np.random.default_rng(1).uniform(-1, 1, RIGHT.shape)
    # Cameras without a common texture, and frames that move as cameras do.
    moving = np.stack([np.roll(noise[:, 0], -4 * t, axis=-1) for t in range(5)], axis=1)
    assert "s and t are swapped" in describe_likely_causes(recording(moving))
    assert describe_likely_causes(recording(moving), 0.05) == ""
    swapped = RIGHT.transpose(1, 0, 2, 3)
    assert "only 5 % of the pixels are valid" in describe_likely_causes(recording(swapped), 0.05)
    assert describe_likely_causes(recording(swapped), 0.2) == ""


@pytest.mark.parametrize("shift", [(0.0, -3.0), (2.4, 0.0), (-7.0, 12.0)])
def test_a_displacement_is_measured_to_a_tenth_of_a_pixel(shift: tuple[float, float]) -> None:
    first = RIGHT[0, 0]
    found = measure_shift(first, displaced(first, shift, mode="nearest"))
    assert found == pytest.approx(shift, abs=0.11)
