from __future__ import annotations

import json

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from tests.export.conftest import Export
from tests.export.readers import decode_runs


def test_masks_are_the_objects(export: Export, truth: xr.Dataset) -> None:
    done = export("coco")
    told = json.loads((done.folder / "annotations.json").read_text())
    assert told["categories"] == [
        {"id": 1, "name": "wall", "supercategory": "object"},
        {"id": 2, "name": "tile", "supercategory": "object"},
    ]
    images = {image["id"]: image for image in told["images"]}
    assert len(images) == 9
    assert len({annotation["id"] for annotation in told["annotations"]}) == len(told["annotations"]) == 18
    covered = {number: np.zeros((48, 64), dtype=int) for number in images}
    for annotation in told["annotations"]:
        image = images[annotation["image_id"]]
        mask = decode_runs(**annotation["segmentation"])
        expected = truth.object_id.sel(s=image["s"], t=image["t"]).values == annotation["category_id"] - 1
        np.testing.assert_array_equal(mask, expected)
        assert sum(annotation["segmentation"]["counts"]) == 48 * 64
        assert annotation["area"] == mask.sum()
        left, top, width, height = annotation["bbox"]
        assert mask[top : top + height, left : left + width].sum() == mask.sum()
        assert mask[top].any()
        assert mask[top + height - 1].any()
        assert mask[:, left].any()
        assert mask[:, left + width - 1].any()
        assert annotation["iscrowd"] == 0
        covered[annotation["image_id"]] += mask
    for number, image in images.items():
        np.testing.assert_array_equal(covered[number], truth.object_id.sel(s=image["s"], t=image["t"]) >= 0)
        assert imageio.imread(done.folder / "images" / image["file_name"]).shape == (48, 64)


def test_run_lengths_begin_outside() -> None:
    from scenetruth.exporters.benchmark_formats import _run_lengths

    for text in ("0110/0010", "1000/1001", "1111/1111"):
        mask = np.array([[letter == "1" for letter in row] for row in text.split("/")])
        np.testing.assert_array_equal(decode_runs(_run_lengths(mask), [2, 4]), mask)
    assert _run_lengths(np.ones((2, 2), dtype=bool)) == [0, 4]


def test_parts_of_a_plant_have_it_as_supercategory(recording: xr.Dataset, truth: xr.Dataset, tmp_path: str) -> None:
    named = truth.assign_attrs(object_names='["plant/leaf-1", "plant/leaf-1"]')
    done = st.export((recording, named), "coco", output=f"{tmp_path}/x")
    told = json.loads((done.folder / "annotations.json").read_text())
    assert told["categories"] == [{"id": 1, "name": "plant/leaf-1", "supercategory": "plant"}]
    # Two objects of one name are two instances.
    assert {annotation["object_id"] for annotation in told["annotations"]} == {0, 1}


def test_estimates_know_no_objects(recording: xr.Dataset, tmp_path: str) -> None:
    estimate = st.make_estimate(depth=np.full((3, 48, 64), 90.0), recording=recording)
    with pytest.raises(st.ExportError, match="object_id: is missing: only a truth contains"):
        st.export((recording, estimate), "coco", output=f"{tmp_path}/x")
