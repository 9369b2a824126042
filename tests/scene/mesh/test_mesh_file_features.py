"""Features of mesh files and pictures are read as their numbers say, or rejected with a reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.helpers.file_features import FileFeature, try_feature
from tests.helpers.gltf_features import GLTF_FEATURES
from tests.helpers.picture_features import PICTURE_FEATURES
from tests.helpers.polygon_features import POLYGON_FEATURES

FEATURES = (*POLYGON_FEATURES, *GLTF_FEATURES, *PICTURE_FEATURES)


@pytest.mark.parametrize("feature", FEATURES, ids=lambda feature: feature.label)
def test_features_are_read_right_or_rejected_with_a_reason(feature: FileFeature) -> None:
    assert feature.rejected or feature.area is not None
    assert try_feature(feature).wrong == []


def test_the_page_lists_every_feature() -> None:
    page = (Path(__file__).parents[3] / "docs" / "results" / "mesh_files.md").read_text(encoding="utf-8")
    names = [line.split(" | ")[0].removeprefix("| ") for line in page.splitlines() if line.count(" | ") == 3]
    assert [name for name in names if name not in ("feature", "format")][: len(FEATURES)] != []
    assert [feature.name for feature in FEATURES if feature.name not in names] == []


def test_names_differ() -> None:
    assert len({feature.label for feature in FEATURES}) == len(FEATURES)


@pytest.mark.parametrize(
    ("label", "changes", "wrong"),
    [
        ("OBJ: concave polygon", {"area": 4.0}, "area 3, not 4"),
        ("OBJ: triangles", {"polygons": 1}, "2 polygons, not 1"),
        ("MTL: picture", {"shades": (((0.25, 0.75), 0.3),)}, "radiance 0.200000"),
        ("OBJ: index 0", {"rejected": None}, "rejected: "),
        ("OBJ: triangles", {"rejected": "anything"}, "read, not rejected"),
        ("glTF: alphaMode BLEND of an opaque picture", {"of_colours": False, "rejected": None}, "colours rejected: "),
        ("PLY: bytes behind the last face", {"note": "4 bytes"}, "no note of"),
    ],
)
def test_a_wrong_value_is_found(label: str, changes: dict[str, object], wrong: str) -> None:
    (feature,) = (each for each in FEATURES if each.label == label)
    changed = replace(feature, **changes)  # type: ignore[arg-type]
    if "BLEND" in label:
        changed = replace(changed, shades=(((0.5, 0.4), 1.0),))
    assert any(each.startswith(wrong) for each in try_feature(changed).wrong)
