"""Design variables in words: no name of a field is left, and every value has its unit."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from scenetruth.design.parameter_words import describe_parameter, label_parameter, title_parameter
from tests.helpers.scenes import SCENES


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("f_number", 2.0, "f-number 2"),
        ("stage.positions", 9, "nine stage positions"),
        ("stage.positions", 1, "one stage position"),
        ("frames.count", 40, "40 frames"),
        ("exposure_s", 0.00166, "exposure time 0.00166 s"),
        ("frames.frame_interval_s", 900.0, "frame interval 900 s"),
        ("camera.focal_length_px", 2162.4, "focal length 2162 px"),
        ("objects.0.pose.rotations.0.angle_deg", -30.0, "rotations angle −30°"),
        ("sensor", "ideal", "sensor ideal"),
    ],
)
def test_values_have_words_and_units(path: str, value: Any, words: str) -> None:
    assert describe_parameter(path, value) == words


def test_variables_of_bundled_designs_have_no_names_of_fields() -> None:
    files = sorted((SCENES / "designs").glob("*.yaml"))
    paths = {path for file in files for path in yaml.safe_load(file.read_text(encoding="utf-8"))["variables"]}
    assert len(paths) >= 8
    for path in paths:
        assert not set("._") & set(title_parameter(path)), path
        assert ("," in label_parameter(path)) == path.endswith(("_mm", "_px", "_s")), path
