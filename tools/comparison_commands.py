"""Runs of the command line: exit codes, printed text, and the files that commands write."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from comparison_adapter import api
from comparison_records import Records
from comparison_renames import Renames

__all__ = ["record_commands"]

_SMALL = (
    "--set camera.width=64 --set camera.height=48 --set camera.focal_length_px=320 --set frames.count=2 "
    "--set stage.positions=3 --set render.backend=raycast --set score.interior_margin_px=3"
)
_COMMANDS: dict[str, tuple[str, ...]] = {
    "check": (f"check leaf {_SMALL}",),
    "check of a scene with errors": ("check broken.yaml",),
    "run": (f"run leaf -o run {_SMALL} --images png --truth all --ideal --figures depth",),
    "run again": (f"run leaf -o run {_SMALL}",),
    "render": (f"render cube -o steps {_SMALL} --truth-content complete --truth-poses nominal",),
    "estimate": (
        "estimate steps --method structure_tensor --setting window_sigma_px=4",
        "estimate steps --method structure_tensor --set estimate.window_sigma_px=4",
    ),
    "estimate by another method": ("estimate steps --method plane_sweep",),
    "score": ("score steps --set score.interior_margin_px=2",),
    "report": ("report steps --figures depth --figures-format pdf",),
    "verify": ("verify steps",),
    "methods": ("list methods", "methods"),
    "scenes": ("list scenes", "scenes"),
    "schema": ("schema",),
    "dataset schema": ("schema recipe", "dataset schema"),
    "export list": ("list formats", "export --list"),
    "export": ("export steps --format flo -o flo --flow instantaneous",),
    "export of an estimate": ("export steps --format npz -o npz --method plane_sweep --set compress=false",),
    "export of a pair": ("export run --format pfm -o pfm --left -1",),
    "compare list": ("list cases", "compare --list"),
    "compare": ("compare structure_tensor -o compared --case noise --value 0.02 --workers 1",),
    "init": ("init first.yaml --kind leaf",),
    "dataset check": ("dataset check recipe.yaml",),
    "dataset run": ("dataset run recipe.yaml -o samples",),
    "dataset status": ("dataset status samples",),
    "dataset estimate": ("dataset estimate samples --method structure_tensor --set window_sigma_px=4",),
    "dataset verify": ("verify samples --regenerate 1", "dataset verify samples --again 1"),
    "dataset sample": ("dataset sample recipe.yaml 1 -o sample",),
    "dataset card": ("dataset card samples",),
    "design predict": (
        f"design predict cube -o predicted {_SMALL} --model maps",
        f"design predict cube -o predicted {_SMALL} --level bound",
    ),
    "design budget": (
        "design budget wall.yaml -o budget --method structure_tensor --draws 1 --confirm 0.5 --workers 1",
    ),
    "design sweep": ("design sweep wall.yaml -o sweep --vary stage.baseline_mm=2,4 --seeds 1 --workers 1",),
    "design optimise": ("design optimise goal.yaml -o optimised --workers 1",),
    "design pattern": ("design pattern --focal-length-px 2500 --distance-mm 500 -o pattern --size-mm 20x20 --seed 1",),
    "unknown option": ("run leaf --nothing",),
    "unknown scene": ("run leef -o nothing",),
}
"""Label to the command line; they run in this order, in one folder. Of several lines, the first one whose command and
options exist is taken."""
_PROGRESS = re.compile(r"\d:\d\d:\d\d|-:--:--|\.py:\d+: |^  \w+\(.*\)$|^ *compil|^after \d")
_AMOUNT = re.compile(r"(?<![\w.])\d[\d.,]*(?= ?(s|ms|min|h|kB|MB|GB|bytes)\b)")


def record_commands(records: Records, renames: Renames, work: Path, inputs: dict[str, Any]) -> None:
    """Record what commands do.

    Parameters
    ----------
    records
        Where results go.
    renames
        The table of renamed names: commands and options are mapped where the checkout has the new ones.
    work
        The folder in which they run.
    inputs
        Input files by name: plain values in the names of the checkout.
    """
    import typer
    from typer.testing import CliRunner

    for name, plain in inputs.items():
        (work / name).write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
    app = api("app")
    group, runner = typer.main.get_command(app), CliRunner()
    there: dict[Path, bytes] = {}
    with contextlib.chdir(work):
        for label, lines in _COMMANDS.items():
            key = f"runs / {label}"
            forms = [_renamed(shlex.split(line), group, renames) for line in lines]
            words = next((form for form, known in forms if known), forms[0][0])
            found = runner.invoke(app, words, prog_name="scenetruth")
            error = found.exception
            code: Any = found.exit_code
            if error is not None and not isinstance(error, SystemExit):
                code = type(error).__name__
                records.prose(f"{key} / error", str(error))
            records.put(f"{key} / exit", code)
            records.prose(f"{key} / text", list(_lines(found.output)))
            for file, data in _new_files(Path(), there):
                if not any(re.fullmatch(r"[0-9a-f]{16}", part.split(".")[0]) for part in file.parts):
                    records.file(f"{key} / files:{file.as_posix()}", file.name, data)


def _lines(text: str) -> Iterator[str]:
    """Give what is printed but progress, which depends on time, and lines of the source that warned."""
    if text.startswith("{"):
        return  # a JSON Schema, which has a part of its own
    for line in text.splitlines():
        if not _PROGRESS.search(line):
            yield _AMOUNT.sub("N", line.rstrip())


def _new_files(folder: Path, there: dict[Path, bytes]) -> Iterator[tuple[Path, bytes]]:
    """Give files that are new or have changed."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and there.get(path) != (data := path.read_bytes()):
            there[path] = data
            yield path, data


def _renamed(words: list[str], group: Any, renames: Renames) -> tuple[list[str], bool]:
    """Return a command line in the names that the checkout has, and whether its command and options exist."""
    depth = 2 if words[0] in ("dataset", "design", "experiment") and len(words) > 1 else 1
    old = " ".join(words[:depth])
    for name in dict.fromkeys([old, *renames.names("commands", old)]):
        command = group
        for part in name.split(" "):
            command = getattr(command, "commands", {}).get(part)
        if command is None:
            continue
        known = {one for each in command.params for one in (*each.opts, *each.secondary_opts)}
        rest = []
        for word in words[depth:]:
            choices = [word, *renames.names("options", word, [old])] if word.startswith("--") else [word]
            rest.append(next((one for one in choices if one in known), word))
        takes_words = any(each.param_type_name == "argument" for each in command.params)
        fits = takes_words or not rest or rest[0].startswith("-")
        if fits and all(one in known for one in rest if one.startswith("--")):
            return [*name.split(" "), *rest], True
    return words, False
