"""Single bits of the files of a data set that are flipped, and everything that is read from it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import scenetruth as st
from scenetruth.dataset.generation import read_status
from scenetruth.dataset.layout import DatasetFolder

__all__ = ["flipped_bit", "read_everything", "select_bits"]


def select_bits(folder: Path, count: int, seed: int) -> list[tuple[Path, int]]:
    """Return random bits: a file, each as likely as the others, and a bit of it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.stat().st_size)
    generator = np.random.default_rng(seed)
    chosen = [files[int(generator.integers(len(files)))] for _ in range(count)]
    return [(file, int(generator.integers(8 * file.stat().st_size))) for file in chosen]


@contextmanager
def flipped_bit(file: Path, place: int) -> Iterator[None]:
    """Flip one bit of a file while the block runs."""
    former = file.read_bytes()
    changed = bytearray(former)
    changed[place // 8] ^= 1 << place % 8
    file.write_bytes(bytes(changed))
    try:
        yield
    finally:
        file.write_bytes(former)


def read_everything(folder: Path) -> list[Any]:
    """Return all values that a data set states, by the public functions that read it."""
    places = DatasetFolder(folder)
    dataset = st.open_dataset(folder)
    status = read_status(folder)
    found: list[Any] = [dataset.identity, dataset.catalogue.to_json(double_precision=15), status]
    found.append(st.load_recipe(places.recipe).to_dict())
    for sample in dataset:
        found += [sample.values, sample.scene.to_dict()]
        stores = [sample.recording, sample.truth]
        if sample.shard is None:
            record = json.loads((places.sample(sample.number) / "sample.json").read_text(encoding="utf-8"))
            found.append(record)
            stores += [st.open_store(path) for path in places.sample(sample.number).glob("estimate*")]
            found += [path.read_bytes() for path in sorted(places.sample(sample.number).glob("score.[jc]s*"))]
        for store in stores:
            found.append({name: str(value) for name, value in store.attrs.items()})
            found.append({name: (one.dims, one.dtype, one.values.tobytes()) for name, one in store.variables.items()})
    found += [path.read_bytes() for path in (places.card, places.card_text, places.croissant) if path.exists()]
    found += [json.loads(path.read_text(encoding="utf-8")) for path in sorted(places.failed.glob("*.json"))]
    found += [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("scores/*/*/*.json"))]
    return found
