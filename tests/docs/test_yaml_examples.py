"""Examples of light, colour and data sets in the pages are valid scenes and recipes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

import scenetruth as st
from scenetruth.dataset.recipe_validation import refuse_recipe
from scenetruth.resources import limited_objects
from scenetruth.resources.quick_preview import make_quick_preview
from scenetruth.scene.scene_report import describe_scene
from tests.helpers.scenes import SCENES

HOW_TO = Path(__file__).parents[2] / "docs" / "how_to"
PAGES = [HOW_TO / name for name in ("scenes/light_and_materials.md", "scenes/colour.md", "generate_data_sets.md")]
_BLOCK = re.compile(r"^```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks() -> list[Any]:
    """Return the examples with the name of their page and their number as parameters."""
    return [
        pytest.param(yaml.safe_load(text), id=f"{page.stem}-{number}")
        for page in PAGES
        for number, text in enumerate(_BLOCK.findall(page.read_text(encoding="utf-8")))
    ]


def put_into(base: Any, part: Any) -> Any:
    """Return the base with the values of the part: mappings of one kind are joined, lists entry by entry."""
    if isinstance(base, Mapping) and isinstance(part, Mapping) and part.get("kind") in (None, base.get("kind")):
        return {**base, **{key: put_into(base.get(key), value) for key, value in part.items()}}
    if isinstance(base, list) and isinstance(part, list):
        return [put_into(*pair) for pair in zip(base, part, strict=False)] + base[len(part) :] + part[len(base) :]
    return part


def scene_of(example: dict[str, Any]) -> dict[str, Any]:
    """Return a complete scene: the example itself, or a bundled scene with its fields."""
    if {"camera", "objects"} <= example.keys():
        return example
    name = "rosette" if "plants" in example else "leaf" if "texture" in example else "plane"
    base = yaml.safe_load((SCENES / f"{name}.yaml").read_text(encoding="utf-8"))
    if "texture" in example:
        example = {"objects": [example], "camera": {"bands": list(example["texture"]["textures"])}}
    return dict(put_into(base, example))


@pytest.mark.parametrize("example", blocks())
def test_examples_are_valid(example: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The file that an example names: even light in all directions downwards.
    (tmp_path / "luminaire.ies").write_text(
        "IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 2 1 1 2 0 0 0\n1 1 10\n0 90\n0\n100 100\n"
    )
    monkeypatch.chdir(tmp_path)
    if "base" in example:
        sampler = st.Recipe.from_dict(example).sampler()
        refuse_recipe(sampler, tried=1)
        return
    scene = st.Scene.from_dict(scene_of(example))
    seen = make_quick_preview(scene, limited_objects(scene, st.Limits()))
    report = describe_scene(scene, seen.world, seen.depth, seen.times)
    assert not [message for message in report.warnings if re.search("material|lamp|light", message)]


def test_wrong_examples_would_be_found() -> None:
    with pytest.raises(st.SceneError, match="irradiance"):
        st.Scene.from_dict(scene_of({"lighting": {"lights": [{"kind": "directional", "direction": [0, 0, 1]}]}}))
