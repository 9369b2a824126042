"""Reference pages of files as Markdown: the models of one part of a file, with all fields."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping

import yaml

from scenetruth_site.field_words import default_of, range_of, type_of, yaml_of
from scenetruth_site.file_examples import FileExamples
from scenetruth_site.file_models import FileModel, ModelField, Schema, anchor_of
from scenetruth_site.units import unit_of

__all__ = ["models_in_markdown", "page_of"]

_LONGEST = 70
"""Maximum length of an example within a line; longer examples appear in the example of the model only."""
_MOST_LINES = 16


def page_of(model: FileModel, pages: Mapping[str, str]) -> str:
    """Return the page that describes a model: that of the longest prefix of its path.

    Parameters
    ----------
    model
        The model.
    pages
        Paths, each with its page; the empty path is the file itself.
    """
    path = model.paths[0]
    starts = [start for start in pages if path == start or path.startswith((f"{start}.", f"{start}["))]
    return pages[max(starts, key=len)] if starts else pages[""]


def models_in_markdown(models: Mapping[str, FileModel], file: str, schema: Schema, examples: FileExamples) -> str:
    """Return a section for every model.

    Parameters
    ----------
    models
        The models, by name.
    file
        The file type, used as the prefix of anchors: ``scene``.
    schema
        The JSON Schema of the whole file.
    examples
        Examples from the bundled files.
    """
    return "\n".join(line for model in models.values() for line in _section(model, file, schema, examples))


def _section(model: FileModel, file: str, schema: Schema, examples: FileExamples) -> Iterator[str]:
    yield f"({anchor_of(file, model.name)})="
    yield f"## {_title(model)}\n"
    if model.description:
        yield f"{model.description}\n"
    paths = [f"`{path}`" for path in model.paths if path]
    if paths:
        more = [f"and {len(paths) - 4} more paths"] if len(paths) > 4 else []
        yield f"*At* {', '.join([*paths[:4], *more])}\n"
    for one in model.fields:
        if not (model.selector and one.name == model.selector[0]):
            yield from _field(model, one, file, schema, examples)
    yield from _example(model, examples)


def _title(model: FileModel) -> str:
    return f"`{model.selector[0]}: {model.selector[1]}`" if model.selector else model.name


def _field(model: FileModel, one: ModelField, file: str, schema: Schema, examples: FileExamples) -> Iterator[str]:
    words = [type_of(one.node, file, schema)]
    words += [text for text in (unit_of(one.name), range_of(one.node)) if text]
    words += [_needed(one)]
    anchor = anchor_of(file, model.name, one.name)
    yield f"[[`{one.name}`](#{anchor})]{{#{anchor}}}"
    yield f": {'; '.join(words)}"
    description = one.node.get("description", "")
    if description:
        yield "\n" + textwrap.indent(description, "  ")
    source, value = examples.of_fields.get((model.name, one.name), ("", None))
    text = yaml_of(value)
    if value is not None and len(text) <= _LONGEST:
        yield f"\n  Example: `{one.name}: {text}`{f' ({source})' if source else ''}"
    yield ""


def _needed(one: ModelField) -> str:
    if not one.required:
        return f"default: {default_of(one.node)}"
    unless = " or ".join(f"`{name}`" for name in one.unless)
    return f"**required**, unless {unless} is given" if unless else "**required**"


def _example(model: FileModel, examples: FileExamples) -> Iterator[str]:
    if model.name not in examples.of_models:
        return
    source, value = examples.of_models[model.name]
    text = "\n".join(_line(name, inner) for name, inner in value.items())
    if len(text.splitlines()) <= _MOST_LINES:
        yield f"{f'From {source}' if source else 'Example'}:\n\n```yaml\n{text}\n```\n"


def _line(name: str, value: object) -> str:
    """Return a key with its value, on one line if it is short."""
    short = yaml_of(value)
    if len(short) <= _LONGEST:
        return f"{name}: {short}"
    flow = None if isinstance(value, list | dict) else False
    text = yaml.safe_dump({name: value}, default_flow_style=flow, width=80, allow_unicode=True, sort_keys=False)
    return text.rstrip()
