"""What a recipe names as its base, and the recipes that come with scenetruth."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.dataset.recipe_loader import load_recipe
from scenetruth.dataset.recipe_validation import refuse_recipe
from tests.helpers.scenes import SCENES

RECIPE = {"name": "varied", "samples": 3, "distributions": {"frames.count": {"kind": "integers", "low": 2, "high": 5}}}


def written(folder: Path, **changes: Any) -> Path:
    file = folder / "recipe.yaml"
    file.write_text(yaml.safe_dump({**RECIPE, **changes}), encoding="utf-8")
    return file


def test_a_shipped_scene_goes_by_its_name(tmp_path: Path) -> None:
    sampler = st.load_recipe(written(tmp_path, base=["rosette", {"scene": "cube", "weight": 2}])).sampler()
    assert list(sampler.bases) == [st.load_scene("rosette"), st.load_scene("cube")]
    assert [entry.scene for entry in sampler.recipe.base] == [str(SCENES / "rosette.yaml"), str(SCENES / "cube.yaml")]
    # Plain values without a folder name it too.
    assert st.Recipe.from_dict({**RECIPE, "base": "rosette"}).sampler().bases == (st.load_scene("rosette"),)


def test_a_shipped_recipe_goes_by_its_name() -> None:
    assert st.load_recipe("leaves") == st.load_recipe(SCENES / "datasets" / "leaves.yaml")


def test_a_file_of_that_name_beside_the_recipe_comes_first(tmp_path: Path) -> None:
    (tmp_path / "rosette").write_bytes((SCENES / "plane.yaml").read_bytes())
    sampler = st.load_recipe(written(tmp_path, base="rosette")).sampler()
    assert list(sampler.bases) == [st.load_scene("plane")]


def test_names_of_nothing_are_told_with_all_else(tmp_path: Path) -> None:
    with pytest.raises(st.RecipeError) as caught:
        st.load_recipe(written(tmp_path, base=["rosette", "rosete", "cube.yaml"], samples=0)).sampler()
    text = str(caught.value)
    assert "base.1: no such file or bundled scene; did you mean 'rosette'?" in text
    assert "base.2: no such file" in text
    assert "use the bundled scene by name: cube" in text
    assert "base.0" not in text
    assert "samples: " in text


@pytest.mark.parametrize(
    ("base", "told"),
    [
        (
            "leav",
            "base.0: no such file or bundled scene; did you mean 'leaf'[?] `scenetruth list",
        ),
        ("qqqq", "bundled scene; `scenetruth list scenes` lists all"),
        ("../leaf.yaml", "base.0: no such file; use the bundled scene by name: leaf"),
        ("../qqqq.yaml", r"base.0: no such file; specify the path of a scene file \(got"),
    ],
)
def test_a_base_that_is_not_there_is_told_with_what_may_be_meant(base: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(st.RecipeError, match=told):
        st.load_recipe(written(tmp_path, base=base)).sampler()


@pytest.mark.parametrize("name", ["cubes", "leaves"])
def test_a_shipped_recipe_can_be_copied_anywhere(name: str, tmp_path: Path) -> None:
    copy = tmp_path / "mine.yaml"
    copy.write_bytes((SCENES / "datasets" / f"{name}.yaml").read_bytes())
    assert st.load_recipe(copy).sampler().bases == st.load_recipe(name).sampler().bases


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"name": "tiny leaves"},
            "  - name: must consist of the letters A to Z .* digit, such as tiny-leaves [(]got 'tiny leaves'[)]",
        ),
        ({"name": "  "}, "  - name: must consist of the letters A to Z and a to z, .* with a letter or a digit [(]got"),
        (
            {"set": {"objects[0].name": 1}},
            "set.objects.0..name: is not a field path: .*; write objects.0.name [(]got",
        ),
        ({"set": {"a b": 1}}, "set.a b: is not a field path: .* such as objects.0.mesh.size_mm [(]got 'a b'[)]"),
        (
            {"distributions": {"seed": {"kind": "integers", "low": 1, "high": 2, "name": "a-b"}}},
            "distributions.seed.name: must consist of the letters A to Z and a to z, digits and underscores",
        ),
        (
            {"distributions": {"seed": {"kind": "loguniform", "low": 1, "high": 2}}},
            "distributions.seed: unknown `kind`: .*; did you mean 'log_uniform'[?] [(]got",
        ),
        (
            {"acceptance": [{"kind": "visibleshare"}]},
            "acceptance.0: unknown `kind`: .*did you mean 'visible_share'[?]",
        ),
    ],
    ids=str,
)
def test_wrong_letters_and_kinds_are_told_in_words_with_what_was_meant(
    changes: dict[str, Any], told: str, tmp_path: Path
) -> None:
    with pytest.raises(st.RecipeError, match=told) as caught:
        st.load_recipe(written(tmp_path, **{"base": "plane", **changes})).sampler()
    assert "pattern" not in str(caught.value)


def test_a_key_that_is_spelt_wrong_is_told_before_what_seems_to_be_missing(tmp_path: Path) -> None:
    plain = {**RECIPE, "base": "plane", "sample": 3}
    del plain["samples"]
    with pytest.raises(st.RecipeError) as caught:
        st.Recipe.from_dict(plain).sampler()
    told = ["sample: unknown key; did you mean 'samples'? (got 3)", "samples: is missing"]
    assert list(map(str, caught.value.problems)) == told


RECIPES = sorted((Path(__file__).parents[2] / "scenes" / "datasets").glob("*.yaml"))


def test_there_are_some() -> None:
    assert {path.stem for path in RECIPES} >= {"cubes", "leaves"}


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_recipe_can_be_followed(path: Path) -> None:
    sampler = load_recipe(path).sampler()
    refuse_recipe(sampler, tried=2)
    recipe = sampler.recipe
    assert recipe.name == path.stem
    assert recipe.licence
    assert recipe.citation
    assert recipe.creators
    assert recipe.count == 200


WHOLE: dict[str, Any] = {
    "name": "planted",
    "samples": 4,
    "base": [{"scene": st.load_scene("cube").to_dict()}, {"scene": "plane"}],
    "set": {"camera.width": 64},
    "parameters": {"far": {"kind": "uniform", "low": 1, "high": 2}},
    "distributions": {
        "objects.0.pose.position_mm.2": {"kind": "uniform", "low": 600, "high": 700, "name": "distance_mm"},
        "objects.0.texture.rms_contrast": "=0.1 * far",
        "sensor": {"kind": "choice", "values": ["ideal", {"noise_std": 0.01}]},
        "stage.baseline_mm": {"kind": "uniform", "low": 1, "high": 3},
    },
    "paired_factors": {"seed": [1, 2]},
    "acceptance": [{"kind": "visible_share", "min": 0.01}, {"kind": "image_motion", "max": 50}],
    "splits": {"train": 3, "test": 1},
}
PLANTED: dict[str, tuple[dict[str, Any], str]] = {
    "wrong type": ({"samples": "many"}, "samples"),
    "misspelt key": ({"citations": "none"}, "citations"),
    "out of range": ({"max_draws": 0}, "max_draws"),
    "key of a section": ({"truth": {"content": "complete", "view": "all"}}, "truth.view"),
    "split without weight": ({"splits.train": 0}, "splits.train"),
    "missing base": ({"base.1.scene": "plain"}, "base.1"),
    "base with its own problems": ({"base.0.scene.camera.height": -3}, "base.0.camera.height"),
    "field of no scene": (
        {"distributions": {"stage.baselin.mm": {"kind": "uniform", "low": 1, "high": 2}}},
        "distributions.stage.baselin.mm",
    ),
    "value out of range of the scene": (
        {"distributions": {"frames.count": {"kind": "integers", "low": -3, "high": 4}}},
        "distributions.frames.count.low",
    ),
    "range without values": (
        {"distributions": {"render.image_error": {"kind": "uniform", "low": 2e-4, "high": 1e-4}}},
        "distributions.render.image_error",
    ),
    "missing table": (
        {"distributions": {"score.interior_margin_px": {"kind": "table", "file": "none.csv", "column": "a"}}},
        "distributions.score.interior_margin_px.file",
    ),
    "undefined name": ({"distributions": {"background": "=0.1 * fra"}}, "distributions.background"),
    "choice that is no sensor": (
        {"distributions": {"sensor": {"kind": "choice", "values": ["ideal", "idael"]}}},
        "distributions.sensor.values.1",
    ),
    "set and varied": ({"set": {"stage.baseline_mm": 2}}, ""),
    "set field of no scene": ({"set": {"optic.psf": 2}}, "set.optic.psf"),
    "paired factor out of range": ({"paired_factors": {"storage.truth": ["float32", "float8"]}}, "paired_factors."),
    "held-out value that is not varied": ({"hold_out": {"nowhere": [1]}}, "hold_out.nowhere"),
    "acceptance without bounds": ({"acceptance.0": {"kind": "visible_shar"}}, "acceptance.0"),
    "second criterion": ({"acceptance.1": {"kind": "image_motion", "max": "two"}}, "acceptance.1"),
}


def planted(names: Iterable[str]) -> dict[str, Any]:
    """Return the recipe with mistakes; mappings are extended, other values replaced."""
    plain = copy.deepcopy(WHOLE)
    for name in names:
        for path, value in PLANTED[name][0].items():
            *above, last = path.split(".")
            owner: Any = plain
            for key in above:
                owner = owner[int(key)] if isinstance(owner, list) else owner[key]
            if isinstance(owner, list):
                owner[int(last)] = value
            elif isinstance(value, dict) and isinstance(owner.get(last), dict) and "." not in path:
                owner[last] |= value
            else:
                owner[last] = value
    return plain


def paths_of(plain: dict[str, Any]) -> list[str]:
    try:
        refuse_recipe(st.Recipe.from_dict(plain).sampler(), tried=0)
    except st.RecipeError as error:
        return [problem.path for problem in error.problems]
    return []


def test_the_recipe_without_mistakes_is_valid() -> None:
    assert paths_of(planted(())) == []


@pytest.mark.parametrize("name", PLANTED)
def test_a_mistake_is_named_where_it_is(name: str) -> None:
    found = paths_of(planted([name]))
    assert found
    assert all(path.startswith(PLANTED[name][1]) for path in found)


@settings(max_examples=8, deadline=None)
@given(some.lists(some.sampled_from(sorted(PLANTED)), min_size=2, unique=True))
def test_mistakes_do_not_hide_each_other(names: list[str]) -> None:
    found = paths_of(planted(names))
    for name in names:
        where = PLANTED[name][1]
        assert any(path.startswith(where) and (where or not path) for path in found), name
    for path in found:
        assert any(path.startswith(PLANTED[name][1]) and (PLANTED[name][1] or not path) for name in names), path


def test_overrides_that_cannot_be_applied_hide_no_other_problem() -> None:
    with pytest.raises(st.RecipeError) as caught:
        st.load_recipe(planted(["wrong type", "misspelt key"]), overrides=["base.7.weight=1", "seed=[1"])
    paths = [problem.path for problem in caught.value.problems]
    assert paths == ["--set base.7.weight", "--set seed", "samples", "citations"]
