"""Design specifications that are wrong: everything is told at once, before any work."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as some

from scenetruth.design.optimisation import DesignSpec, load_design_spec, load_problem, prepare_problem
from scenetruth.errors import DesignSpecError
from scenetruth.input_files import bundled_files
from scenetruth.scoring import QUANTITIES
from tests.helpers.nightly import nightly
from tests.helpers.small_specification import spec

DESIGNS = Path(__file__).parents[3] / "scenes" / "designs"


def refused(**changes: Any) -> str:
    with pytest.raises(DesignSpecError) as caught:
        prepare_problem(DesignSpec.from_dict(spec(**changes)))
    return str(caught.value)


def test_all_that_is_wrong_with_its_form_is_told() -> None:
    told = refused(
        variables={"stage.baseline_mm": {"from": 5, "to": 2}, "stage.positions": {"from": 3}, "lens": {}},
        constraints=[{"kind": "stage_travle", "max": 3}, {"max": 3}, {"kind": "images"}],
        objectives=[{"quantity": "depht"}],
        serach={},
    )
    for expected in (
        "8 problems with the design specification",
        "variables.stage.baseline_mm: is empty: from 5 is not below to 2",
        "variables.stage.positions: has no to",
        "variables.lens: must be a range",
        "constraints.0: unknown `kind`",
        "constraints.1: requires `kind`",
        "constraints.2: has no bound",
        "objectives.0.quantity: unknown quantity; did you mean 'depth'?",
        "serach: unknown key; did you mean 'search'?",
    ):
        assert expected in told


def test_a_shipped_scene_goes_by_its_name(tmp_path: Path) -> None:
    file = tmp_path / "spec.yaml"
    file.write_text(yaml.safe_dump({**spec(), "scene": "cube"}), encoding="utf-8")
    assert load_design_spec(file).scene == str(bundled_files(".")["cube"])


def test_a_shipped_goal_goes_by_its_name() -> None:
    assert load_design_spec("leaf_growth") == load_design_spec(bundled_files("designs")["leaf_growth"])


def test_constraints_that_contradict_each_other() -> None:
    limits = [
        {"kind": "images", "min": 20},
        {"kind": "stage_travel", "max": 3},
        {"kind": "images", "max": 9},
    ]
    told = refused(constraints=limits)
    assert "constraints.2: contradicts constraints.0: images must be at least 20 and at most 9 images" in told
    # Widths and heights are different things.
    limits = [
        {"kind": "field_of_view", "axis": "x", "min": 60},
        {"kind": "field_of_view", "axis": "y", "max": 50},
    ]
    DesignSpec.from_dict(spec(constraints=limits))


def test_parameters_that_do_not_exist_or_vary_nothing() -> None:
    told = refused(
        variables={
            "stage.baselin_mm.x": {"from": 1, "to": 2},
            "working_distance": {"from": 400, "to": 600},
            "optics.psf": {"values": [None]},
            "stage": ["air_baering"],
            "camera.width": {"from": 64.2, "to": 64.8},
            "f_number": {"from": 2, "to": 8},
        }
    )
    for expected in (
        "variables.stage.baselin_mm.x: there is no 'stage.baselin_mm'; did you mean 'stage.baseline_mm'?",
        "variables.working_distance: there is no 'working_distance'; did you mean 'working_distance_mm'?",
        "variables.optics.psf: must have at least two values",
        "variables.stage: unknown catalogue entry; did you mean 'air_bearing'?",
        "variables.camera.width: must contain at least two integers",
        "variables.f_number: requires a lens",
    ):
        assert expected in told


def test_values_that_no_scene_takes_or_no_figure_feels() -> None:
    told = refused(
        variables={
            "stage.baseline_mm": {"from": 1, "to": 9},
            "sensor.noise_std": {"from": -0.1, "to": 0.1},
            "storage.form": ["folder", "zip"],
        }
    )
    assert "variables.sensor.noise_std: input should be greater than or equal to 0 (got -0.1)" in told
    assert "variables.storage.form: has no effect on any statistic" in told


def test_parameters_that_others_decide() -> None:
    told = refused(
        variables={"camera": "all", "camera.width": {"from": 32, "to": 64}, "stage": {"values": ["air_bearing"]}}
    )
    assert "variables.camera.width: has no effect: it is determined by 'camera'" in told
    told = refused(
        variables={"objects.*.pose.position_mm.2": {"from": 4, "to": 9}, "objects.0.pose": {"values": [{}, None]}}
    )
    assert "variables.objects.0.pose: overlaps with 'objects.*.pose.position_mm.2'" in told
    told = refused(variables={"lens": "all"})
    assert "variables.lens: requires the pixel pitch" in told


def test_objectives_that_are_not_told() -> None:
    told = refused(
        objectives=[{"quantity": "depth", "region": "object_leaf"}, {"quantity": "growth_rate", "region": "interior"}]
    )
    assert "objectives.0.region: unknown region; valid regions: all, interior, object_wall" in told
    assert "objectives.1.quantity: is not available for this scene and method structure_tensor" in told


def test_statistics_that_are_not_told() -> None:
    assert "objectives.0.statistic: input should be 'scaled_median_abs_error', 'rmse' or 'p95_abs_error'" in refused(
        objectives=[{"quantity": "depth", "statistic": "std"}]
    )
    wanted = [{"quantity": "velocity_epe", "statistic": kind} for kind in ("p95_abs_error", "rmse")]
    told = refused(objectives=wanted)
    assert "objectives.0.statistic: is not available for velocity_epe, a distance or an angle" in told
    assert "objectives.1" not in told
    assert "must be unique: depth of all, rms" in refused(
        objectives=[{"quantity": "depth", "region": "all", "statistic": "rmse"}] * 2
    )


@pytest.mark.parametrize("quantity", ["mean_curvature", "growth_direction", "rotation_rate_x"])
def test_what_is_scored_but_not_predicted_is_refused_with_what_is(quantity: str) -> None:
    assert quantity in QUANTITIES
    told = refused(objectives=[{"quantity": quantity}])
    assert "is not available for this scene and method structure_tensor; available quantities: depth" in told


def test_scenes_and_methods_that_are_wrong() -> None:
    told = refused(scene={**spec()["scene"], "widht": 3}, catalogues=["none.yaml"])
    assert "scene.widht: unknown key" in told
    assert "catalogues: none.yaml" in told
    assert "method" in refused(method="refind")
    # Importing runs code.
    assert "method.method: is code" in refused(method="os:system")
    assert "method.method: is code" in refused(method={"method": "os:system"})
    assert "set.stage.a.b: there is no 'stage.a'" in refused(set={"stage.a.b": 3})
    assert "both set and variable: stage.positions" in refused(set={"stage.positions": 3})


def test_titles_tell_objectives_apart() -> None:
    wanted = [{"quantity": "depth"}, {"quantity": "depth", "region": "object_wall"}, {"quantity": "velocity_z"}]
    task = prepare_problem(DesignSpec.from_dict(spec(objectives=wanted))).task
    assert [one.title for one in task.objectives] == ["Depth, interior", "Depth of wall", "Velocity in Z, interior"]
    task = prepare_problem(DesignSpec.from_dict(spec())).task
    assert [one.title for one in task.objectives] == ["Depth"]
    wanted = [{"quantity": "depth"}, {"quantity": "depth", "statistic": "rmse"}, {"quantity": "velocity_z"}]
    task = prepare_problem(DesignSpec.from_dict(spec(objectives=wanted))).task
    assert [one.title for one in task.objectives] == [
        "Depth, scaled median absolute error",
        "Depth, RMSE",
        "Velocity in Z",
    ]


@nightly
@pytest.mark.parametrize("file", sorted(DESIGNS.glob("*.yaml")), ids=lambda file: file.stem)
def test_goals_that_ship_can_be_followed(file: Path) -> None:
    prepared = prepare_problem(load_design_spec(file))
    assert len(prepared.space) >= 3


def test_paths_count_from_the_goals_folder(tmp_path: Path) -> None:
    (tmp_path / "wall.yaml").write_text(yaml.safe_dump(spec()["scene"]))
    file = tmp_path / "spec.yaml"
    file.write_text(yaml.safe_dump(spec(scene="wall.yaml")))
    assert prepare_problem(load_design_spec(file)).scene.objects[0].name == "wall"


PLANTED: dict[str, tuple[dict[str, Any], str]] = {
    "wrong type": ({"search.seed": "one"}, "search.seed"),
    "misspelt key": ({"titel": "A rig"}, "titel"),
    "out of range": ({"confirmation.rigs": -1}, "confirmation.rigs"),
    "missing catalogue": ({"catalogues": ["none.yaml"]}, "catalogues: none.yaml"),
    "scene with its own problems": ({"scene.camera.width": 0}, "scene.camera.width"),
    "unknown method": ({"method": "refind"}, "method."),
    "set field of no scene": ({"set.stagge.positions": 3}, "set.stagge.positions"),
    "empty range": ({"variables.frames.count": {"from": 5, "to": 2}}, "variables.frames.count"),
    "variable of no scene": ({"variables.objects.0.poze.axis": {"from": 5, "to": 7}}, "variables.objects.0.poze.axis"),
    "value out of range": ({"variables.sensor.noise_std": {"from": -0.1, "to": 0.1}}, "variables.sensor.noise_std"),
    "set and varied": ({"set.stage.baseline_mm": 3}, ""),
    "aperture without a lens": ({"variables.f_number": {"from": 2, "to": 8}}, "variables.f_number"),
    "unknown entry": ({"variables.stage": ["air_baering", "air_bearing"]}, "variables.stage"),
    "unknown constraint": ({"constraints.0": {"kind": "imagse", "max": 3}}, "constraints.0"),
    "contradiction": ({"constraints.1.max": 1}, "constraints.2"),
    "unknown quantity": ({"objectives.0.quantity": "depht"}, "objectives.0.quantity"),
    "unknown region": ({"objectives.1.region": "object_wal"}, "objectives.1.region"),
    "statistic without meaning": ({"objectives.2.statistic": "p95_abs_error"}, "objectives.2.statistic"),
}


def planted(names: Iterable[str]) -> dict[str, Any]:
    """Return a specification with mistakes."""
    plain = copy.deepcopy(spec(
        variables={"stage.baseline_mm": {"from": 1, "to": 9}},
        constraints=[{"kind": "stage_travel", "max": 99}, {"kind": "images", "max": 99}, {"kind": "images", "min": 2}],
        objectives=[{"quantity": "depth"}, {"quantity": "velocity_z"}, {"quantity": "velocity_epe"}],
        confirmation={}, search={}, set={},
    ))  # fmt: skip
    for name in names:
        for path, value in PLANTED[name][0].items():
            first, *rest = path.split(".")
            owner: Any = plain
            keys = [first, ".".join(rest)] if first in ("set", "variables") else [first, *rest]
            for key in keys[:-1]:
                owner = owner[int(key)] if isinstance(owner, list) else owner[key]
            owner[int(keys[-1]) if isinstance(owner, list) else keys[-1]] = value
    return plain


def paths_of(plain: dict[str, Any]) -> list[str]:
    try:
        load_problem(plain)
    except DesignSpecError as error:
        return [problem.path for problem in error.problems]
    return []


def is_of(name: str, path: str) -> bool:
    """Return whether a path is that of a mistake."""
    where = PLANTED[name][1]
    return path.startswith(where) if where else not path


@pytest.mark.parametrize("name", PLANTED)
def test_a_mistake_is_named_where_it_is(name: str) -> None:
    found = paths_of(planted([name]))
    assert found
    assert all(is_of(name, path) for path in found)


@settings(max_examples=3, deadline=None)
@given(some.lists(some.sampled_from(sorted(PLANTED)), min_size=2, unique=True))
def test_mistakes_do_not_hide_each_other(names: list[str]) -> None:
    # The missing catalogue may have the unknown entry.
    assume(not {"missing catalogue", "unknown entry"} <= {*names})
    found = paths_of(planted(names))
    assert [name for name in names if not any(is_of(name, path) for path in found)] == []
    assert [path for path in found if not any(is_of(name, path) for name in names)] == []
