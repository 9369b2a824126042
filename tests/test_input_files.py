"""Fields that name files: absolute where a folder is known, and all of them found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pytest
from pydantic import Field

import scenetruth as st
from scenetruth.input_files import InputFile, collect_input_files, validation_context
from scenetruth.validated_model import FrozenModel
from tests.helpers.scenes import SCENES


class Leaf(FrozenModel):
    name: str = "not a file"
    file: InputFile | None = None


class Tree(FrozenModel):
    files: Annotated[tuple[InputFile, ...], Field(min_length=1)]
    leaves: tuple[Leaf, ...] = ()
    by_name: dict[str, Leaf]


PLAIN = {"files": ["a.obj", "/b/c.obj"], "leaves": [{}, {"file": "../d.png"}], "by_name": {"x": {"file": "e.npy"}}}


def test_relative_paths_count_from_the_folder() -> None:
    tree = Tree.model_validate(PLAIN, context=validation_context(Path("/scenes")))
    assert tree.files == ("/scenes/a.obj", "/b/c.obj")
    assert tree.leaves[1].file == "/scenes/../d.png"
    assert tree.leaves[0].file is None


@pytest.mark.parametrize("context", [None, {}, validation_context(None)])
def test_paths_stay_as_they_are_without_a_folder(context: dict[str, object] | None) -> None:
    tree = Tree.model_validate(PLAIN, context=context)
    assert tree.files == ("a.obj", "/b/c.obj")


def test_every_file_is_listed_with_its_place() -> None:
    found = collect_input_files(Tree.model_validate(PLAIN))
    assert found == [
        ("files.0", Path("a.obj")),
        ("files.1", Path("/b/c.obj")),
        ("leaves.1.file", Path("../d.png")),
        ("by_name.x.file", Path("e.npy")),
    ]


def test_the_files_of_a_scene_are_found_whatever_its_kinds() -> None:
    scene = st.load_scene(SCENES / "finite_elements.yaml")
    found = dict(collect_input_files(scene))
    assert set(found) == {"objects.0.mesh.file", "objects.0.deformation.0.file"}
    assert all(path.is_absolute() and path.exists() for path in found.values())


def test_files_of_a_series_are_found() -> None:
    plain = st.load_scene(SCENES / "finite_elements.yaml").to_dict()
    plain["objects"][0]["deformation"] = [{"kind": "meshes", "files": ["one.obj", "two.obj"]}]
    plain["objects"][0]["texture"] = {"kind": "image", "file": "pattern.png"}
    found = dict(collect_input_files(st.Scene.from_dict(plain)))
    assert found["objects.0.texture.file"] == Path("pattern.png")
    assert found["objects.0.deformation.0.files.1"] == Path("two.obj")
