"""What the stage adds, against draws: lines fitted to shifts of images."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from scenetruth.design.optimisation import compute_stage_shifts_px, compute_stage_uncertainty
from scenetruth.design.prediction import PredictionInputs, predict
from scenetruth.scene import Scene
from tests.helpers.small_specification import scene

FOCAL, DEPTH, BASELINE = 500.0, 500.0, 4.0
DRAWS = 20_000


def with_errors(positions: int = 5, frames: int = 5, **errors: float) -> Scene:
    plain = scene()
    plain["stage"] = {"positions": positions, "baseline_mm": BASELINE, "errors": errors}
    plain["frames"] = {"count": frames}
    return Scene.from_dict(plain)


def causes_of(made: Scene) -> PredictionInputs:
    return replace(predict(made).causes, depth_mm=DEPTH, disparity_px=FOCAL * BASELINE / DEPTH)


@pytest.mark.parametrize(("guide_urad", "visit_um"), [(100.0, 0.0), (0.0, 3.0), (40.0, 10.0)])
def test_shifts_become_errors_as_fits_of_draws_do(guide_urad: float, visit_um: float) -> None:
    made = with_errors(yaw_urad=guide_urad, repeatability_um=visit_um)
    told = compute_stage_uncertainty(made, causes_of(made), {})["stage"]
    generator = np.random.default_rng(1)
    guide = FOCAL * guide_urad * 1e-6 * generator.standard_normal((DRAWS, 5, 1))
    visit = FOCAL / DEPTH * visit_um * 1e-3 * generator.standard_normal((DRAWS, 5, 5))
    shifts = guide + visit
    s, t = np.arange(5) - 2.0, np.arange(5) - 2.0
    # d s + u t + w s t + c, fitted to all images at once.
    terms = np.stack([np.add.outer(s, 0 * t), np.add.outer(0 * s, t), np.outer(s, t), np.ones((5, 5))], axis=-1)
    fitted = shifts.reshape(DRAWS, 25) @ np.linalg.pinv(terms.reshape(25, 4)).T
    d, u, w, _ = fitted.std(axis=0)
    disparity = FOCAL * BASELINE / DEPTH
    # A standard deviation of so many draws is known to 1 / √(2 n) = 0.5 %, and 4 of them are allowed.
    close = pytest.approx
    assert told["disparity"] == close(d, rel=0.02)
    assert told["depth"] == close(DEPTH * d / disparity, rel=0.02)
    if visit_um:
        assert told["flow_x"] == close(u, rel=0.02)
        assert told["velocity_x"] == close(DEPTH * u / FOCAL, rel=0.02)
        # d grows by d U_Z / Z per frame as a point comes nearer.
        assert told["velocity_z"] == close(DEPTH * w / disparity, rel=0.02)
        assert told["growth_rate"] == close(2 * w / disparity, rel=0.02)
    else:
        assert "flow_x" not in told


def test_known_worths() -> None:
    """At 5016 px and 660 mm, 1 µm is 0.0076 px and 100 µrad are 0.5 px (the project's table of precision)."""
    plain = scene()
    plain["camera"]["focal_length_px"] = 5016
    plain["stage"]["errors"] = {"repeatability_um": 1.0, "yaw_urad": 100.0}
    found = compute_stage_shifts_px(Scene.from_dict(plain), 660.0)
    assert found.visit == pytest.approx(0.0076, rel=1e-9)
    assert found.guide == pytest.approx(0.5016, rel=1e-9)


def test_what_moves_during_a_scan_is_taken_for_disparity() -> None:
    plain = scene()
    plain["stage"]["time_per_position_s"] = 0.1
    made = Scene.from_dict(plain)
    told = compute_stage_uncertainty(made, causes_of(made), {"flow_x": 0.3, "velocity_z": 0.0})["scan"]
    assert told == {
        "disparity": pytest.approx(0.03),
        "depth": pytest.approx(0.03 * DEPTH / (FOCAL * BASELINE / DEPTH)),
    }


def test_a_perfect_stage_adds_nothing() -> None:
    made = Scene.from_dict(scene())
    assert compute_stage_uncertainty(made, causes_of(made), {"flow_x": 1.0}) == {}
    assert not any(vars(compute_stage_shifts_px(made, DEPTH)).values())
    assert math.isfinite(compute_stage_shifts_px(with_errors(roll_urad=10.0), DEPTH).along)
