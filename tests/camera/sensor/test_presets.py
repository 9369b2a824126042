"""Sensors by name: complete, with sources, and overridden field by field."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

import scenetruth as st
from scenetruth.camera import PRESETS, EmvaSensor
from scenetruth.camera.sensor.sensor_types import PresetName
from scenetruth.scene import Scene, load_scene
from tests.scenes import SCENES, cube

NAMES = sorted(PRESETS)
DOCS = Path(__file__).parents[3] / "docs" / "how_to" / "scenes" / "sensors.md"


def sensor(**fields: Any) -> EmvaSensor:
    made = cube(sensor={"kind": "emva1288", **fields}).sensor
    assert isinstance(made, EmvaSensor)
    return made


def test_names_are_those_of_the_data() -> None:
    assert set(get_args(PresetName)) == set(PRESETS)


@pytest.mark.parametrize("name", NAMES)
def test_every_value_is_a_field_with_a_source(name: str) -> None:
    preset = PRESETS[name]
    assert set(preset.values) == set(preset.sources)
    assert all(preset.sources.values())
    required = {key for key, field in EmvaSensor.model_fields.items() if field.is_required()} - {"kind"}
    assert required <= set(preset.values) <= set(EmvaSensor.model_fields)
    made = sensor(preset=name).model_dump()
    assert {key: made[key] for key in preset.values} == dict(preset.values)


@pytest.mark.parametrize("name", NAMES)
def test_radiance_one_reaches_four_fifths_of_saturation(name: str) -> None:
    made = sensor(preset=name)
    electrons = made.photon_rate_per_s * made.exposure_time_s * made.quantum_efficiency
    # The rates are written with four digits.
    assert electrons / made.saturation_capacity_e == pytest.approx(0.8, rel=1e-3)


def test_a_given_field_wins_over_the_preset() -> None:
    made = sensor(preset="ccd_2002", prnu=0.02, exposure_time_s=0.005)
    assert (made.prnu, made.exposure_time_s) == (0.02, 0.005)
    assert made.full_well_e == PRESETS["ccd_2002"].values["full_well_e"]


@pytest.mark.parametrize("name", NAMES)
def test_dumped_scenes_are_complete(name: str) -> None:
    scene = cube(sensor={"kind": "emva1288", "preset": name, "dsnu_e": 1.0})
    plain = scene.to_dict()
    assert Scene.from_dict(yaml.safe_load(yaml.safe_dump(plain))) == scene
    assert Scene.from_dict(json.loads(json.dumps(plain))) == scene
    # Should a later version change the preset, the scene is still what it was: it says every field itself.
    assert set(plain["sensor"]) == set(EmvaSensor.model_fields)
    alone = {**plain, "sensor": {**plain["sensor"], "preset": None}}
    kept = Scene.from_dict(alone).sensor
    assert isinstance(kept, EmvaSensor)
    assert kept.model_dump(exclude={"preset"}) == sensor(preset=name, dsnu_e=1.0).model_dump(exclude={"preset"})


def test_a_scene_file_names_a_preset() -> None:
    scene = load_scene(
        SCENES / "cube.yaml", overrides=["sensor={kind: emva1288, preset: scientific_cmos, black_level_dn: 50}"]
    )
    assert isinstance(scene.sensor, EmvaSensor)
    assert scene.sensor.bit_depth == 16
    assert scene.sensor.black_level_dn == 50


@pytest.mark.parametrize("name", ["scientific", 3, ["ccd_2002"]])
def test_unknown_names_list_the_known(name: object) -> None:
    with pytest.raises(st.SceneError) as caught:
        Scene.from_dict(cube().to_dict() | {"sensor": {"kind": "emva1288", "preset": name}})
    (problem,) = caught.value.problems
    assert problem.path == "sensor.preset"
    assert all(known in problem.message for known in PRESETS)
    assert problem.value == name


def test_without_a_preset_fields_are_missed() -> None:
    with pytest.raises(st.SceneError) as caught:
        Scene.from_dict(cube().to_dict() | {"sensor": {"kind": "emva1288"}})
    assert {problem.path for problem in caught.value.problems} == {
        f"sensor.{key}" for key, field in EmvaSensor.model_fields.items() if field.is_required() and key != "kind"
    }


def test_the_schema_knows_that_a_preset_is_enough() -> None:
    schema = Scene.model_json_schema()["$defs"]["EmvaSensor"]
    short, long = schema["anyOf"]
    assert short["required"] == ["kind", "preset"]
    assert "full_well_e" in long["required"]
    assert "required" not in schema


def preset_table() -> str:
    fields = list(PRESETS["ccd_2002"].values)
    lines = [f"| field | {' | '.join(PRESETS)} |", f"|---|{'---|' * len(PRESETS)}"]
    lines += [f"| `{field}` | {' | '.join(f'{p.values[field]:g}' for p in PRESETS.values())} |" for field in fields]
    return "\n".join(lines)


def source_list() -> str:
    lines = []
    for name, preset in PRESETS.items():
        lines += [f"### `{name}`: {preset.title}", ""]
        by_source: dict[str, list[str]] = {}
        for field, source in preset.sources.items():
            by_source.setdefault(source, []).append(f"`{field}`")
        lines += [f"- {', '.join(names)}: {source}." for source, names in by_source.items()] + [""]
    return "\n".join(lines)


def test_the_page_agrees_with_the_data() -> None:
    page = DOCS.read_text(encoding="utf-8")
    # To renew the page, put in what these two return.
    assert preset_table() in page
    assert source_list() in page
