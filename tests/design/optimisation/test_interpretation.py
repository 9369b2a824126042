"""What is told of a rig: what limits it, rules of thumb, what was taken for granted."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.design.optimisation import (
    DesignSpace,
    DesignSpec,
    Evaluation,
    Parameter,
    RigContext,
    RuleOfThumb,
    Sensitivity,
    check_rules_of_thumb,
    describe_limiting_factors,
    evaluate_bound,
    list_assumptions,
)
from scenetruth.design.prediction import predict
from scenetruth.scene import Scene
from tests.helpers.nightly import nightly
from tests.helpers.small_specification import objective, scene, spec


@pytest.fixture(scope="module")
def facts() -> RigContext:
    made = Scene.from_dict(scene())
    return RigContext(made, predict(made), "all")


def rules(facts: RigContext, **causes: Any) -> dict[str, RuleOfThumb]:
    changed = {"all": replace(facts.causes, **causes)}
    told = check_rules_of_thumb(replace(facts, prediction=replace(facts.prediction, by_region=changed)))
    return {one.title: one for one in told}


@pytest.mark.parametrize(
    ("title", "cause", "good", "bad"),
    [
        ("speckle size", "wavelength_px", 8.0, 4.0),
        ("motion blur", "blur_px", 0.05, 0.2),
        ("saturation", "grey_level", 0.2, 0.99),
        ("speckles per window", "wavelength_px", 12.0, 60.0),
    ],
)
def test_rules_are_kept_or_not(facts: RigContext, title: str, cause: str, good: float, bad: float) -> None:
    assert rules(facts, **{cause: good})[title].holds
    assert not rules(facts, **{cause: bad})[title].holds


def test_rules_of_geometry_have_sources(facts: RigContext) -> None:
    told = rules(facts)
    # 8 mm at 500 mm are 0.9°; 8 px of 64 are seen from one side only.
    assert (told["stereo angle"].here, told["stereo angle"].holds) == ("0.9° between the outermost positions", False)
    assert told["overlap of the outermost views"].here == "88 %"
    assert all(one.source and one.says for one in told.values())


def test_what_limits_is_told() -> None:
    space = DesignSpace((Parameter("stage.baseline_mm", 1.0, 40.0), Parameter("stage.positions", 2, 9, whole=True)))
    used = evaluate_bound("stage_travel", "stage travel", 98.6, "at most", 100.0, "mm")
    free = evaluate_bound("images", "images", 10.0, "at most", 100.0, "images")
    parts = {"depth": {"noise": 0.03, "stage": 0.04}}
    one = Evaluation({"stage.baseline_mm": 12.4, "stage.positions": 9}, {"depth": 0.05}, parts, (used, free))
    assert describe_limiting_factors(one, space, (objective(),)) == (
        "depth is limited by stage errors (64 % of the predicted variance); "
        "active constraints: stage travel (99 of 100 mm); "
        "at the end of its range: nine stage positions"
    )


@pytest.mark.parametrize(
    ("value", "limit", "words"),
    [
        (0.9341, 0.95, "0.93 of 0.95"),
        (2.963, 3.0, "2.96 of 3"),
        (0.2984, 0.3, "0.298 of 0.3"),
        (35.41, 36.0, "35 of 36"),
        (81.0, 81.0, "81 of 81"),
        (7158.4, 7200.0, "7158 of 7200"),
        (0.0, 0.0, "0 of 0"),
    ],
)
def test_used_limits_have_the_digits_of_the_margin_that_counts(value: float, limit: float, words: str) -> None:
    used = evaluate_bound("grey_level", "grey level", value, "at most", limit, "1")
    one = Evaluation({}, {"depth": 0.05}, {"depth": {"noise": 0.05}}, (used,))
    assert f"active constraints: grey level ({words})" in describe_limiting_factors(
        one, DesignSpace(()), (objective(),)
    )


def test_assumptions_name_what_was_taken_for_granted(facts: RigContext) -> None:
    given = spec(variables={"frames.frame_interval_s": [60, 120]}, light={"illuminance_lux": 500})
    idle = Sensitivity("frames.frame_interval_s", "depth", 0.0, 0.0, 0.0, 0.0, 0.0)
    listed = list_assumptions(
        DesignSpec.from_dict(given), facts, ("less of it",), (0.25, 0.0), (idle,), confirmed=False
    )
    told = "\n".join(listed)
    for expected in (
        "predictions are standard deviations due to noise",
        "the illuminance is 500 lux",
        "the light is constant. Flicker of all lamps together costs nothing with refined",
        "motions specified per frame",
        "in the simulations: less of it",
        "sensitivity by Morris excludes 25 %",
        "no effect on any objective: frame interval;",
        "a better rig than the recommended may exist: the search, of 40 predictions, has ended",
    ):
        assert expected in told
    listed = list_assumptions(DesignSpec.from_dict(given), facts, (), (0.0, 0.0), (), confirmed=True)
    assert "none of these searches has ended at a better predicted rig" in listed[0]
    lit = Scene.from_dict({**facts.scene.to_dict(), "lighting": {"flicker": {"amplitude": 0.02, "period_frames": 3.3}}})
    changing = list_assumptions(
        DesignSpec.from_dict(given), replace(facts, scene=lit), (), (0.0, 0.0), (), confirmed=True
    )
    assert "the light has a flicker of ± 2 %, which the simulations include and predictions do not" in changing
    # Half of the mean wavelength, as for the rule of speckles, and by the scale of the images in mm.
    (texture,) = [line for line in listed if line.startswith("the texture")]
    size_px, size_mm = map(float, re.findall(r"([\d.]+) (?:px|mm)", texture)[:2])
    assert rules(facts)["speckle size"].here.startswith(f"{size_px:.1f} px")
    # Both are rounded to two digits, by up to 5 %.
    assert size_mm / size_px == pytest.approx(facts.depth_mm / facts.scene.camera.focal_px, rel=0.1)
    # They are part of the predictions of a search.
    assert "stage errors are not included" not in listed


@nightly
@pytest.mark.parametrize("seed", [1, 2])
def test_flicker_costs_what_the_assumption_states(seed: int) -> None:
    plain = {
        "camera": {"width": 160, "height": 120, "focal_length_px": 1000.0},
        "stage": {"positions": 5, "baseline_mm": 5.0},
        "frames": {"count": 5},
        "render": {"backend": "raycast"},
        "objects": [
            {
                "name": "sheet",
                "mesh": {"kind": "plane", "size_mm": [300, 240], "resolution_mm": 12.0},
                "pose": {"position_mm": [0, 0, 600], "rotations": [{"axis": [0, 1, 0], "angle_deg": 15}]},
                "texture": {"kind": "noise", "wavelength_mm": [2.4, 12], "rms_contrast": 0.2},
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.2, 0.1, -0.3]}],
            }
        ],
        "sensor": {"bit_depth": 8, "noise_std": 0.005},
        "seed": seed,
    }

    def rmse(method: str, amplitude: float) -> dict[str, float]:
        light = {"lighting": {"flicker": {"amplitude": amplitude, "period_frames": 3.3}}} if amplitude else {}
        recording, truth = st.simulate(Scene.from_dict(plain | light))
        found = st.score(st.estimate(recording, method), truth, settings={"interior_margin_px": 12})
        interior = found.regions["interior"]
        return {name: float(interior[name]["rmse"] or 0) for name in ("depth", "velocity_x", "velocity_z")}

    still = rmse("refined", 0.0)
    for amplitude in (0.01, 0.05):
        changed = rmse("refined", amplitude)
        assert np.array([changed[name] / still[name] for name in still]) == pytest.approx(1.0, abs=0.1)
    before, after = rmse("structure_tensor", 0.0), rmse("structure_tensor", 0.01)
    assert min(after[name] / before[name] for name in ("velocity_x", "velocity_z")) > 2.9
