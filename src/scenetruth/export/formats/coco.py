"""Instance masks of every frame as COCO's JSON, with the images.

``images/s+0_t+0.png`` and ``annotations.json``: one annotation for every object that an image shows, with
``segmentation`` as run lengths (uncompressed: ``counts`` of pixels outside and inside in turn, down the columns, from
the left one on; ``size`` is height, width), ``area`` in pixels, ``bbox`` (left, top, width, height) from edge to edge
of the pixels, ``iscrowd`` 0. A pixel belongs to the object at its centre. Categories are the names of the objects (of
``plant/leaf-1``, the supercategory is ``plant``); ``category_id`` counts them from 1, as COCO keeps 0 for the
background, and ``object_id`` is the truth's, from 0. Masks end where something nearer begins: they are visible parts.
Lost: depth, motion, shares of pixels.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.export.base import PictureOptions
from scenetruth.export.raster import image_name, write_picture
from scenetruth.export.source import Source
from scenetruth.schema import object_names_of

__all__ = ["Coco"]


class Coco(PictureOptions):
    """Instance masks as COCO's JSON."""

    kind: Literal["coco"] = "coco"
    """Name of the format."""
    summary: ClassVar[str] = "instance masks of every frame as COCO's JSON, with the images"

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing."""
        yield from super().problems(source)
        if "object_id" not in source.maps:
            yield Problem("object_id", "is missing: only a truth tells which object a pixel sees; export the truth")

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write images and masks."""
        height, width = source.size
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        names = object_names_of(source.maps)
        # Objects of one name are instances of one category; those without a name have their number.
        categories: dict[str, int] = {}
        for s in source.views:
            for t in source.frames:
                name = f"{image_name(s, t)}.png"
                write_picture(folder / "images" / name, source.image(s, t), self.image_bits)
                image = {"id": len(images) + 1, "file_name": name, "width": width, "height": height, "s": s, "t": t}
                images.append(image)
                objects = source.raw("object_id", s, t)
                for number in sorted(set(objects[objects >= 0].tolist())):
                    label = names[number] if number < len(names) else f"object {number}"
                    category = categories.setdefault(label, len(categories) + 1)
                    about = {"id": len(annotations) + 1, "image_id": image["id"], "category_id": category}
                    annotations.append({**about, **_annotation(objects == number), "object_id": number})
        told = {
            "info": {"description": "instance masks, made by scenetruth", "version": "1.0"},
            "licenses": [],
            "images": images,
            "annotations": annotations,
            "categories": [_category(label, number) for label, number in categories.items()],
        }
        (folder / "annotations.json").write_text(json.dumps(told, ensure_ascii=False), encoding="utf-8")
        return [f"{len(annotations)} masks in {len(images)} images"]


def _category(label: str, number: int) -> dict[str, Any]:
    # Parts of a plant are named plant/part.
    whole, slash, _ = label.partition("/")
    return {"id": number, "name": label, "supercategory": whole if slash else "object"}


def _annotation(mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.nonzero(mask)
    left, top = int(columns.min()), int(rows.min())
    box = [left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1]
    return {
        "segmentation": {"counts": _run_lengths(mask), "size": list(mask.shape)},
        "area": len(rows),
        "bbox": box,
        "iscrowd": 0,
    }


def _run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Return lengths of runs down the columns, the first one outside of the mask."""
    flat = np.concatenate([[False], mask.ravel(order="F")])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    return [int(length) for length in np.diff(np.concatenate([[0], ends, [mask.size]]))]
