"""What belongs to a data set: machines that cannot make its samples stop the run, and so do changed files."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

import scenetruth as st
from scenetruth.dataset.fingerprint import begin_dataset, collect_dataset_files
from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.verification import verify_dataset
from scenetruth.errors import BackendUnavailableError, MachineError, MismatchError
from scenetruth.jobs.worker_setup import collect_versions, refuse_other_versions
from tests.helpers.nightly import by_night
from tests.helpers.no_gl import fresh_workers, python_path_without_gl
from tests.helpers.small_recipes import RECIPE


def changed(folder: DatasetFolder, **changes: Any) -> None:
    found = json.loads(folder.identity.read_text(encoding="utf-8"))
    folder.identity.write_text(json.dumps({**found, **changes}), encoding="utf-8")


@pytest.mark.parametrize("workers", [1, *by_night(2)])
def test_a_worker_without_gl_is_told_and_no_sample_is_set_aside(
    workers: int, tmp_path: Path, sampler_with: Callable[..., Sampler], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, sampler = DatasetFolder(tmp_path / "new"), sampler_with(samples=2)
    begin_dataset(folder, sampler)
    # As if it had been begun where there is GL.
    changed(folder, backend="pyrender", platform="osmesa")
    missing = BackendUnavailableError("pyrender (osmesa)", "no such library", "install libosmesa6")
    if workers > 1:
        monkeypatch.setenv("PYTHONPATH", python_path_without_gl(tmp_path))
    with (
        fresh_workers(),
        patch("scenetruth.render.backend_selection._pyrender", side_effect=missing),
        pytest.raises(MachineError, match=r"workers: .* cannot render this data set.*OSMesa|libosmesa6"),
    ):
        run_dataset(sampler.recipe, output=folder.path, workers=workers)
    assert (read_status(folder.path).done, read_status(folder.path).failed) == (0, {})
    changed(folder, backend="raycast", platform="auto")
    assert run_dataset(sampler.recipe, output=folder.path, workers=1).made == 2


def test_other_versions_make_other_samples(tmp_path: Path, sampler_with: Callable[..., Sampler]) -> None:
    refuse_other_versions(collect_versions())
    with pytest.raises(MachineError, match=r"has numpy .* was begun with 1\.0"):
        refuse_other_versions({**collect_versions(), "numpy": "1.0"})


MESH = "objects.1.mesh"


def quad(file: Path, size: float) -> dict[str, Any]:
    """Write a square mesh, and return its section of a scene."""
    corners = [(-size, -size), (size, -size), (size, size), (-size, size)]
    lines = [*(f"v {x} {y} 0" for x, y in corners), "f 1 2 3", "f 1 3 4"]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return {"kind": "file", "file": str(file)}


def recipe(**changes: Any) -> Recipe:
    return Recipe.from_dict({**copy.deepcopy(RECIPE), "samples": 2, **changes})


def choices(folder: Path, way: str) -> tuple[dict[str, Any], Path]:
    """Return a recipe that names files in one of several ways, and one of these files."""
    one, two = quad(folder / "one.obj", 9), quad(folder / "two.obj", 10)
    texts = [one["file"], two["file"]]
    table = folder / "runs.txt"
    table.write_text(f"z,mesh\n100,{texts[0]}\n105,{texts[1]}\n", encoding="utf-8")
    column = {"kind": "table", "file": str(table)}
    base, other = (copy.deepcopy(RECIPE["base"][0]["scene"]) for _ in range(2))
    base["objects"][1]["mesh"], other["objects"][1]["mesh"] = one, two
    place = f"{MESH}.file"
    plain = {
        "choice of meshes": {"distributions": {MESH: {"kind": "choice", "values": [one, two]}}},
        "sequence of files": {"distributions": {place: {"kind": "sequence", "values": texts}}, "base": base},
        "grid of files": {"distributions": {place: {"kind": "grid", "values": texts}}, "base": base},
        "linked": {
            "parameters": {"shape": {"kind": "choice", "values": texts}},
            "distributions": {place: {"kind": "linked", "of": "shape"}},
            "base": base,
        },
        "paired factor": {"paired_factors": {MESH: [two]}},
        "column of a table": {"distributions": {place: {**column, "column": "mesh"}}, "base": base},
        "table": {"distributions": {"objects.1.pose.position_mm.2": {**column, "column": "z"}}},
        "base scene": {"base": other},
    }[way]
    return plain, table if way == "table" else folder / "two.obj"


WAYS = (
    "choice of meshes",
    "sequence of files",
    "grid of files",
    "linked",
    "paired factor",
    "column of a table",
    "table",
    "base scene",
)


@pytest.mark.parametrize("way", [*WAYS[:2], *by_night(*WAYS[2:])])
def test_each_file_that_a_draw_can_name_belongs_to_the_data_set(tmp_path: Path, way: str) -> None:
    plain, file = choices(tmp_path, way)
    assert file in collect_dataset_files(recipe(**plain).sampler())
    folder = tmp_path / "new"
    st.run_dataset(recipe(**plain), output=folder)
    assert str(file) in json.loads(DatasetFolder(folder).identity.read_text(encoding="utf-8"))["files"]
    samples = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    # The same content at another time is no change.
    file.write_bytes(file.read_bytes())
    assert st.run_dataset(recipe(**plain), output=folder).made == 0
    if way == "table":
        file.write_text(file.read_text(encoding="utf-8").replace("105", "108"), encoding="utf-8")
    else:
        quad(file, 11)
    for again in (recipe(**plain), None):
        with pytest.raises(
            MismatchError, match=rf"{file.name}: .*has changed since .*restore the former file"
        ) as caught:
            st.run_dataset(again, output=folder, extend=True)
        assert [problem.path for problem in caught.value.problems] == [str(file)]
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == samples


def test_files_that_no_draw_names_do_not_count(tmp_path: Path) -> None:
    words = {"distributions": {"objects.1.texture.kind": {"kind": "choice", "values": ["noise"]}}}
    assert collect_dataset_files(recipe(**words).sampler()) == []


def test_a_file_that_changes_during_a_run_stops_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scenetruth import simulation

    one, two = quad(tmp_path / "one.obj", 9), quad(tmp_path / "two.obj", 10)
    given = recipe(distributions={MESH: {"kind": "sequence", "values": [one, two]}})
    folder, simulate_into = tmp_path / "new", simulation.simulate_into

    def change_then_simulate(*arguments: Any, **options: Any) -> Any:
        found = simulate_into(*arguments, **options)
        quad(tmp_path / "two.obj", 11)
        return found

    monkeypatch.setattr(simulation, "simulate_into", change_then_simulate)
    with pytest.raises(MachineError, match=r"(?s)two\.obj.*would be mixed|would be mixed.*two\.obj"):
        st.run_dataset(given, output=folder)
    monkeypatch.undo()
    assert [one.number for one in verify_dataset(folder, regenerate=0)] == [1]
    quad(tmp_path / "two.obj", 10)
    assert st.run_dataset(given, output=folder).made == 1
    assert verify_dataset(folder, regenerate=2) == []


def test_a_table_that_changes_is_read_again(tmp_path: Path) -> None:
    table = tmp_path / "runs.csv"
    column = {"kind": "table", "file": str(table), "column": "z"}
    drawn = []
    for depth in (100, 10555):
        table.write_text(f"z\n{depth}\n", encoding="utf-8")
        drawn.append(recipe(parameters={"depth": column}).sampler().draw(0).values["depth"])
    assert drawn == [100, 10555]


@pytest.mark.parametrize("way", ["distribution", *by_night("table", "paired", "set")])
def test_relative_file_names_refer_to_the_directory_of_the_recipe(
    tmp_path: Path, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The working directory has files of the same names, which are not meant."""
    for place in (tmp_path / "recipe", tmp_path / "elsewhere"):
        place.mkdir()
        for name in ("one.obj", "two.obj"):
            quad(place / name, 9)
    (tmp_path / "recipe" / "files.csv").write_text("file\none.obj\ntwo.obj\n")
    base = copy.deepcopy(RECIPE["base"][0]["scene"])
    base["objects"][1]["mesh"] = {"kind": "file", "file": "one.obj"}
    field, files = f"{MESH}.file", ["one.obj", "two.obj"]
    ways: dict[str, dict[str, Any]] = {
        "distribution": {"distributions": {field: {"kind": "sequence", "values": files}}},
        "table": {"distributions": {field: {"kind": "table", "file": "files.csv", "column": "file"}}},
        "paired": {"distributions": {}, "paired_factors": {field: ["two.obj"]}, "samples": 1},
        "set": {"distributions": {}, "set": {field: "two.obj"}, "samples": 1},
    }
    plain = {**RECIPE, "samples": 2, **ways[way], "base": base}
    file = tmp_path / "recipe" / "recipe.yaml"
    file.write_text(json.dumps(plain), encoding="utf-8")
    monkeypatch.chdir(tmp_path / "elsewhere")
    run_dataset(st.load_recipe(file), output="new")
    monkeypatch.chdir(tmp_path)
    found = [sample.scene.to_dict()["objects"][1]["mesh"]["file"] for sample in st.open_dataset("elsewhere/new")]
    expected = ["two.obj"] if way == "set" else files
    assert found == [str(tmp_path / "recipe" / name) for name in expected]
    assert verify_dataset(tmp_path / "elsewhere" / "new") == []
    # The data set can be moved, and its recipe is read from anywhere; the files are those of its begin.
    quad(tmp_path / "recipe" / "two.obj", 12)
    with pytest.raises(MismatchError, match=r"two\.obj"):
        run_dataset(None, output=tmp_path / "elsewhere" / "new")
