"""The generated reference covers every public name, every command and option, every model and field of a file."""

from __future__ import annotations

import ast
import inspect
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from pydantic import BaseModel

import scenetruth
import scenetruth.testing
from scenetruth.capture import Capture
from scenetruth.cli.app import app
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.design.optimisation import DesignSpec
from scenetruth.scene import Scene
from scenetruth_site.api import API, api_in_markdown, documented_names
from scenetruth_site.commands import command_names, commands_in_markdown
from scenetruth_site.file_examples import examples_in
from scenetruth_site.file_models import anchor_of, models_of
from scenetruth_site.files import DESCRIBED, page_in_markdown, pages_of_file
from scenetruth_site.generated import generated_parts
from tests.helpers.docstring_sections import sections_of

DOCS = Path(__file__).parents[2] / "docs"
NAMES = Counter(f"{module}.{name}" for modules in API.values() for module, names in modules.items() for name in names)


def test_every_public_name_is_documented_once() -> None:
    assert set(NAMES.values()) == {1}
    public = {f"scenetruth.{name}" for name in scenetruth.__all__}
    public |= {f"scenetruth.testing.{name}" for name in scenetruth.testing.__all__}
    assert public <= set(NAMES)


def test_documented_names_exist_and_are_found_by_their_last_part() -> None:
    for name in NAMES:
        module, last = name.rsplit(".", 1)
        assert hasattr(import_module(module), last), name
    assert documented_names()["simulate"] == "scenetruth.simulate"


THINGS = {name: getattr(import_module(name.rpartition(".")[0]), name.rpartition(".")[2]) for name in NAMES}
DESCRIBED_THINGS = [name for name, thing in THINGS.items() if callable(thing)]


def found_from(module: str, name: str) -> bool:
    """Tell whether a name of a See Also leads somewhere: of the same module, documented elsewhere, or a full path."""
    first, *rest = name.split(".")
    places: list[Any] = [getattr(import_module(module), first, None), THINGS.get(documented_names().get(first, ""))]
    if first == "scenetruth":
        places = [scenetruth]
    for place in places:
        for part in rest:
            if inspect.ismodule(place):
                with suppress(ModuleNotFoundError):
                    import_module(f"{place.__name__}.{part}")
            place = getattr(place, part, None)
        if place is not None:
            return True
    return False


@pytest.mark.parametrize("name", DESCRIBED_THINGS)
def test_every_documented_name_has_an_example_that_runs_and_tells_what_to_see_also(name: str) -> None:
    sections = sections_of(THINGS[name])
    assert ">>>" in sections["Examples"]
    assert "+SKIP" not in sections["Examples"]
    module = inspect.getmodule(THINGS[name])
    assert module is not None
    # numpydoc: names with commas between, a colon, and what each does.
    entries = re.findall(r"^(?! )(\S[^:]*?) ?:", sections["See Also"], re.MULTILINE)
    others = [each for entry in entries for each in entry.split(", ")]
    assert others
    assert [each for each in others if not found_from(module.__name__, each)] == []


def imported_in_pages() -> Iterator[tuple[str, str]]:
    """Yield what examples in pages import from the package, with the page."""
    for file in [*sorted(DOCS.rglob("*.md")), DOCS.parent / "README.md"]:
        # Pages on extending the package speak to those who know its inside.
        if file.name.startswith("add_"):
            continue
        for block in re.findall(r"^```python\n(.*?)^```", file.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "scenetruth":
                    yield from ((file.name, f"{node.module}.{alias.name}") for alias in node.names)


def test_what_examples_import_is_documented() -> None:
    last_parts = {name.rsplit(".", 1)[1] for name in NAMES}
    seen = list(imported_in_pages())
    assert len(seen) > 10
    assert [one for one in seen if one[1].rsplit(".", 1)[1] not in last_parts] == []


def test_examples_in_pages_use_names_that_exist() -> None:
    for file in [*sorted(DOCS.rglob("*.md")), DOCS.parent / "README.md"]:
        for block in re.findall(r"^```python\n(.*?)^```", file.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "st":
                    assert hasattr(scenetruth, node.attr), f"{file.name}: st.{node.attr}"


def test_pages_show_each_generated_part_once() -> None:
    shown = Counter(part for file in DOCS.rglob("*.md") for part in generated_parts(file.read_text(encoding="utf-8")))
    made = {"commands", *(f"api {page}" for page in API)}
    made |= {f"{file} {page}" for file in DESCRIBED for page in pages_of_file(file)}
    assert shown == Counter(made)


@pytest.mark.parametrize("page", API)
def test_pages_of_names_hold_directives_for_each(page: str) -> None:
    text = api_in_markdown(page)
    for names in API[page].values():
        for name in names:
            assert re.search(
                rf"^\.\. auto(function|class|exception|data):: {name}(\(\*\*fields\))?$", text, re.MULTILINE
            ), name


def test_every_command_and_option_is_described() -> None:
    text = commands_in_markdown(app, "scenetruth")
    names = command_names(app, "scenetruth")
    assert re.findall(r"^###? (scenetruth.*)$", text, re.MULTILINE) == names

    def options_of(command: object, words: tuple[str, ...]) -> Iterator[str]:
        for one in command.params:  # type: ignore[attr-defined]
            if one.param_type_name == "option" and not one.hidden:
                yield f"{{#{'-'.join(('command', *words))}{max(one.opts, key=len)}}}"
        for word, inner in getattr(command, "commands", {}).items():
            yield from options_of(inner, (*words, word))

    anchors = list(options_of(typer.main.get_command(app), ()))
    assert len(anchors) > 100
    assert [one for one in anchors if one not in text and "#command--" not in one] == []


@pytest.mark.parametrize("file", DESCRIBED)
def test_every_field_of_every_model_is_described_once(file: str) -> None:
    models = models_of(DESCRIBED[file].schema())
    pages = pages_of_file(file)
    assert sorted(name for page in pages.values() for name in page) == sorted(models)
    text = "".join(page_in_markdown(file, page) for page in pages)
    anchors = Counter(re.findall(rf"\{{#({file}-[a-z0-9-]+)\}}|^\(({file}-[a-z0-9-]+)\)=", text, re.MULTILINE))
    assert set(anchors.values()) == {1}
    told = {first or second for first, second in anchors}
    for model in models.values():
        assert anchor_of(file, model.name) in told
        fields = [one.name for one in model.fields if not (model.selector and one.name == model.selector[0])]
        assert {anchor_of(file, model.name, name) for name in fields} <= told
    # Whatever is linked is there.
    assert set(re.findall(rf"\(#({file}-[a-z0-9-]+)\)", text)) <= told


def test_the_schema_has_no_model_that_is_not_described() -> None:
    for described in DESCRIBED.values():
        schema = described.schema()
        names = {name for name, node in schema.get("$defs", {}).items() if "properties" in node}
        assert names <= set(models_of(schema))


@pytest.mark.parametrize(
    ("file", "model"), [("scene", Scene), ("recipe", Recipe), ("design", DesignSpec), ("capture", Capture)]
)
def test_examples_are_valid_and_show_every_model(file: str, model: type[BaseModel]) -> None:
    source = DOCS / "reference" / "examples" / f"{file}.yaml"
    documents = list(yaml.safe_load_all(source.read_text(encoding="utf-8")))
    for document in documents:
        model.model_validate(document)
    schema = DESCRIBED[file].schema()
    shown = examples_in([*sorted(DOCS.parent.glob(DESCRIBED[file].examples)), source], schema)
    assert set(models_of(schema)) - set(shown.of_models) == set()


def test_every_field_says_what_it_means() -> None:
    silent = [
        f"{file}: {model.name}.{one.name}"
        for file, described in DESCRIBED.items()
        for model in models_of(described.schema()).values()
        for one in model.fields
        if not (one.node.get("description") or (model.selector and one.name == model.selector[0]))
    ]
    assert silent == []
