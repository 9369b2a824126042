"""Problems of calibration files: all are reported together, also those of the covariance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as some

from scenetruth.camera import Camera
from scenetruth.capture.calibration import CalibrationError, RigCalibration

CAMERA = Camera(width=64, height=48, focal_length_px=100)

# Path of each mistake, its value, and the path of the problem if it is another. None: the field is removed.
MISTAKES: dict[tuple[str, ...], Any] = {
    ("camera", "width"): -3,
    ("camera", "height"): None,
    ("camera", "colour"): "grey",
    ("stage", "reference"): 3,
    ("parameters", "f", "value"): -7.0,
    ("parameters", "c_x", "value"): "wide",
    ("parameters", "c_y", "std"): 9.0,
    ("parameters", "swing"): {"value": 1.0, "std": 0.0, "prior_std": None},
    ("measured_visits",): [[7], [8], [9]],
    ("chi2",): -1.0,
    ("dof",): None,
    ("covariance", "sha256"): "0" * 64,
}
PATHS: dict[tuple[str, ...], str] = {("covariance", "sha256"): "covariance"}


def planted(file: Path, mistakes: set[tuple[str, ...]]) -> set[str]:
    """Write a file with mistakes, and return the paths of the problems that loading it reports."""
    RigCalibration.from_camera(CAMERA, [-5, 0, 5], std={"f": 1.0, "c_y": 0.5}).save(file, overwrite=True)
    plain = yaml.safe_load(file.read_text())
    for keys in mistakes:
        section = plain
        for key in keys[:-1]:
            section = section[key]
        section.pop(keys[-1], None)
        if MISTAKES[keys] is not None:
            section[keys[-1]] = MISTAKES[keys]
    file.write_text(yaml.safe_dump(plain))
    if not mistakes:
        assert RigCalibration.load(file).value("f") == CAMERA.focal_px
        return set()
    with pytest.raises(CalibrationError, match=re.escape(str(file))) as caught:
        RigCalibration.load(file)
    return {each.path for each in caught.value.problems}


@settings(max_examples=6)
@given(mistakes=some.sets(some.sampled_from(sorted(MISTAKES))))
def test_every_mistake_is_reported_and_no_other(
    tmp_path_factory: pytest.TempPathFactory, mistakes: set[tuple[str, ...]]
) -> None:
    file = tmp_path_factory.mktemp("rig") / "calibration.yaml"
    expected = {PATHS.get(keys, ".".join(keys)) for keys in mistakes}
    if ("covariance", "sha256") in mistakes:
        # Another matrix has other standard deviations.
        expected.discard("parameters.c_y.std")
    assert planted(file, mistakes) == expected


def test_values_of_another_rig_are_reported_once(tmp_path: Path) -> None:
    """Positions with an error determine neither the parameters nor the visits, nor the order of the covariance."""
    RigCalibration.from_camera(CAMERA, [-5, 0, 5], std={"f": 1.0}).save(tmp_path / "rig.yaml")
    plain = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    plain["stage"] |= {"positions_mm": [-5, "middle", 5], "reference": 7}
    plain["parameters"]["swing"] = {"value": 1.0, "std": 0.0, "prior_std": None}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(plain))
    with pytest.raises(CalibrationError) as caught:
        RigCalibration.load(tmp_path / "rig.yaml")
    assert [each.path for each in caught.value.problems] == ["stage.positions_mm.1"]


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "must be a mapping"), ("- 3", "must be a mapping"), ("camera: [", "is not valid YAML")],
)
def test_files_that_are_none(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(CalibrationError, match=message):
        RigCalibration.load(tmp_path / "rig.yaml")
