"""What the machine does not have is refused before any work begins."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.resources import build_checked_scene, enforcement, limited_objects, load_checked_scene
from scenetruth.resources.cost_estimate import Forecast, StageForecast
from scenetruth.resources.enforcement import machine_problems, refuse_resources
from scenetruth.resources.limits import Limits
from scenetruth.resources.system import Machine
from scenetruth.resources.workload import list_object_workloads
from scenetruth.scene.field_paths import assign
from tests.helpers.scenes import bright_scene, cube

FORECAST = Forecast({"render": StageForecast(3e9, 5e9, 7200, 8e9), "estimate": StageForecast(6e9, 1e9, 1800, 1e9)})
PLENTY = Machine(100 * 10**9, 100 * 10**9, 2)


def paths(machine: Machine = PLENTY, limits: Limits | None = None) -> list[str]:
    return [problem.path for problem in machine_problems(FORECAST, machine, limits or Limits())]


def test_what_fits_is_let_through_and_what_is_not_known_is_not_refused() -> None:
    refuse_resources(FORECAST, PLENTY, Limits())
    refuse_resources(FORECAST, Machine(None, None, 1), Limits())


def test_all_that_is_too_much_is_told_at_once() -> None:
    small = Machine(5 * 10**9, 8 * 10**9, 2)
    assert paths(small, Limits(hours=2)) == ["memory of estimate", "disk space, with a margin for compression", "time"]
    with pytest.raises(st.MachineError) as caught:
        refuse_resources(FORECAST, small, Limits(hours=2))
    text = str(caught.value)
    for words in ("about 6 GB, limit 5 GB:", "--limit memory_gb=6.3", "2.5 hours", "hours=2.6"):
        assert words in text


def test_a_disk_that_is_full_is_told_without_an_exponent() -> None:
    (problem,) = machine_problems(FORECAST, Machine(None, 36_900, 2), Limits())
    assert "estimated at about 9 GB, limit 0.000037 GB: " in problem.message


def test_who_insists_is_let_through_as_the_message_says() -> None:
    small = Machine(5 * 10**9, 8 * 10**9, 2)
    assert paths(small, Limits(memory_gb=6.3, disk_gb=9.5)) == []
    assert paths(PLENTY, Limits(memory_gb=2)) == ["memory of estimate"]


def test_where_nothing_can_be_written_is_told_and_not_as_lack_of_disk() -> None:
    with pytest.raises(st.MachineError, match=r"output: results cannot be written here: .*\(got '/proc'\)") as caught:
        refuse_resources(FORECAST, Machine(None, None, 2, unwritable="/proc"), Limits())
    assert "disk" not in str(caught.value)
    # A check writes nothing.
    assert paths(Machine(None, None, 2, unwritable="/proc")) == []


def test_problems_of_a_file_that_is_mended_meanwhile_are_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first reading finds them; the second one, which collects those of all objects, does not."""
    file = tmp_path / "sheet.obj"
    file.write_text("v 0 0 0\n", encoding="utf-8")
    mesh = {"kind": "file", "file": str(file)}
    item = {"name": "sheet", "mesh": mesh, "pose": {"position_mm": [0, 0, 400]}, "texture": {"kind": "uniform"}}
    scene = cube(objects=[item])
    listed = list_object_workloads

    def mended(*arguments: Any) -> Any:
        found = listed(*arguments)
        file.write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", encoding="utf-8")
        return found

    monkeypatch.setattr(enforcement, "list_object_workloads", mended)
    with pytest.raises(st.SceneError) as caught:
        limited_objects(scene, Limits())
    assert [problem.path for problem in caught.value.problems] == ["objects.0.mesh.file"]
    assert limited_objects(scene, Limits())


def test_a_run_is_refused_before_it_leaves_anything(tmp_path: Path) -> None:
    for limits, what in ((Limits(memory_gb=0.1), "memory of render"), (Limits(hours=1e-6), "time")):
        with pytest.raises(st.MachineError, match=what):
            st.run_scene(cube(), output=tmp_path / "run", stages=("render",), limits=limits)
    with pytest.raises(st.SceneError, match="--limit frames="):
        st.run_scene(cube(), output=tmp_path / "run", limits=Limits(frames=3))
    assert list(tmp_path.iterdir()) == []


MISTAKES: dict[str, tuple[Any, tuple[str, ...]]] = {
    "objects.1.material.refractive_index": (0.5, ("objects.1.material.refractive_index",)),
    "objects.2.material.roughness": (0.0, ("objects.2.material.roughness",)),
    "objects.2.material.roughness_along": (1.5, ("objects.2.material.roughness_along",)),
    # The sheet reflects and transmits 1.8 of 0.8 of the light in the near infrared.
    "objects.3.texture.radiance": (0.8, ("objects.3.material.transmittance",)),
    "objects.0.texture.radiance": (1.2, ("objects.0.texture.radiance",)),
    # Of a misspelt field, the value is unknown: the sheet could be anywhere.
    "objects.1.pose": ({"positon_mm": [0, 0, -40]}, ("objects.1.pose.positon_mm",)),
    "objects.2.tint": ({"red": 0.5, "blue": 0.5}, ("objects.2.tint", "objects.2.tint")),
    "lighting.lights.0.position_mm": ([-60, 0, 420], ("lighting.lights.0.position_mm",)),
    "lighting.lights.1.position_mm": ([2, 0, 0], ("lighting.lights.1.position_mm",)),
    "lighting.lights.0.irradiance": ({"red": 1.0}, ("lighting.lights.0.irradiance",)),
    "lighting.lights.2.file": ("none.ies", ("lighting.lights.2.file",)),
    "lighting.lights.2.irradiance": ({"red": -1.0, "nir": 1.0}, ("lighting.lights.2.irradiance.red",)),
    "lighting.drift_per_frame": (-2.0, ("lighting.drift_per_frame",)),
    "shutter": ({"exposure_time_s": 3.0}, ("shutter.exposure_time_s",)),
    "estimate.window": (3, ("estimate.window",)),
    "seed": (-1, ("seed",)),
    "lightning": ({}, ("lightning",)),
}
"""Values by their paths, and the paths of their problems: of fields, bands, geometry, light and files."""


def find_paths(plain: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the paths of all problems of a scene that is to be simulated."""
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(dict(plain)))
    problems: tuple[st.Problem, ...] = ()
    try:
        scene = load_checked_scene(file, limits=Limits())
        limited_objects(scene, Limits())
        build_checked_scene(scene)
    except st.SceneError as error:
        problems = error.problems
    assert all(problem.value is not None for problem in problems)
    return sorted(problem.path for problem in problems)


@settings(max_examples=3, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(wrong=some.sets(some.sampled_from(sorted(MISTAKES))))
@example(wrong=set(MISTAKES))
@example(wrong=set())
def test_any_mistakes_are_reported_together_and_nothing_else(wrong: set[str], tmp_path: Path) -> None:
    plain = bright_scene(tmp_path)
    for path in wrong:
        assign(plain, path, MISTAKES[path][0])
    assert find_paths(plain, tmp_path) == sorted(where for path in wrong for where in MISTAKES[path][1])
