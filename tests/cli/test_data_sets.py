"""The commands of data sets: what they print, and how they end."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from scenetruth.cli.app import app
from scenetruth.errors import ExportError, MismatchError, RecipeError, StoreError
from tests.helpers.small_recipes import RECIPE

DEPTH = "objects.1.pose.position_mm.2"


def call(*words: object, code: int = 0, group: tuple[str, ...] = ("dataset",)) -> str:
    result = CliRunner().invoke(app, [*group, *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code
    return result.output


def written(folder: Path, **changes: Any) -> Path:
    file = folder / "recipe.yaml"
    file.write_text(yaml.safe_dump({**copy.deepcopy(RECIPE), "samples": 2, **changes}), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    output = call("run", written(folder), "-o", folder / "tiles")
    assert "(2 samples; 0 existing samples were reused)" in output
    return folder / "tiles"


def test_check_tells_what_varies_what_is_refused_and_what_it_takes(tmp_path: Path) -> None:
    recipe = written(tmp_path, acceptance=[{"kind": "depth", "object": "tile", "max": 100}], samples=8)
    output = call("check", recipe)
    assert "uniform from 90 to 110" in output
    assert "rejected: " in output
    assert "one sample" in output
    assert "licence: is missing" in output


@pytest.mark.parametrize("columns", ["50", "80"])
def test_check_shows_all_of_a_path_however_narrow_the_terminal(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    output = call("check", "cubes")
    assert "…" not in output
    first = "".join(line.split("│")[1].strip() for line in output.splitlines() if line.count("│") == 3)
    for axis in range(3):
        assert f"objects.0.motion.0.velocity_mm_per_frame.{axis}" in first


def test_run_goes_on_and_status_and_verify_tell_how_far(made: Path) -> None:
    assert "(0 samples; 2 existing samples were reused)" in call("run", made, "-o", made)
    assert "2 of 2 samples exist, 0 failed" in call("status", made)
    assert json.loads(call("status", made, "--json")) == {"samples": 2, "finished": 2, "failed": {}}
    assert f"verified: {made}" in call("verify", made, "--regenerate", 1, group=())
    assert json.loads(call("verify", made, "--json", "--quiet", group=())) == [{"path": str(made), "problem": ""}]


def test_a_sample_alone_is_that_of_the_data_set(made: Path, tmp_path: Path) -> None:
    call("sample", made, 1, "-o", tmp_path / "alone")
    own = made / "samples" / "00000" / "00000001"
    for file in own.iterdir():
        assert file.read_bytes() == (tmp_path / "alone" / file.name).read_bytes()
    with pytest.raises(RecipeError, match="there are 2 samples"):
        call("sample", made, 2, "-o", tmp_path / "none")


def test_some_failures_have_an_exit_code_of_their_own(tmp_path: Path) -> None:
    recipe = written(tmp_path, distributions={DEPTH: {"kind": "sequence", "values": [100, -50]}})
    output = call("run", recipe, "-o", tmp_path / "new", "--retries", 0, code=1)
    assert "1 samples failed" in output
    assert "is behind the camera" in call("status", tmp_path / "new")


@pytest.mark.parametrize("command", [("check",), ("run", "-o", "new"), ("sample", 0, "-o", "new")])
def test_what_is_wrong_with_a_recipe_names_its_file(tmp_path: Path, command: tuple[object, ...]) -> None:
    recipe = written(
        tmp_path, distributions={"objects.0.texture.rms_contrast": {"kind": "uniform", "low": -1, "high": 3}}
    )
    name, *rest = command
    with pytest.raises((RecipeError, MismatchError), match=r"recipe\.yaml") as caught:
        call(name, recipe, *[tmp_path / word if word == "new" else word for word in rest])
    assert "rms_contrast" in str(caught.value)
    assert not (tmp_path / "new").exists()


def test_other_folders_are_no_data_sets(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="is not a data set"):
        call("status", tmp_path)


def test_the_schema_describes_every_kind() -> None:
    schema = json.loads(call("schema", "recipe", group=()))
    assert {"UniformDistribution", "ChoiceDistribution", "TableDistribution", "VisibleFractionCriterion"} <= set(
        schema["$defs"]
    )
    assert "Examples" not in json.dumps(schema)
    assert schema["properties"]["distributions"]["description"]


@pytest.mark.usefixtures("undrawn_figures")
def test_a_card_from_before_is_told_of(tmp_path: Path) -> None:
    assert "out of date" not in call("run", written(tmp_path, samples=1), "-o", tmp_path / "tiles")
    call("card", tmp_path / "tiles")
    output = call("run", written(tmp_path, samples=2), "-o", tmp_path / "tiles", "--extend")
    told = "the data-set card is out of date; run `scenetruth dataset card"
    assert told in output
    call("card", tmp_path / "tiles", "--overwrite")
    assert told not in call("run", written(tmp_path, samples=2), "-o", tmp_path / "tiles")


def test_fields_of_a_recipe_are_replaced(tmp_path: Path) -> None:
    recipe = written(tmp_path)
    assert "one sample" in call("check", recipe, "--set", "samples=3")
    changes = ("--set", f"distributions.{DEPTH}.low=95", "--set", "seed=7")
    call("sample", recipe, 0, "-o", tmp_path / "one", *changes)
    call("sample", recipe, 0, "-o", tmp_path / "two", "--set", f"distributions.{DEPTH}.low=95", "--seed", 7)
    call("sample", recipe, 0, "-o", tmp_path / "three")
    scenes = [(tmp_path / name / "scene.yaml").read_text() for name in ("one", "two", "three")]
    assert scenes[0] == scenes[1] != scenes[2]


def test_an_export_of_a_data_set_uses_overwrite_and_row(made: Path, tmp_path: Path) -> None:
    words = ("export", made, "--format", "pfm", "-o", tmp_path / "out")
    assert "(2 samples; 0 existing samples were reused)" in call(*words, group=())
    assert "(0 samples; 2 existing samples were reused)" in call(*words, group=())
    changed = next((tmp_path / "out" / "00000000").rglob("*.pfm"))
    content = changed.read_bytes()
    changed.write_bytes(b"")
    assert "(2 samples; 0 existing samples were reused)" in call(*words, "--overwrite", group=())
    assert changed.read_bytes() == content
    # These samples have no grid of cameras.
    with pytest.raises(ExportError, match=r"s_y|row"):
        call(*words, "--overwrite", "--row", 0, group=())
