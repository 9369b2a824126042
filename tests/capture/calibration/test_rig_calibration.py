"""Calibration from images and points: full chain on rendered boards, fiducial strip, and input that is refused."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from scenetruth.camera import Camera, Distortion, StageErrors, Viewpoint
from scenetruth.capture.calibration import (
    BoardImage,
    CalibrationError,
    CalibrationTarget,
    CharucoBoard,
    DotGrid,
    Observations,
    RigCalibration,
    RigFit,
    RigGeometry,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    adjust,
    calibrate,
    observe_boards,
    project,
    rotation_matrix,
    triangulate,
)
from tests.helpers.drawn_rigs import DrawnRig, draw_rig
from tests.helpers.nightly import NIGHTLY, by_night, nightly
from tests.helpers.rendered_boards import noisy, render_board, rendered_noise_variance

Array = NDArray[np.float64]
X_MM = np.array([-10.0, 0.0, 10.0])
CAMERA = Camera(
    width=400, height=320, focal_length_px=3000, principal_point_px=(203.0, 156.0), distortion=Distortion(k1=-0.3, k2=2)
)
CHARUCO = CharucoBoard(kind="charuco", squares=(10, 8), square_mm=7.0, marker_mm=5.25, scale_std=1e-4)
DOTS = DotGrid(kind="dots", dots=(8, 6), spacing_mm=7.0, diameter_mm=3.5, scale_std=1e-4)
TILTS = [(0.6, 0.15), (-0.55, 0.2), (0.1, 0.62), (0.15, -0.6), (0.45, -0.45)]


def captured(board: CharucoBoard | DotGrid, seed: int) -> list[BoardImage]:
    """Images of a board in five poses from three exact positions."""
    images = []
    for pose, tilt in enumerate(TILTS):
        rotation = rotation_matrix(np.array([*tilt, 0.06 * pose - 0.15]))
        for s, x in enumerate(X_MM):
            place = Viewpoint.on_axis(float(x)).to_camera(np.array([0.5 * pose, -0.4 * pose, 655 + 5.0 * pose]))
            clean = render_board(board, CAMERA, rotation, place)
            name = f"p{pose}_s{s}"
            noise = rendered_noise_variance(clean)
            images.append(BoardImage(noisy(clean, seed + 3 * pose + s), s, pose, name=name, variance=noise))
    return images


EXACT_STAGE = RigPriors(errors=StageErrors(preset="air_bearing"), position_um=0.1)


@nightly
@pytest.mark.parametrize("board", [CHARUCO, *by_night(DOTS)], ids=lambda board: board.kind)
def test_full_chain_from_images(board: CharucoBoard | DotGrid) -> None:
    """Errors of the camera and of the depth within 4 standard deviations of a stated uncertainty that is small."""
    pytest.importorskip("cv2")
    found = calibrate(captured(board, 40), board, positions_mm=X_MM, priors=EXACT_STAGE)
    assert not [text for text in found.warnings if "residual" in text or "contradicts" in text], found.warnings
    assert found.variance_factor < 1.3
    assert found.std("f") < 3
    assert abs(found.value("f") - 3000) < 4 * found.std("f")
    for name, value in (("c_x", 203.0), ("c_y", 156.0), ("k1", -0.3)):
        assert abs(found.value(name) - value) < 4 * found.std(name), name
    # Depth at the centre: exact pixels of a point at 660 mm, triangulated by the calibrated rig.
    point = np.array([[0.0, 0.0, 660.0]])
    seen = np.stack([CAMERA.project(Viewpoint.on_axis(float(x)).to_camera(point)) for x in X_MM])
    rig = RigGeometry.from_values(found.values, found.layout, X_MM, found.reference)
    error = float(triangulate(rig, seen, np.array([660.0]))[0, 2] - 660)
    stated = found.point_errors(seen[1], 660.0, visit_std=np.zeros(6))[2].std[0]
    assert stated < 0.2
    assert abs(error) < 4 * stated


LOOSE = RigPriors(
    errors=StageErrors(preset="screw_stage", backlash_um=0.0),
    visit_errors=StageErrors(pitch_urad=1000, yaw_urad=1000, roll_urad=1000, straightness_um=50),
)
FRESH = RigPriors(
    errors=StageErrors(preset="screw_stage", backlash_um=0.0), visit_errors=StageErrors(pitch_urad=20, yaw_urad=20)
)
STRIP = CalibrationTarget(name="strip", half_width_mm=45.0, scale_std=1e-4, warp_mm=0.0)


def strip_points() -> np.ndarray:
    """Two rows of 17 points near the upper and lower border of the image."""
    u, v = np.meshgrid(np.linspace(-36, 36, 17), [-27.0, 27.0])
    return np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])


def with_strip(rig: DrawnRig, seed: int) -> tuple[list[TargetView], list[int], np.ndarray]:
    """Views of a strip at five new visits, their numbers, and the true motions of the visits."""
    generator = np.random.default_rng([seed, 99])
    layout = rig.truth.layout
    first = max(layout.visits) + 1
    points, visits = strip_points(), list(range(first, first + 5))
    covariance = np.tile(1e-4 * np.eye(2), (len(points), 1, 1))
    views = [
        TargetView(f"strip {s}", s, visit, 1000, points, np.zeros((len(points), 2)), covariance, 1)
        for s, visit in enumerate(visits)
    ]
    given = replace(rig.observations, targets=(*rig.observations.targets, STRIP), views=tuple(views))
    whole = RigLayout.from_observations(given, FRESH)
    values = np.zeros(whole.size)
    values[: whole.first_visit] = rig.truth.values[: whole.first_visit]
    block = slice(whole.first_visit, whole.first_target)
    values[block] = whole.std[block] * generator.standard_normal(whole.std[block].size)
    values[whole.first_target + 4] = 1e-4 * generator.standard_normal()
    values[whole.first_pose + 5] = 660
    turn = rotation_matrix(np.array([0.03, -0.02, 0.01]))
    pixels = project(given, RigState(whole, values, turn[None]), derivatives=False)[0]
    pixels = pixels + 0.01 * generator.standard_normal(pixels.shape)
    parts = np.split(pixels, given.first[1:-1])
    motions = values[block].reshape(-1, 6)
    return [replace(view, pixels=part) for view, part in zip(views, parts, strict=True)], visits, motions


@nightly
def test_strip_replaces_the_tolerances_of_the_visits() -> None:
    """Drawn rigs with 20 µrad new at each visit: errors are stated right, and five times smaller than without."""
    z = []
    for seed in range(80, 88 if NIGHTLY else 83):
        rig = draw_rig(seed, poses=6, priors=FRESH)
        views, visits, motions = with_strip(rig, seed)
        found = calibrate(rig.observations, guess=5040.0, priors=FRESH, strip=STRIP, strip_views=views)
        exact = RigGeometry.from_values(
            rig.truth.values, rig.truth.layout, found.positions_mm, found.reference, motions
        )
        point = np.array([[0.0, 0.0, 660.0]])
        seen = exact.project(exact.to_stage(point))
        start = found.layout.first_visit + 6 * found.visits.index(visits[0])
        estimated = found.values[start : start + 30].reshape(5, 6)
        fitted = RigGeometry.from_values(found.values, found.layout, found.positions_mm, found.reference, estimated)
        error = float(triangulate(fitted, seen, np.array([660.0]))[0, 2] - 660)
        pixels = seen[found.reference]
        stated = float(found.point_errors(pixels, 660.0, visits=[visits])[2].std[0])
        without = float(found.point_errors(pixels, 660.0)[2].std[0])
        assert stated < 0.15
        assert without > 0.4
        z.append(error / stated)
    # Chi-squared of the values: with a probability of 0.998.
    low, high = stats.chi2.ppf([0.001, 0.999], len(z))
    assert low < np.square(z).sum() < high


@pytest.mark.parametrize("seed", [3, *by_night(8)])
def test_yaw_of_single_visits_is_not_taken_for_a_wrong_step(seed: int) -> None:
    """Yaw of 1 mrad, new at every visit, shows steps of the board that are 3 % too short or too long."""
    rig = draw_rig(seed, poses=8, priors=LOOSE)
    found = calibrate(rig.observations, guess=5040.0, priors=LOOSE)
    assert abs(found.value("step_scale") - rig.truth.value("step_scale")) < 4 * found.std("step_scale")
    assert abs(found.value("f") - 5016) < 4 * found.std("f") < 5


@nightly
def test_contradicting_images_are_rejected_with_their_reason() -> None:
    rig = draw_rig(90, poses=5, positions=3)
    backwards = replace(rig.observations, positions_mm=-rig.observations.positions_mm)
    with pytest.raises(CalibrationError) as caught:
        calibrate(backwards, guess=5016.0, priors=rig.priors)
    assert "against the stated direction" in str(caught.value)
    # Waves of 250 px, which no lens model has.
    views = [
        replace(view, pixels=view.pixels + 0.2 * np.sin(view.pixels[:, ::-1] / 40)) for view in rig.observations.views
    ]
    with pytest.raises(CalibrationError, match="contradict each other"):
        calibrate(rig.observations.selected(views), guess=5016.0, priors=rig.priors)


def test_too_little_tilt_says_what_to_add() -> None:
    rig = draw_rig(91, poses=3, positions=3, tilt_deg=(0.0, 0.5))
    with pytest.raises(CalibrationError, match="add poses with a tilt"):
        calibrate(rig.observations, guess=5016.0, priors=rig.priors)


@nightly
def test_a_fit_that_does_not_converge_starts_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong tilt can lead into a valley without an end, far from the start values of the lens."""
    rig = draw_rig(93, poses=5, positions=3)
    starts = list[RigState]()

    def first_without_end(given: Observations, state: RigState, *start: Array, must_converge: bool = True) -> RigFit:
        starts.append(state)
        fit = adjust(given, state, *start, must_converge=must_converge)
        return replace(fit, rounds=10_000) if len(starts) <= endless else fit

    monkeypatch.setattr(sys.modules[calibrate.__module__], "adjust", first_without_end)
    endless = 1
    found = calibrate(rig.observations, guess=5016.0, priors=rig.priors)
    assert abs(found.value("f") - rig.truth.value("f")) < 5 * found.std("f")
    np.testing.assert_array_equal(starts[1].values, starts[0].values)
    endless, starts[:] = 2, []
    with pytest.raises(CalibrationError, match="no solution"):
        calibrate(rig.observations, guess=5016.0, priors=rig.priors)


@nightly
def test_understated_noise_scales_the_covariance() -> None:
    rig = draw_rig(92, poses=5, positions=3)
    views = [replace(view, covariance_px2=view.covariance_px2 / 1.5) for view in rig.observations.views]
    plain = calibrate(rig.observations, guess=5016.0, priors=rig.priors)
    found = calibrate(rig.observations.selected(views), guess=5016.0, priors=rig.priors)
    assert 1.4 < found.variance_factor < 1.6
    assert any("scaled" in text for text in found.warnings)
    np.testing.assert_allclose(found.std("f"), plain.std("f"), rtol=0.1)


def test_images_need_a_board_and_positions() -> None:
    with pytest.raises(CalibrationError) as caught:
        calibrate([])
    assert [problem.path for problem in caught.value.problems] == ["board", "positions_mm"]


def test_images_without_a_board_are_named() -> None:
    pytest.importorskip("cv2")
    generator = np.random.default_rng(0)
    empty = [BoardImage(generator.normal(100, 1, (240, 320)), 0, n, name=f"empty_{n}.png") for n in range(2)]
    with pytest.raises(CalibrationError) as caught:
        observe_boards(empty, CHARUCO, X_MM)
    assert {problem.path for problem in caught.value.problems} == {"empty_0.png", "empty_1.png"}
    sizes = [BoardImage(np.zeros((240, 320)), 0, 0, name="a"), BoardImage(np.zeros((240, 300)), 0, 1, name="b")]
    with pytest.raises(CalibrationError, match="first image"):
        observe_boards(sizes, CHARUCO, X_MM)


def test_a_camera_or_calibration_is_a_start() -> None:
    rig = draw_rig(93, poses=4, positions=3)
    start = RigCalibration.from_camera(Camera(width=640, height=480, focal_length_px=5060), [0])
    one = calibrate(rig.observations, guess=start, priors=rig.priors)
    other = calibrate(rig.observations, guess=start.camera, priors=rig.priors)
    np.testing.assert_allclose(one.values, other.values)


def test_two_boards_in_one_image_are_seen() -> None:
    pytest.importorskip("cv2")
    rotation, camera = rotation_matrix(np.array([0.2, 0.1, 0.0])), CAMERA.model_copy(update={"distortion": None})
    left = render_board(CHARUCO, camera, rotation, np.array([-38.0, 0.0, 655.0]), fine=8)
    right = render_board(CHARUCO, camera, rotation, np.array([38.0, 0.0, 655.0]), fine=8)
    image = np.concatenate([left[:, :200], right[:, 200:]], axis=1)
    given = [BoardImage(image, 0, 0, name="both.png")]
    with pytest.raises(CalibrationError, match=r"both\.png"):
        observe_boards(given, CHARUCO, X_MM)


def test_mistakes_of_single_images_are_named() -> None:
    """Two images with exchanged names contradict the others."""
    rig = draw_rig(94, poses=5, positions=3)
    views = list(rig.observations.views)
    one, other = views[6], views[7]
    for number, (view, seen) in ((6, (one, other)), (7, (other, one))):
        views[number] = replace(view, pixels=seen.pixels, points_mm=seen.points_mm, covariance_px2=seen.covariance_px2)
    found = calibrate(rig.observations.selected(views), guess=5016.0, priors=rig.priors)
    assert {view.name for view in found.images if not view.consistent} == {one.name, other.name}
    assert all(any(text.startswith(name) for text in found.warnings) for name in (one.name, other.name))


@nightly
def test_blurred_images_are_named() -> None:
    """Their residuals are larger; by day `test_bundle_adjustment` names such an image."""
    rig = draw_rig(94, poses=5, positions=3)
    views = list(rig.observations.views)
    noise = 0.03 * np.random.default_rng(1).standard_normal(views[4].pixels.shape)
    views[4] = replace(views[4], pixels=views[4].pixels + noise)
    found = calibrate(rig.observations.selected(views), guess=5016.0, priors=rig.priors)
    assert any(text.startswith(views[4].name) for text in found.warnings)


def test_a_visit_has_one_position() -> None:
    rig = draw_rig(95, poses=2, positions=3)
    with pytest.raises(CalibrationError, match="number it anew"):
        rig.observations.selected([replace(view, visit=0) for view in rig.observations.views])
