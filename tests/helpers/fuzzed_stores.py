"""A strategy that makes stores which are almost right: small ones of every kind, damaged, some of them sealed again."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as some

import scenetruth as st
from scenetruth.storage.store_files import add_checksums, open_store_files
from tests.helpers.fuzzed_scenes import NUMBERS, TEXTS
from tests.helpers.scenes import cube

__all__ = ["KINDS", "Damage", "broken_stores", "damaged", "whole_stores"]

KINDS = ("recording", "truth", "estimate")

Damage = dict[str, Any]
"""What is done to a store, in plain values: its kind, whether it is a zip file, and what is changed, step by step."""

_WORDS = [
    *("zstd", "blosc", "gzip", "crc32c", "numcodecs.pcodec", "sharding_indexed", "bytes", "transpose", "little", "big"),
    *(
        "float64",
        "float32",
        "int8",
        "uint16",
        "complex128",
        "string",
        "object",
        "bool",
        "NaN",
        "Infinity",
        "x",
        "t",
        "s",
    ),
    *("zarr.json", "c/0/0/0", "recording", "truth", "estimate", "..", "group", "array", "default", "v2"),
]
values = some.one_of(
    some.sampled_from([item for item in NUMBERS if not isinstance(item, int) or abs(item) < 10**300]),
    some.sampled_from([*TEXTS, *_WORDS]),
    some.sampled_from([None, [], {}, [1], [0, 0], [2**40, 2**40], {"name": "bytes"}, [[1]], ["s", "t", "y", "x"]]),
)
_share = some.floats(0, 1, exclude_max=True)
# Places are shares, of the number of files, of bytes, of entries: they fit any store.
_bytes = some.one_of(
    some.fixed_dictionaries({"do": some.just("flip"), "file": _share, "at": _share, "bit": some.integers(0, 7)}),
    some.fixed_dictionaries({"do": some.just("cut"), "file": _share, "at": _share}),
    some.fixed_dictionaries(
        {"do": some.just("append"), "file": _share, "text": some.binary(max_size=30).map(bytes.hex)}
    ),
    some.fixed_dictionaries({"do": some.just("zero"), "file": _share, "at": _share, "count": some.integers(1, 200)}),
    some.fixed_dictionaries({"do": some.just("remove"), "file": _share}),
    some.fixed_dictionaries({"do": some.just("swap"), "file": _share, "with": _share}),
    some.fixed_dictionaries({"do": some.just("add"), "name": some.sampled_from(["x", "depth/y", "a/zarr.json"])}),
)
_metadata = some.one_of(
    some.fixed_dictionaries({"do": some.just("set"), "file": _share, "entry": _share, "value": values}),
    some.fixed_dictionaries({"do": some.just("drop"), "file": _share, "entry": _share}),
    some.fixed_dictionaries({"do": some.just("new"), "file": _share, "entry": _share, "value": values}),
)


def broken_stores() -> some.SearchStrategy[Damage]:
    """Return a strategy for damage: to bytes; or to metadata, sealed again so that the seal does not tell."""
    plain = some.fixed_dictionaries(
        {
            "kind": some.sampled_from(KINDS),
            "zipped": some.booleans(),
            "sealed": some.just(False),
            "steps": some.lists(some.one_of(_bytes, _metadata), min_size=1, max_size=3),
        }
    )
    sealed = some.fixed_dictionaries(
        {
            "kind": some.sampled_from(KINDS),
            "zipped": some.just(False),
            "sealed": some.just(True),
            "steps": some.lists(_metadata, min_size=1, max_size=3),
        }
    )
    return some.one_of(plain, sealed)


def whole_stores(folder: Path) -> None:
    """Write the stores that are damaged: one of every kind, as a folder and as a zip file."""
    for kind, dataset in _data().items():
        for suffix in (".zarr", ".zarr.zip"):
            st.save_store(dataset, folder / f"{kind}{suffix}", overwrite=True)


@cache
def _data() -> dict[str, Any]:
    small = {"camera": {"width": 40, "height": 36, "focal_length_px": 600}}
    recording, truth = st.simulate(cube(**small))
    return {"recording": recording, "truth": truth, "estimate": st.estimate(recording, working_point_px=0)}


def damaged(whole: Path, damage: Damage, target: Path) -> None:
    """Make a damaged store.

    Parameters
    ----------
    whole
        Folder of `whole_stores`.
    damage
        What is done.
    target
        The store to make, a folder or a zip file; it must not exist.
    """
    if damage["zipped"]:
        content = (whole / f"{damage['kind']}.zarr.zip").read_bytes()
        target.write_bytes(content)
        for step in damage["steps"]:
            _change_bytes([target], target.parent, {**step, "do": step["do"] if "at" in step else "flip"})
        return
    shutil.copytree(whole / f"{damage['kind']}.zarr", target)
    for step in damage["steps"]:
        files = sorted(file for file in target.rglob("*") if file.is_file())
        if not files:
            return
        if step["do"] in ("set", "drop", "new"):
            _change_metadata([file for file in files if file.name == "zarr.json"], step)
        else:
            _change_bytes(files, target, step)
    root = target / "zarr.json"
    if damage["sealed"] and root.is_file():
        try:
            root.write_bytes(add_checksums(open_store_files(target)))
        except (ValueError, KeyError, TypeError, AttributeError):
            return  # it has no place for a seal any more


def _change_bytes(files: list[Path], folder: Path, step: dict[str, Any]) -> None:
    file = files[int(step.get("file", 0) * len(files))]
    if step["do"] == "add":
        added = folder / step["name"]
        if not added.exists() and not any(parent.is_file() for parent in added.parents):
            added.parent.mkdir(parents=True, exist_ok=True)
            added.write_bytes(b"{}")
        return
    content = bytearray(file.read_bytes())
    at = int(step.get("at", 0) * len(content))
    match step["do"]:
        case "flip" if content:
            content[at] ^= 1 << step.get("bit", 0)
        case "cut":
            del content[at:]
        case "append":
            content += bytes.fromhex(step["text"])
        case "zero":
            content[at : at + step["count"]] = bytes(len(content[at : at + step["count"]]))
        case "remove":
            file.unlink()
            return
        case "swap":
            content = bytearray(files[int(step["with"] * len(files))].read_bytes())
    file.write_bytes(content)


def _change_metadata(files: list[Path], step: dict[str, Any]) -> None:
    if not files:
        return
    file = files[int(step["file"] * len(files))]
    try:
        tree = json.loads(file.read_text())
    except ValueError:
        return
    places = list(_places(tree))
    if not places:
        return
    holder, key = places[int(step["entry"] * len(places))]
    match step["do"]:
        case "set":
            holder[key] = step["value"]
        case "drop":
            del holder[key]
        case "new" if isinstance(holder, dict):
            holder[f"{key}_"] = step["value"]
        case "new":
            holder.insert(key, step["value"])
    file.write_text(json.dumps(tree))


def _places(tree: Any) -> Any:
    """Give every mapping or list in a tree, with each of its keys."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in list(entries):
        yield tree, key
        yield from _places(value)
