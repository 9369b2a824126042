"""Warnings from predicted numbers: what they tell holds."""

from __future__ import annotations

import re
from typing import Any

from scenetruth.design.prediction import predict, recommend
from scenetruth.scene import Scene
from tests.design.predict.scenes import wall

GROWING: dict[str, Any] = {
    "mesh": {"kind": "plane", "size_mm": [170, 140], "resolution_mm": 10},
    "deformation": [{"kind": "growth", "rate_per_hour": 0.03}],
    "motion": [],
}


def warnings_of(plain: dict[str, Any], **settings: Any) -> list[str]:
    scene = Scene.from_dict(plain)
    return recommend(scene, predict(scene, **settings))


def test_nothing_is_said_where_all_is_well() -> None:
    assert warnings_of(wall(sensor={"noise_std": 0.002})) == []


def test_slow_growth_asks_for_a_longer_interval_that_suffices() -> None:
    frames = {"count": 5, "frame_interval_s": 10.0}
    (told,) = (line for line in warnings_of(wall(**GROWING, frames=frames)) if line.startswith("growth"))
    assert re.match(r"growth of 'wall' is .* % per frame at a precision of .* % per pixel: raise frames\.frame_", told)
    longer = {"count": 5, "frame_interval_s": float(told.split()[-1])}
    ratio = predict(wall(**GROWING, frames=longer)).precision("growth_rate", "object_wall").signal_to_noise
    assert ratio is not None
    # What is asked for, and not many times more.
    assert 1.8 < ratio < 2.6


def test_motion_that_is_given_per_frame_does_not_ask_for_a_longer_interval() -> None:
    slow = wall(motion=[{"kind": "velocity", "velocity_mm_per_frame": [0, 0, 0.03]}])
    (told,) = warnings_of(slow)
    assert told.startswith("motion of 'wall' is 0.03 mm/frame at a precision of")
    assert "frame_interval_s" not in told


def test_a_short_baseline_is_to_be_as_long_as_one_per_cent_of_depth_takes() -> None:
    stage = {"positions": 5, "baseline_mm": 0.01}
    (told,) = (line for line in warnings_of(wall(stage=stage)) if line.startswith("depth has"))
    longer = {"positions": 5, "baseline_mm": float(told.split()[-1])}
    depth = predict(wall(stage=longer)).precision("depth", "all").std
    assert 0.8 * 6 < depth < 1.05 * 6


def test_long_waves_and_long_exposures_are_told() -> None:
    texture = {"kind": "noise", "wavelength_mm": [30.0, 60.0]}
    assert any("the standard deviation of the window is 6 px" in line for line in warnings_of(wall(texture=texture)))
    motion = [{"kind": "velocity", "velocity_mm_per_frame": [6.0, 0, 0]}]
    lines = warnings_of(wall(motion=motion, shutter={"exposure_time_s": 0.9}))
    (told,) = (line for line in lines if "during the exposure" in line)
    shorter = wall(motion=motion, shutter={"exposure_time_s": float(told.split()[-1])})
    assert not any("during the exposure" in line for line in warnings_of(shorter))
    # What rests around it hides it from no one.
    small, ground = wall(motion=motion, mesh={"kind": "plane", "size_mm": [12, 12]}), wall(motion=[])
    ground["objects"][0] |= {"name": "ground", "pose": {"position_mm": [0, 0, 620]}}
    both = wall(objects=[small["objects"][0], ground["objects"][0]], shutter={"exposure_time_s": 0.9})
    assert any(line.startswith("points of 'wall' move 10.8 px during") for line in warnings_of(both))
    assert any("depth is valid in 0 %" in line for line in warnings_of(wall(texture={"kind": "uniform"})))
