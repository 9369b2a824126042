"""The interface of a checkout: names that can be imported, commands and options, lists, JSON Schemas."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterator, Mapping
from enum import Enum
from importlib import import_module, util
from pathlib import Path
from typing import Any

from comparison_adapter import api, member
from comparison_records import Records

__all__ = ["record_help", "record_lists", "record_names", "record_schemas"]

_PROSE = ("title", "description")
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def record_names(records: Records, checkout: Path) -> None:
    """Record the public names of scenetruth and those that the reference documents."""
    import scenetruth

    for name in sorted(scenetruth.__all__):
        _thing(records, f"names / public names:{name}", getattr(scenetruth, name))
    for module, names in _documented(checkout):
        for name in names:
            try:
                thing = getattr(import_module(module), name)
            except (ImportError, AttributeError) as error:
                records.put(f"names / documented / public names:{name} / missing", f"{module}: {error}")
                continue
            key = f"names / documented / public names:{name}"
            if module != "scenetruth":
                _thing(records, key, thing)
            records.put(f"{key} / module", module)


def _documented(checkout: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    file = checkout / "docs" / "_ext" / "scenetruth_site" / "api.py"
    spec = util.spec_from_file_location("documented_names", file)
    if spec is None or spec.loader is None or not file.exists():
        return
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for modules in module.API.values():
        yield from modules.items()


def _thing(records: Records, key: str, thing: Any) -> None:
    from pydantic import BaseModel

    model: Any = thing
    if inspect.isclass(thing):
        records.put(f"{key} / sort", "exception" if issubclass(thing, BaseException) else "class")
        base = next((one for one in (BaseModel, BaseException, object) if issubclass(thing, one)), object)
        known = set(dir(base))
        if base is not BaseModel:
            _arguments(records, key, thing)
        members = {name for name in dir(thing) if not name.startswith("_") and name not in known}
        members |= set(getattr(thing, "__dataclass_fields__", {}))
        members |= set(model.model_fields) if base is BaseModel else set()
        for name in sorted(members):
            member = inspect.getattr_static(thing, name, None)
            records.put(f"{key} / public names:{name} / sort", type(member).__name__ if member is not None else "field")
            if inspect.isfunction(member):
                _arguments(records, f"{key} / public names:{name}", member)
    elif callable(thing):
        records.put(f"{key} / sort", "function")
        _arguments(records, key, thing)
    else:
        records.flat(f"{key} / value", thing)


def _arguments(records: Records, key: str, function: Any) -> None:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return
    for place, one in enumerate(parameters):
        default = "required" if one.default is one.empty else one.default
        if not isinstance(default, str | bool | int | float | None):
            default = _ADDRESS.sub("", repr(default))
        where = f"{key} / arguments:{one.name}"
        records.put(where, {"place": place, "kind": one.kind.description, "default": default})


def record_help(records: Records) -> None:
    """Record every command with its options, and the text of every help page."""
    import typer
    from typer.testing import CliRunner

    app = api("app")
    runner = CliRunner()
    for path, command in _commands(typer.main.get_command(app), ()):
        key = f"help / commands:{' '.join(path) or 'scenetruth'}"
        records.put(f"{key} / hidden", bool(getattr(command, "hidden", False)))
        arguments = 0
        for one in command.params:
            if one.param_type_name == "argument":
                where, arguments = f"{key} / argument {arguments}", arguments + 1
            else:
                where = f"{key} / options:{_longest(one.opts)}"
            for name, value in _of_option(one).items():
                records.put(f"{where} / {name}", value)
            records.prose(f"{where} / metavar", getattr(one, "metavar", None))
            records.prose(f"{where} / help", getattr(one, "help", None))
        found = runner.invoke(app, [*path, "--help"], prog_name="scenetruth")
        records.prose(f"{key} / text", [line.rstrip() for line in found.output.splitlines()])
        if found.exit_code:
            records.put(f"{key} / exit code", found.exit_code)


def _commands(command: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    yield path, command
    for name, one in getattr(command, "commands", {}).items():
        yield from _commands(one, (*path, name))


def _longest(names: list[str]) -> str:
    return next((name for name in names if name.startswith("--")), names[0])


def _of_option(option: Any) -> dict[str, Any]:
    """Return what matters of an option or an argument but its name and its words."""
    # Older releases of Typer have types of click; newer ones keep the annotation.
    kind = getattr(option, "type", None)
    annotation = getattr(getattr(option, "type_descriptor", None), "annotation", None)
    found: dict[str, Any] = {}
    if kind is not None:
        found["type"] = getattr(kind, "name", type(kind).__name__)
        choices = getattr(kind, "choices", None)
    elif inspect.isclass(annotation) and issubclass(annotation, Enum):
        found["type"], choices = "choice", list(annotation)
    else:
        found["type"], choices = getattr(annotation, "__name__", str(annotation)), None
    if choices is not None:
        found["choices"] = [getattr(one, "value", one) for one in choices]
    for name in ("min", "max"):
        if (bound := getattr(kind, name, getattr(option, name, None))) is not None:
            found[name] = bound
    default = option.default() if callable(option.default) else option.default
    found["default"] = None if type(default) is object else getattr(default, "value", default)
    for name in ("required", "multiple", "nargs", "is_flag", "hidden", "envvar"):
        if hasattr(option, name):
            found[name] = getattr(option, name)
    main = _longest(option.opts)
    if option.param_type_name == "option":
        found["other names"] = [name for name in (*option.opts, *option.secondary_opts) if name != main]
    return found


def record_lists(records: Records, checkout: Path) -> None:
    """Record what can be chosen: methods, quantities, formats, cases, checks, figures, bundled files, extras."""
    for entry in api("list_methods")():
        name = member(entry, "name")
        key = f"lists / methods:{name}"
        records.put(f"{key} / origin", member(entry, "origin"))
        method = api("find_method")(name)
        records.put(f"{key} / gives", sorted(member(method, "gives", "outputs")))
        records.flat(f"{key} / needs", member(method, "needs"))
        records.prose(f"{key} / needs", str(member(method, "needs")))
    records.flat("lists / quantities", api("quantities"), ("quantities",))
    for number, figure in enumerate(api("figures")):
        records.put(f"lists / figures / files:{getattr(figure, 'name', figure)}", number)
    for name, text in api("export_formats")().items():
        records.put(f"lists / formats:{name}", True)
        records.prose(f"lists / formats:{name}", str(text))
    for place, (name, case) in enumerate(api("cases")().items()):
        key = f"lists / cases:{name}"
        records.put(f"{key} / place", place)
        for suite in ("core", "full"):
            levels = member(case, "values", "levels")(suite)
            records.put(f"{key} / {suite}", [member(case, "label_of", "get_label")(level) for level in levels])
            records.put(f"{key} / {suite} seeds", member(case, "seeds")[suite])
        records.put(f"{key} / quantities", list(member(case, "quantities")))
        for word in ("title", "question", "varied"):
            records.prose(f"{key} / {word}", getattr(case, word, None))
    bundled = api("bundled_files")
    for folders in ((".",), ("datasets", "recipes"), ("goals", "designs")):
        files: dict[str, Path] = next(filter(None, (bundled(one) for one in folders)), {})
        records.put(f"lists / bundled {folders[0]}", sorted(files))
    for file in sorted((checkout / "scenes").rglob("*.yaml")):
        name = file.relative_to(checkout).as_posix()
        records.file(f"lists / bundled / files:{name}", file.name, file.read_bytes())
    for name in ("structure_tensor", "plane_sweep"):
        checks = api("estimator_checks")(name)
        records.put(f"lists / methods:{name} / checks", [str(check) for check in checks])
    project = tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name in ("scripts", "entry-points"):
        records.flat(f"lists / project / {name}", project.get(name, {}))
    records.put("lists / project / extras", sorted(project.get("optional-dependencies", {})))


def record_schemas(records: Records) -> None:
    """Record the structure of all JSON Schemas by the paths of their fields; titles and descriptions as prose."""
    models = {"scene": api("Scene"), "recipe": api("Recipe"), "goal": api("Goal")}
    for name, model in models.items():
        _schema(records, f"schemas / {name}", model.model_json_schema())
    for entry in api("list_methods")():
        name = member(entry, "name")
        _schema(records, f"schemas / methods:{name}", member(api("find_method")(name), "settings").model_json_schema())
    for name, model in api("format_models")().items():
        model = model if inspect.isclass(model) else type(model)
        if hasattr(model, "model_json_schema"):
            _schema(records, f"schemas / formats:{name}", model.model_json_schema())


def _schema(records: Records, key: str, schema: Mapping[str, Any]) -> None:
    definitions = schema.get("$defs", {})
    _part(records, key, {name: one for name, one in schema.items() if name != "$defs"}, definitions, ())


def _part(
    records: Records, key: str, part: Mapping[str, Any], definitions: Mapping[str, Any], above: tuple[str, ...]
) -> None:
    """Record a part of a schema; what a reference names is put in its place, once on every path."""
    if "$ref" in part:
        name = str(part["$ref"]).rpartition("/")[2]
        more = {other: value for other, value in part.items() if other != "$ref"}
        if name in above:
            records.put(f"{key} / recursion", len(above) - above.index(name))
            return
        part, above = {**definitions[name], **more}, (*above, name)
    for name, value in part.items():
        if name in _PROSE and isinstance(value, str):
            records.prose(f"{key} / {name}", value)
        elif name == "properties":
            for field, one in value.items():
                _part(records, f"{key} / fields:{field}", one, definitions, above)
        elif name == "patternProperties":
            for number, one in enumerate(value.values()):
                _part(records, f"{key} / {name} / {number}", one, definitions, above)
        elif name in ("items", "additionalProperties") and isinstance(value, Mapping):
            _part(records, f"{key} / {name}", value, definitions, above)
        elif name in ("anyOf", "oneOf", "allOf", "prefixItems"):
            for number, one in enumerate(value):
                _part(records, f"{key} / {name} / {_label(one, definitions, number)}", one, definitions, above)
        elif name == "discriminator":
            records.put(f"{key} / discriminator", value["propertyName"])
        elif name == "required":
            for field in value:
                records.put(f"{key} / fields:{field} / required", True)
        elif name == "default" and isinstance(value, Mapping):
            records.flat(f"{key} / default", value)
        else:
            records.put(f"{key} / {name}", value)


def _label(part: Any, definitions: Mapping[str, Any], number: int) -> str:
    """Return what one alternative of several is called: its kind if it has one, else its number."""
    if isinstance(part, Mapping) and "$ref" in part:
        found = definitions[str(part["$ref"]).rpartition("/")[2]].get("properties", {})
        for name in ("kind", "type", "method"):
            if "const" in found.get(name, {}):
                return f"kinds:{found[name]['const']}"
    return str(number)
