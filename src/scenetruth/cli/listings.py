"""The lists of `scenetruth list`: bundled files, methods, export formats and benchmark cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from scenetruth.cli.bundled_files import DESIGNS, RECIPES, SCENES, BundledFiles

if TYPE_CHECKING:
    from scenetruth.estimators import Estimator

__all__ = ["collect", "print_rows"]

_BUNDLED = {"scenes": SCENES, "recipes": RECIPES, "designs": DESIGNS}
_TITLES = {"methods": "methods", "formats": "export formats", "cases": "benchmark cases"}


def collect(kind: str) -> list[dict[str, Any]]:
    """Return the rows of a list."""
    if kind in _BUNDLED:
        return _bundled_files(_BUNDLED[kind])
    return {"methods": _methods, "formats": _formats, "cases": _cases}[kind]()


def print_rows(kind: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the rows of a list as a table."""
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.errors import visible

    bundled = _BUNDLED.get(kind)
    title = _TITLES[kind] if bundled is None else f"{kind}: {bundled.call('NAME')}"
    columns = [name for name in (rows[0] if rows else ()) if name != "file"]
    table = Table(title=title, title_justify="left")
    for name in columns:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*(visible(_cell(row[name])) for name in columns))
    make_console().print(table)
    if bundled is not None:
        from scenetruth.input_files import bundled_folder

        folder = bundled_folder()
        print(f"files: {visible(str(folder / bundled.folder if folder else ''))}")


def _cell(value: Any) -> str:
    if isinstance(value, Mapping):
        value = [f"{name}={default}" for name, default in value.items()]
    text = ", ".join(map(str, value)) if isinstance(value, Sequence) and not isinstance(value, str) else str(value)
    return text or "–"


def _bundled_files(files: BundledFiles) -> list[dict[str, Any]]:
    import yaml

    from scenetruth.errors import StoreError
    from scenetruth.input_files import bundled_folder

    if bundled_folder() is None:
        raise StoreError("scenes", "are missing; install scenetruth again")
    rows = []
    for name, file in files.files().items():
        plain = yaml.load(file.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        description = " ".join(str(plain.get("description") or plain.get("title", "")).split())
        rows.append({"name": name, "description": description, "size": _size(plain), "file": str(file)})
    return rows


def _size(plain: Mapping[str, Any]) -> str:
    if "camera" in plain:
        camera, stage = plain["camera"], plain["stage"]
        across = stage.get("positions") or len(stage.get("positions_mm") or [0])
        images = across * stage.get("rows", 1) * plain["frames"]["count"]
        return f"{images} images of {camera['width']} x {camera['height']} px"
    if "samples" in plain:
        # As `Recipe.count`: every draw and all steps of its paired series.
        steps = 1 + sum(len(values) for values in (plain.get("paired_factors") or {}).values())
        return f"{plain['samples'] * steps:,} scenes"
    return f"{len(plain['variables'])} variables" if "variables" in plain else ""


def _methods() -> list[dict[str, Any]]:
    from scenetruth.errors import EstimateError
    from scenetruth.estimators import find_method, list_methods

    rows: list[dict[str, Any]] = []
    for entry in list_methods():
        try:
            if entry.problem:
                raise ValueError(entry.problem)
            method = find_method(entry.name)
        except (EstimateError, ValueError) as error:
            problems = getattr(error, "problems", ())
            reason = "; ".join(problem.message for problem in problems) or str(error)
            row = {"name": entry.name, "returns": [], "requires": f"cannot be used: {reason}", "origin": entry.origin}
        else:
            requires = "; ".join([str(method.needs), *_missing_packages(method)])
            row = {"name": entry.name, "returns": sorted(method.gives), "requires": requires, "origin": entry.origin}
        rows.append(row)
    return rows


def _missing_packages(method: Estimator) -> list[str]:
    import numpy as np

    from scenetruth.schema import make_recording

    needs = method.needs
    try:
        images = np.zeros((max(needs.cameras, 3), max(needs.frames, 3), 64, 64), dtype=np.uint8)
        problems = method.requirements(make_recording(images, 100.0, 5.0), method.settings())
    except Exception:  # settings without a default, or a bug of a plugin: estimation reports it
        return []
    return [f"cannot be used: {problem.message}" for problem in problems if problem.path == "method"]


def _formats() -> list[dict[str, Any]]:
    from scenetruth.exporters import load_formats

    return [
        {
            "name": kind,
            "writes": model.summary,
            "options": {name: str(field.default) for name, field in model.model_fields.items() if name != "kind"},
            "requires": list(model.packages),
        }
        for kind, model in load_formats().items()
    ]


def _cases() -> list[dict[str, Any]]:
    from scenetruth.benchmark.cases.case import all_cases

    rows = []
    for case in all_cases().values():
        suite = "core" if case.core else "full"
        levels = [str(case.get_label(value)) for value in case.values(suite)]
        rows.append(
            {
                "name": case.kind,
                "question": case.question,
                "factor": case.varied,
                "levels": levels or case.lacks(),
                "suite": suite,
            }
        )
    return rows
