"""The points of a sweep, and every problem of what varies at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as some

from scenetruth.design.sweeps import build_plan, sweep
from scenetruth.errors import ArgumentError, EstimateError, SceneError
from scenetruth.estimators import choose
from scenetruth.scene import Scene
from tests.helpers.sweep_scenes import scene


def refused(vary: dict[str, Any], given: Any = None, **options: Any) -> list[str]:
    with pytest.raises(ArgumentError) as error:
        build_plan(scene() if given is None else given, vary, **options)
    return list(map(str, error.value.problems))


def test_all_combinations_are_points_and_each_has_every_seed() -> None:
    plan = build_plan(scene(), {"stage.baseline_mm": [1, 2], "frames.count": "3..7:3"}, seeds=2)
    assert [point.values for point in plan.points] == [(1, 3), (1, 5), (1, 7), (2, 3), (2, 5), (2, 7)]
    assert (len(plan), plan.each, plan.seeds) == (12, 2, ((5, 6),))
    made = plan.scene(3)
    assert (made.stage.baseline_mm, made.frames.count, made.seed) == (1.0, 5, 6)
    # All else stays as it was.
    assert plan.scene(6) == Scene.from_dict(scene(frames={"count": 3}, seed=5))
    assert build_plan(scene(), {"stage.baseline_mm": [1, 2]}, seeds=[9, 4]).seeds == ((9, 4),)


def test_points_fill_ranges_evenly_and_more_of_them_leave_the_first() -> None:
    vary = {"stage.baseline_mm": "1..5", "sensor.noise_std": "0.001..0.1:log", "stage.positions": "3..9"}
    few = [point.values for point in build_plan(scene(), vary, seeds=1, sobol=16).points]
    many = [point.values for point in build_plan(scene(), vary, seeds=1, sobol=64).points]
    assert many[:16] == few
    baselines, noises, positions = (np.array(each) for each in zip(*many, strict=True))
    # Of 64 points of Sobol's sequence, 16 lie in each quarter.
    assert np.histogram(baselines, 4, (1, 5))[0].tolist() == [16] * 4
    assert np.histogram(np.log10(noises), 4, (-3, -1))[0].tolist() == [16] * 4
    assert set(positions.tolist()) == set(range(3, 10))
    grid = build_plan(scene(), {**vary, "frames.count": [3, 5]}, seeds=1, sobol=16)
    assert len(grid.points) == 32
    assert not grid.is_grid


def test_each_method_has_its_own_settings_and_those_that_vary() -> None:
    given = scene(estimate={"tau": 0.5})
    plan = build_plan(given, {"estimate.window_sigma_px": [2, 3], "estimate.method": ["refined", "structure_tensor"]})
    found = [plan.scene(number).estimate for number in range(0, len(plan), plan.each)]
    assert found == [
        choose({"method": method, "window_sigma_px": window, **({"tau": 0.5} if method == "structure_tensor" else {})})
        for window in (2, 3)
        for method in ("refined", "structure_tensor")
    ]


def test_wildcards_set_every_one() -> None:
    walls = [scene()["objects"][0] | {"name": name} for name in ("a", "b")]
    plan = build_plan(scene(objects=walls), {"objects.*.texture.rms_contrast": [0.1, 0.2]}, seeds=1)
    assert [item.texture.model_dump()["rms_contrast"] for item in plan.scene(1).objects] == [0.2, 0.2]


def test_everything_that_is_wrong_is_told_at_once() -> None:
    told = refused(
        {
            "stage.baselin_mm": [1, 2],
            "camera.lens.blur": [1, 2],
            "stage.positions": "1..10",
            "sensor": ["ideal", {"kind": "gaussian"}],
            "sensor.noise_std": [0.1, 0.2],
            "seed": [1, 2],
        },
        seeds=0,
    )
    assert [line.partition(":")[0] for line in told] == [
        "seeds",
        "vary.stage.positions",
        "vary.camera.lens.blur",
        "vary.sensor.noise_std",
        "vary.seed",
        "vary.stage.baselin_mm",
    ]
    assert "overlaps with 'sensor'" in told[3]
    assert "specify the seeds" in told[4]
    assert "did you mean 'baseline_mm'" in told[5]


def test_near_names_and_wrong_types_are_told() -> None:
    told = refused(
        {"stage.baselin_mm": [1, 2], "stage.positions": [3, "many"], "objects.0.mesh.kind": ["plane", "planet"]}
    )
    assert any("vary.stage.baselin_mm: unknown key; did you mean 'baseline_mm'?" in line for line in told)
    assert any(line.startswith("vary.stage.positions: ") and "'many'" in line for line in told)
    assert any("'planet' is not one of" in line for line in told)
    assert "did you mean 'stage.baseline_mm'" in refused({"stage.baseline_m.x": [1, 2]})[0]
    assert "as with --set" in refused({"sensor.noise_std": [0, 1]}, scene(sensor="ideal"))[0]


def test_values_that_do_not_go_together_are_told_with_the_point() -> None:
    told = refused({"stage.time_per_position_s": [0, 1], "frames.frame_interval_s": [1, 10]})
    assert len(told) == 1
    assert "time_per_position_s = 1, frames.frame_interval_s = 1" in told[0]


def test_what_varies_nothing_is_told() -> None:
    assert "has no effect" in refused({"description": ["a", "b"]})[0]
    assert "has no effect" in refused({"storage.form": ["folder", "zip"]})[0]
    # Numbers that mean the same to the scene.
    assert "has no effect" in refused({"sensor.noise_std": [0.01, "0.01"]})[0]
    own = {"estimate.window_sigma_px": [4, 5]}
    assert len(build_plan(scene(), own, seeds=1)) == 2
    assert "with given methods" in refused(own, own_methods=False)[0]
    assert "at least two integers" in refused({"stage.positions": "3.1..3.9:4"})[0]
    assert "more than 100,000" in refused({"stage.baseline_mm": "1..2:10000"}, seeds=20)[0]


def test_scenes_are_called_by_their_files(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(scene(description=name)))
    files = [tmp_path / "one.yaml", tmp_path / "two.yaml"]
    plan = build_plan(files, {"stage.baseline_mm": [1, 2]}, seeds=1, overrides=["camera.width=80"])
    assert plan.labels == ("one", "two")
    assert plan.scene(2).description == "two"
    assert plan.scene(2).camera.width == 80
    assert build_plan(Scene.from_dict(scene()), {"stage.baseline_mm": [1, 2]}).labels == ("scene",)
    (tmp_path / "two.yaml").write_text("camera: 3")
    with pytest.raises(SceneError, match=r"two\.yaml"):
        build_plan(files, {"stage.baseline_mm": [1, 2]})
    with pytest.raises(ArgumentError, match="at least one scene"):
        build_plan([], {"stage.baseline_mm": [1, 2]})


PLANTED: dict[str, tuple[dict[str, Any], str]] = {
    "scene": ({"camera.width": -1}, "camera.width"),
    "field": ({"vary": {"stage.baselin.mm": [1, 2]}}, "vary.stage.baselin.mm"),
    "level": ({"vary": {"frames.count": [2, -3]}}, "vary.frames.count"),
    "type": ({"vary": {"stage.positions": [3, "many"]}}, "vary.stage.positions"),
    "spelling": ({"vary": {"sensor.noise_std": "0.1..x"}}, "vary.sensor.noise_std"),
    "empty range": ({"vary": {"objects.0.texture.rms_contrast": "0.2..0.1:3"}}, "vary.objects.0.texture.rms_contrast"),
    "seeds": ({"seeds": 0}, "seeds"),
    "points": ({"sobol_points": -1}, "sobol_points"),
    "method": ({"methods": ["refind"]}, "method"),
    "workers": ({"workers": 0}, "workers"),
}


@settings(max_examples=20, deadline=None)
@given(some.lists(some.sampled_from(sorted(PLANTED)), min_size=1, unique=True))
def test_mistakes_do_not_hide_each_other(names: list[str]) -> None:
    """Of scenes, factors and arguments."""
    arguments: dict[str, Any] = {"vary": {"stage.baseline_mm": [1, 2]}, "seeds": 1}
    overrides: dict[str, Any] = {}
    for name in names:
        changes = PLANTED[name][0]
        if name == "scene":
            overrides |= changes
        else:
            arguments |= {"vary": arguments["vary"] | changes["vary"]} if "vary" in changes else changes
    with pytest.raises((ArgumentError, SceneError, EstimateError)) as caught:
        sweep(scene(), overrides=overrides, **arguments)
    found = [problem.path for problem in caught.value.problems]
    assert [name for name in names if not any(path.startswith(PLANTED[name][1]) for path in found)] == []
    assert [path for path in found if not any(path.startswith(PLANTED[name][1]) for name in names)] == []
