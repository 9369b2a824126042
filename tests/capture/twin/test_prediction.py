"""Predictions of twins: bends that count as edges, common parts, and values that both show."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

import scenetruth as st
from scenetruth.capture import Comparison, RegionError, TwinPrediction
from scenetruth.capture.twin import mark_bends, predict_errors, sampling_std
from tests.helpers.nightly import nightly


def scene(mesh: dict[str, object], *rotations: dict[str, object]) -> dict[str, object]:
    body = {"name": "body", "mesh": mesh, "texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    body["pose"] = {"position_mm": [0, 0, 600], "rotations": list(rotations)}
    return {
        "camera": {"width": 80, "height": 60, "focal_length_px": 800},
        "stage": {"positions": 3, "baseline_mm": 8},
        "frames": {"count": 1},
        "objects": [body],
        "sensor": {"noise_std": 0.01},
        "render": {"backend": "raycast"},
    }


@nightly
def test_a_strong_bend_is_an_edge_and_a_weak_one_is_not() -> None:
    # At 600 mm a pixel is 0.75 mm: normals at a distance of 12 px differ by 9 / R.
    for radius, bent in ((8.0, True), (60.0, False)):
        mesh = {"kind": "cylinder", "radius_mm": radius, "length_mm": 200}
        truth = st.make_truth(st.Scene.from_dict(scene(mesh)))
        marked = mark_bends(truth)
        middle = marked["mixed"].values[0, 25:35, 38:42]
        assert bool(middle.all()) is bent
        assert bool(middle.any()) is bent
        assert (marked["mixed"].values >= truth["mixed"].values).all()
    assert marked["boundary_distance"].values == pytest.approx(truth["boundary_distance"].values)


def test_a_bend_that_noise_explains_is_none() -> None:
    mesh = {"kind": "cylinder", "radius_mm": 8.0, "length_mm": 200}
    truth = st.make_truth(st.Scene.from_dict(scene(mesh)))
    # The second difference of the depth over 6 px, 4.5 mm of 8 mm, is 2 x (8 - sqrt(64 - 20)) = 2.7 mm in the middle.
    for std, bent in ((0.5, True), (1.2, False)):
        marked = mark_bends(truth, np.full((60, 80), std))["mixed"].values
        assert bool(marked[0, 25:35, 39:41].all()) is bent
    assert not (mark_bends(truth, np.full((60, 80), np.nan))["mixed"].values & ~truth["mixed"].values).any()


def test_a_rounded_crease_is_a_narrow_bend() -> None:
    """The interior of a surface that a method has rounded is about as large as that of the sharp one."""
    _, x = np.indices((60, 80), dtype=np.float64)
    slope = np.clip((x - 40) / 6, -1, 1)  # from -45° to 45° over 12 px of 1 mm
    normal = np.stack([-slope, np.zeros_like(x), np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = 600 + np.cumsum(slope, axis=1)
    truth = st.make_truth(st.Scene.from_dict(scene({"kind": "plane", "size_mm": [200, 160]})))
    truth = truth.assign(
        depth=(("t", "y", "x"), depth[None]), normal=(("t", "y", "x", "component"), normal[None]),
        mixed=(truth["mixed"].dims, np.zeros((1, 60, 80), dtype=bool)),
    )  # fmt: skip
    columns = np.flatnonzero(mark_bends(truth)["mixed"].values[0, 30])
    assert len(columns)
    assert 34 < columns.min() <= 40 <= columns.max() < 46


def test_rows_add_the_parts_and_know_what_the_capture_states() -> None:
    plain = scene({"kind": "plane", "size_mm": [200, 160]})
    recording, truth = st.simulate(plain)
    depth = truth["depth"].values
    std = np.full(depth.shape, 0.5)
    twin = st.make_estimate(recording=recording, depth=depth + 0.2, depth_std=std)
    capture = twin.assign(depth_std_common=(("t", "y", "x"), np.full(depth.shape, 0.3, np.float32)))
    settings = {"interior_margin_px": 0.0}
    score = st.score(twin, truth, recording, settings=settings)
    found = predict_errors(score, [twin], truth, recording, capture)
    row = next(each for each in found.rows if (each.region, each.quantity) == ("all", "depth"))
    assert row.bias == pytest.approx(0.2, abs=1e-4)
    assert row.common_std == pytest.approx(0.3, rel=1e-6)
    assert row.rmse == pytest.approx(math.hypot(0.2, 0.3), rel=1e-3)
    assert row.stated_twin == pytest.approx(0.5)
    assert row.stated_capture == pytest.approx(0.4)
    assert row.capture_density == 1.0
    assert row.density == 1.0
    # Further simulations are averaged, and pixels that the measurement lacks are not counted.
    half = capture.assign(depth=capture["depth"].where(capture["x"] < 40))
    other = twin.assign(depth=twin["depth"] + (0.4 * (-1.0) ** twin["x"] - 0.2).astype(np.float32))
    both = predict_errors(score, [twin, other], truth, recording, half)
    row = next(each for each in both.rows if (each.region, each.quantity) == ("all", "depth"))
    assert row.count == 60 * 40
    assert row.bias == pytest.approx(0.1, abs=1e-3)
    assert row.pixel_std == pytest.approx(0.4 / math.sqrt(2), rel=1e-3)


@pytest.mark.parametrize(("sigma_px", "side"), [(4.0, 100), (6.0, 80)])
def test_sampling_std_is_the_scatter_of_the_size_of_errors(sigma_px: float, side: int) -> None:
    """Errors of a Gaussian window, in 300 draws over half of the image: Σ ρ² is 2 π σ² for them."""
    generator, kept = np.random.default_rng(5), np.zeros((side, side), dtype=bool)
    kept[:, : side // 2] = True
    stated, sizes = [], []
    for number in range(300):
        drawn = ndimage.gaussian_filter(generator.standard_normal((side, side)), sigma_px, mode="wrap")
        sizes.append(np.std(drawn[kept]))
        if number < 100:
            stated.append(sampling_std(np.where(kept, drawn, np.nan)[None]))
    scatter = float(np.std(sizes) / np.mean(sizes))
    # The scatter of 300 draws is uncertain by 4 %; few independent errors shorten the measured correlation.
    assert 0.75 < np.mean(stated) / scatter < 1.15
    assert np.mean(stated) == pytest.approx(math.sqrt(math.pi * sigma_px**2 / kept.sum()), rel=0.25)


def test_few_pixels_with_large_errors_scatter_as_few() -> None:
    """A quarter of the pixels has ten times the error of the others: 97 % of the sum of squares."""
    generator, side = np.random.default_rng(8), 80
    std = np.ones((side, side))
    std[:, : side // 4] = 10.0
    drawn = [std * ndimage.gaussian_filter(generator.standard_normal((side, side)), 3.0) for _ in range(200)]
    sizes = [np.std(each) for each in drawn]
    scatter = float(np.std(sizes) / np.mean(sizes))
    stated = np.mean([sampling_std(each[None], std[None]) for each in drawn[:40]])
    # The scatter of 200 draws is uncertain by 5 %.
    assert 0.75 < stated / scatter < 1.25
    assert np.mean([sampling_std(each[None]) for each in drawn[:40]]) < 0.75 * scatter


def test_sampling_std_counts_frames_once_and_needs_errors() -> None:
    errors = np.random.default_rng(2).standard_normal((1, 60, 60))
    one = sampling_std(errors)
    assert one == pytest.approx(math.sqrt(0.5 / 3600), rel=0.05)
    assert sampling_std(np.concatenate([errors, errors])) == pytest.approx(one, rel=1e-9)
    assert math.isnan(sampling_std(np.full((1, 60, 60), np.nan)))
    assert math.isnan(sampling_std(np.ones((1, 60, 60))))


def test_differences_between_capture_and_twin_are_named() -> None:
    row = RegionError("interior", "depth", "mm", 900, 0.9, 0.03, 0.0, 0.04, 0.05, 0.03, 0.03, 0.9)
    same, other = Comparison("residual", "DN", 1.1, 1.0), Comparison("noise", "DN", 2.0, 1.0)
    undefined = Comparison("closure", "mm", math.nan, 1.0)
    found = TwinPrediction((row,), (same, other, undefined), ("a note",))
    assert [problem.path for problem in found.disagreements] == ["noise"]
    assert undefined.agrees is None
    assert math.isnan(Comparison("x", "", 1.0, 0.0).ratio)
    assert "no pixel of the twin" in TwinPrediction(()).summary()
    text = found.summary()
    assert "noise: 2.00 and 1.00 DN; ratio 2.00" in text
    assert "residual: 1.10 and 1.00 DN\n" in text
    assert text.endswith("note: a note")
