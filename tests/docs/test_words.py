"""Types, ranges, defaults, units and examples of fields, and commands, on small cases of their own."""

from __future__ import annotations

import doctest
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import typer
from pydantic import BaseModel, Field

from scenetruth_site.commands import commands_in_markdown
from scenetruth_site.field_words import default_of, range_of, type_of
from scenetruth_site.file_examples import examples_in
from scenetruth_site.file_models import models_of
from scenetruth_site.file_pages import models_in_markdown, page_of


class Ball(BaseModel):
    """A round one.

    See Also
    --------
    Brick : An edged one.
    """

    kind: Literal["ball"]
    radius_mm: Annotated[float, Field(gt=0, description="Its radius.")]


class Brick(BaseModel):
    """An edged one."""

    kind: Literal["brick"]
    size_mm: tuple[float, float, float]


class Box(BaseModel):
    """What is given."""

    things: Annotated[list[Annotated[Ball | Brick, Field(discriminator="kind")]], Field(min_length=1)]
    share: Annotated[float, Field(ge=0, le=1)] = 0.5
    mode: Literal["one", "two"] | None = None
    names: dict[str, Ball] = Field(default_factory=dict)
    first: Ball = Ball(kind="ball", radius_mm=3)


SCHEMA: dict[str, Any] = Box.model_json_schema()
FIELDS: dict[str, Any] = SCHEMA["properties"]


def test_types_ranges_and_defaults_in_words() -> None:
    words = {name: (type_of(node, "box", SCHEMA), range_of(node), default_of(node)) for name, node in FIELDS.items()}
    assert words["things"][:2] == ("list of [`ball`](#box-ball) or [`brick`](#box-brick)", "at least 1 items")
    assert words["share"] == ("number", "0 to 1", "`0.5`")
    assert words["mode"] == ("`one` or `two`", "", "not given")
    assert words["names"] == ("mapping of names to [`ball`](#box-ball)", "", "empty")
    assert words["first"][2] == "that of each of its fields"


def test_models_are_found_with_their_places() -> None:
    models = models_of(SCHEMA)
    assert list(models) == ["Box", "Ball", "Brick"]
    assert models["Ball"].paths == ["first", "names.NAME", "things[]"]
    assert models["Ball"].selector == ("kind", "ball")
    assert models["Ball"].description == "A round one."
    rooms = {"": "all", "first": "balls", "things": "bricks", "things[].size_mm": "never"}
    assert [page_of(one, rooms) for one in models.values()] == ["all", "balls", "bricks"]


def test_sections_hold_examples_from_files(tmp_path: Path) -> None:
    file = tmp_path / "one.yaml"
    file.write_text("things: [{kind: brick, size_mm: [1, 2, 3]}, {kind: ball, radius_mm: 7}]\nshare: 0.25\n")
    examples = examples_in([file], SCHEMA)
    assert examples.of_fields["Ball", "radius_mm"] == ("one.yaml", 7)
    assert ("Box", "mode") not in examples.of_fields
    text = models_in_markdown(models_of(SCHEMA), "box", SCHEMA, examples)
    assert "(box-ball)=\n## `kind: ball`\n\nA round one.\n\n*At* `first`, `names.NAME`, `things[]`" in text
    field = (
        "[[`radius_mm`](#box-ball-radius-mm)]{#box-ball-radius-mm}\n: number; mm; > 0; **required**\n\n  Its radius."
    )
    assert field in text
    assert "Example: `share: 0.25` (one.yaml)" in text
    assert "From one.yaml:\n\n```yaml\nkind: brick\nsize_mm: [1, 2, 3]\n```" in text


class Colour(Enum):
    """Colours."""

    red = "red"
    blue = "blue"


def test_commands_in_words() -> None:
    app = typer.Typer(help="All of it.")
    group = typer.Typer(help="Some of it.")

    @app.command()
    def paint(
        what: Annotated[Path, typer.Argument(metavar="FILE", help="What to paint.")],
        colour: Annotated[Colour, typer.Option(help="Which colour.")] = Colour.red,
        coats: Annotated[int, typer.Option("--coats", "-c", help="How often.")] = 2,
        dry: Annotated[bool, typer.Option("--dry/--wet", help="Wait.")] = True,
        quick: Annotated[bool, typer.Option("--quick", help="Hurry.")] = False,
    ) -> None:
        """Paint a thing."""

    @app.command(hidden=True)
    def secret() -> None:
        """Nobody knows."""

    @group.command("inner")
    def inner(words: Annotated[list[str], typer.Argument(help="What to say.")], loud: bool = False) -> None:
        """Say it."""

    app.add_typer(group, name="group")
    text = commands_in_markdown(app, "tool")
    assert "(command-paint)=\n## tool paint\n\nPaint a thing.\n\n```text\ntool paint [OPTIONS] FILE\n```" in text
    assert "`FILE`\n: What to paint." in text
    assert "{#command-paint--colour} `red|blue`\n: Which colour. Default: `red`." in text
    assert (
        "[[`--coats`, `-c`](#command-paint--coats)]{#command-paint--coats} `NUMBER`\n: How often. Default: `2`." in text
    )
    assert "[[`--dry`, `--wet`](#command-paint--dry)]{#command-paint--dry}\n: Wait. Default: `--dry`." in text
    assert "{#command-paint--quick}\n: Hurry.\n" in text
    assert "### tool group inner" in text
    assert "tool group inner [OPTIONS] WORDS..." in text
    assert "secret" not in text


@pytest.mark.parametrize("name", ["units", "file_models", "field_words"])
def test_examples_in_docstrings(name: str) -> None:
    done = doctest.testmod(import_module(f"scenetruth_site.{name}"))
    assert done.attempted > 0
    assert done.failed == 0
