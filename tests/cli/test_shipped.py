"""What is shipped is called by its name; a path always wins."""

from __future__ import annotations

import importlib.resources
import json
from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.cli.bundled_files import DESIGNS, RECIPES, SCENES, BundledFiles, resolve_file
from scenetruth.design.optimisation.design_records import DesignSpecError
from scenetruth.input_files import bundled_folder
from tests.cli.calling import scenetruth
from tests.scenes import LIBRARY
from tests.scenes import SCENES as FOLDER


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_all_scenes_recipes_and_goals_are_shipped() -> None:
    """In a checkout the files themselves, in an installed package copies of them."""
    for shelf, files in (
        (SCENES, LIBRARY),
        (RECIPES, sorted((FOLDER / "datasets").glob("*.yaml"))),
        (DESIGNS, sorted((FOLDER / "designs").glob("*.yaml"))),
    ):
        shipped = shelf.files()
        assert {name: file.read_bytes() for name, file in shipped.items()} == {f.stem: f.read_bytes() for f in files}
        assert list(shipped) == [file.stem for file in files]


def test_an_installed_package_brings_them_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.resources, "files", lambda package: tmp_path / "site" / package)
    assert bundled_folder() is None
    assert SCENES.files() == {}
    (tmp_path / "site" / "scenetruth" / "shipped" / "designs").mkdir(parents=True)
    (tmp_path / "site" / "scenetruth" / "shipped" / "designs" / "far.yaml").touch()
    assert resolve_file(DESIGNS, Path("far")) == tmp_path / "site" / "scenetruth" / "shipped" / "designs" / "far.yaml"


@pytest.mark.parametrize(("shelf", "name"), [(SCENES, "cube"), (RECIPES, "cubes"), (DESIGNS, "cube_depth")])
def test_a_name_stands_for_a_file_unless_there_is_one(shelf: BundledFiles, name: str, tmp_path: Path) -> None:
    shipped = shelf.files()[name]
    assert resolve_file(shelf, Path(name)) == shipped
    (tmp_path / name).mkdir()
    # An earlier run may have left its results under this name; a recipe may be that of a data set.
    assert resolve_file(shelf, Path(name)) == (Path(name) if shelf.takes_folders else shipped)
    (tmp_path / name).rmdir()
    (tmp_path / name).touch()
    assert resolve_file(shelf, Path(name)) == Path(name)


@pytest.mark.parametrize(
    ("shelf", "error", "near"),
    [(SCENES, st.SceneError, "Kube"), (RECIPES, st.RecipeError, "cubs"), (DESIGNS, DesignSpecError, "cube_dept")],
)
def test_unknown_names_are_told_with_those_near_them(shelf: BundledFiles, error: type[Exception], near: str) -> None:
    with pytest.raises(
        error, match=rf"no bundled {shelf.noun} of this name; did you mean .*`scenetruth list {shelf.noun}s`"
    ):
        resolve_file(shelf, Path(near))
    with pytest.raises(error, match=r"of this name; `scenetruth list \w+` lists all \(got 'qqqq'\)"):
        resolve_file(shelf, Path("qqqq"))


@pytest.mark.parametrize(
    ("shelf", "error", "name", "told"),
    [
        (SCENES, st.SceneError, "leaves", "'leaves' is a bundled recipe: `scenetruth dataset run leaves -o DIR`"),
        (
            SCENES,
            st.SceneError,
            "leaf_growth",
            "is a bundled design: `scenetruth design optimise leaf_growth -o DIR`",
        ),
        (
            RECIPES,
            st.RecipeError,
            "cube",
            "'cube' is a bundled scene: `scenetruth run cube -o DIR`; did you mean",
        ),
        (RECIPES, st.RecipeError, "sheet_motion", "is a bundled design: `scenetruth design optimise sheet_motion"),
        (
            DESIGNS,
            DesignSpecError,
            "windy_leaf",
            "'windy_leaf' is a bundled scene: `scenetruth run windy_leaf -o DIR`",
        ),
        (DESIGNS, DesignSpecError, "leaves", "'leaves' is a bundled recipe: `scenetruth dataset run leaves"),
    ],
)
def test_what_is_shipped_as_something_else_is_told_with_its_command(
    shelf: BundledFiles, error: type[Exception], name: str, told: str
) -> None:
    with pytest.raises(
        error, match=rf"no bundled {shelf.noun} of this name; .*`scenetruth list {shelf.noun}s` lists all"
    ) as caught:
        resolve_file(shelf, Path(name))
    assert told in str(caught.value)
    with pytest.raises(error, match=rf"no such file; '{name}' is a bundled \w+: scenetruth .* {name} -o DIR"):
        resolve_file(shelf, Path(f"{name}.yaml"))


def test_paths_to_nothing_are_left_to_who_reads_them_unless_their_name_is_shipped() -> None:
    assert resolve_file(SCENES, Path("no/such.yaml")) == Path("no/such.yaml")
    assert resolve_file(SCENES, Path("no/cube")) == Path("no/cube")
    with pytest.raises(st.SceneError, match="use the bundled scene by name: cube"):
        resolve_file(SCENES, Path("scenes/cube.yaml"))


def test_commands_take_names(tmp_path: Path) -> None:
    done = scenetruth("check", "plaid")
    assert done.returncode == 0, done.stderr
    assert "45 of 64 x 64 px" in done.stdout
    for command in (
        ["run", "plad", "-o", "out"],
        ["render", "plad", "-o", "out"],
        ["design", "predict", "plad"],
        ["design", "budget", "plad"],
        ["design", "sweep", "plaid", "plad", "-o", "out", "--vary", "seed=1,2"],
        ["design", "pattern", "plad", "-o", "out"],
        ["design", "optimise", "plad", "-o", "out"],
        ["dataset", "check", "plad"],
    ):
        done = scenetruth(*command)
        assert done.returncode == 2, command
        assert "of this name" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_all_of_them_are_listed() -> None:
    for shelf in (SCENES, RECIPES, DESIGNS):
        done = scenetruth("list", f"{shelf.noun}s")
        assert done.returncode == 0, done.stderr
        for name in shelf.files():
            assert f" {name} " in done.stdout
        rows = json.loads(scenetruth("list", f"{shelf.noun}s", "--json").stdout)
        assert {row["name"]: row["file"] for row in rows} == {k: str(v) for k, v in shelf.files().items()}
    done = scenetruth("list", "scenes")
    for words in ("Scharr & Küsters 2002", "45 images of 64 x 64 px", str(bundled_folder())):
        assert words in done.stdout


def test_recipes_say_how_many_scenes_they_make() -> None:
    listed = scenetruth("list", "recipes").stdout
    for name in RECIPES.files():
        assert f" {st.load_recipe(name).count:,} scenes " in listed
