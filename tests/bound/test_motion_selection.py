"""Selection of the motion model by growth: against noise-free fits, against both models, and against chi squared."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

import scenetruth as st
from scenetruth.bound import MapNeighbourhood, PointNeighbourhood, cramer_rao_bound, select_affine
from tests.helpers.nightly import nightly
from tests.helpers.prediction_scenes import wall

SIGMA_PX = 4.0
RATE_PER_HOUR = 0.12  # 0.002 per frame
INSIDE = (slice(14, -14), slice(18, -18))


@cache
def growing(axis: tuple[float, float, float], share: float | None) -> tuple[xr.Dataset, xr.Dataset]:
    """Recording without noise, and truth, of a sheet that is inclined about an axis and grows along X."""
    growth: dict[str, Any] = {"kind": "growth", "rate_per_hour": RATE_PER_HOUR}
    growth |= {} if share is None else {"along_share": share}
    pose = {"position_mm": [0, 0, 600], "rotations": [{"axis": list(axis), "angle_deg": 15}]}
    plain = wall(motion=[], pose=pose, deformation=[growth], frames={"count": 5, "frame_interval_s": 60})
    return st.simulate(st.Scene.from_dict(plain | {"sensor": "ideal"}))


def std(axis: tuple[float, float, float], share: float | None, noise_std: float, motion: Any) -> NDArray[np.float64]:
    recording, truth = growing(axis, share)
    bound = cramer_rao_bound(truth, recording, noise_std=noise_std, window_sigma_px=SIGMA_PX, motion=motion)
    return np.asarray(bound["growth_rate_std"].values[0])


ALONG, ASIDE = (0.0, 1.0, 0.0), (1.0, 1.0, 0.0)


@nightly
@pytest.mark.parametrize(("axis", "share", "expected"), [(ALONG, 1.0, 0.002), (ALONG, 0.8, 0.0012), (ASIDE, 1.0, 0.0)])
def test_the_bias_is_that_of_a_fit_without_noise(
    axis: tuple[float, float, float], share: float, expected: float
) -> None:
    """Growth e_1 along the slope and e_2 across it appears as 2 e_2: the rest as a rotation towards the camera.

    With so much noise that the affine model is nowhere selected, the variances of ``auto`` and ``growing`` differ by
    the squared bias.
    """
    recording, truth = growing(axis, share)
    settings: dict[str, Any] = {
        "window_sigma_px": SIGMA_PX,
        "motion": "growing",
        "acceleration": False,
        "surface": "plane",
    }
    estimate = st.estimate(recording, "refined", **settings).sel(t=0)
    error = (estimate["growth_rate"].values - truth["growth_rate"].sel(t=0).values)[INSIDE]
    auto, plain = (std(axis, share, 0.1, motion)[INSIDE] for motion in ("auto", "growing"))
    known = np.isfinite(error) & np.isfinite(auto)
    assert known.mean() > 0.9
    bias = np.sqrt(np.maximum(auto**2 - plain**2, 0.0))
    assert np.median(np.abs(error[known])) == pytest.approx(expected, abs=2e-4)
    assert np.sqrt(np.mean((bias[known] - np.abs(error[known])) ** 2)) < 1e-4


def test_the_affine_model_is_selected_where_the_bias_exceeds_its_noise() -> None:
    least = 1e-3
    affine = std(ALONG, 1.0, least, "affine")
    # The noise at which the affine model is as uncertain as isotropic growth is biased.
    middle = least * 0.002 / np.nanmedian(affine[INSIDE])
    for noise_std, motion in ((0.5 * middle, "affine"), (2 * middle, "growing")):
        found, expected = (std(ALONG, 1.0, noise_std, each)[INSIDE] for each in ("auto", motion))
        if motion == "growing":
            expected = np.hypot(expected, 0.002)
        np.testing.assert_allclose(np.nanmedian(found), np.nanmedian(expected), rtol=0.05)


def test_isotropic_growth_is_not_biased() -> None:
    np.testing.assert_allclose(std(ALONG, None, 0.01, "auto"), std(ALONG, None, 0.01, "growing"), rtol=1e-3)


def test_points_and_maps_have_the_same_neighbourhoods() -> None:
    """Of a map, every pixel is a point."""
    pieces = np.zeros((24, 30), dtype=np.int64)
    pieces[:, 18:] = 1
    pieces[:3] = -1
    values = np.random.default_rng(0).normal(size=pieces.shape)
    values[5, 7] = np.nan
    rows, columns = np.nonzero(pieces >= 0)
    points = PointNeighbourhood(
        columns.astype(float), rows.astype(float), pieces[rows, columns], np.ones(len(rows)), 1.5
    )
    maps = MapNeighbourhood(pieces, 1.5)
    for found, expected in (
        (points.mean(values[rows, columns], 2.0), maps.mean(values, 2.0)),
        (points.coverage(2.0), maps.coverage(2.0)),
    ):
        np.testing.assert_allclose(found, expected[rows, columns], atol=2e-3)


def test_a_small_surface_requires_a_significant_bias() -> None:
    """Of one window, the excess over 1 of χ² is 9.8 with a probability of one in a thousand; of many, that of noise."""

    def selected(bias: float, size_px: int) -> bool:
        shape = (size_px, size_px)
        around = MapNeighbourhood(np.zeros(shape, dtype=np.int64), 6.0)
        found = select_affine(np.full(shape, bias), np.full(shape, 0.1), np.ones(shape), around)
        return bool(found[size_px // 2, size_px // 2])

    few = np.sqrt(chi2.ppf(0.999, 1) - 1.0)
    assert selected(1.05 * few, 1)
    assert not selected(0.9 * few, 1)
    assert selected(1.02, 300)
    assert not selected(0.98, 300)
