"""The plain sensor and that of EMVA 1288: what they make of light, effects put into them, and sensors by name."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import PRESETS, EmvaSensor, GaussianSensor, LinearImage
from scenetruth.camera.sensor import PresetName
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene, load_scene
from tests.helpers.nightly import nightly
from tests.helpers.scenes import SCENES, cube
from tests.helpers.sensors import NOISY_SENSOR


def sensed(sensor: GaussianSensor, radiance: NDArray[np.float32], **index: int) -> NDArray[Any]:
    opened = sensor.chain().open((radiance.shape[0], radiance.shape[1]), partial(generator_for, 3, "sensor"))
    return opened.read(LinearImage(radiance, **index))


@pytest.mark.parametrize("bits", [1, 8, 10, 16])
def test_digitisation_rounds_and_saturates(bits: int) -> None:
    sensor = GaussianSensor(bit_depth=bits)
    top = 2**bits - 1
    radiance = np.array([[-0.1, 0.0, 0.5, 1.0, 1.5]], dtype=np.float32)
    digital = sensed(sensor, radiance)
    assert digital.tolist() == [[0, 0, np.rint(0.5 * top), top, top]]
    assert digital.dtype == sensor.chain().dtype == (np.uint8 if bits <= 8 else np.uint16)
    assert sensor.chain().full_scale == top


def test_noise_has_the_stated_strength_and_no_bias() -> None:
    image = np.full((400, 500), 0.5, dtype=np.float32)
    noise = sensed(GaussianSensor(bit_depth=None, noise_std=0.02), image).astype(np.float64) - 0.5
    # Standard errors of mean and standard deviation of 200,000 values; 5 of them.
    assert abs(noise.mean()) < 5 * 0.02 / np.sqrt(noise.size)
    assert abs(noise.std() - 0.02) < 5 * 0.02 / np.sqrt(2 * noise.size)


def test_full_scale_radiance_scales_the_signal() -> None:
    sensor = GaussianSensor(bit_depth=8, full_scale_radiance=2.0)
    assert sensed(sensor, np.ones((1, 1), dtype=np.float32)).tolist() == [[128]]
    assert sensor.chain().saturation_radiance == 2.0


def test_floats_have_full_scale_one() -> None:
    chain = GaussianSensor(bit_depth=None, full_scale_radiance=0.3).chain()
    assert (chain.full_scale, chain.saturation_radiance, chain.dtype) == (1.0, 0.3, np.dtype(np.float32))


@pytest.mark.parametrize("bits", [8, 12, None])
@pytest.mark.parametrize(("s_y", "key"), [(0, (-2, 4)), (1, (1, -2, 4))])
def test_recordings_keep_their_bytes(bits: int | None, s_y: int, key: tuple[int, ...]) -> None:
    # What this sensor did before it was a chain, in plain NumPy.
    radiance = np.linspace(0, 1.2, 600, dtype=np.float32).reshape(20, 30)
    noise = 0.03 * generator_for(3, "sensor", *key).standard_normal(radiance.shape)
    signal = radiance.astype(np.float64) / 1.1 + noise
    expected = signal.astype(np.float32) if bits is None else np.clip(np.rint(signal * (2**bits - 1)), 0, 2**bits - 1)
    sensor = GaussianSensor(bit_depth=bits, noise_std=0.03, full_scale_radiance=1.1)
    np.testing.assert_array_equal(sensed(sensor, radiance, s_y=s_y, s=-2, t=4), expected)


Array = NDArray[np.float64]

# Three very different sensors: many bits and little noise, few bits, and a noisy one with strong patterns.
SENSORS: dict[str, dict[str, Any]] = {
    "sixteen bits": {
        "photon_rate_per_s": 4e6,
        "exposure_time_s": 0.01,
        "quantum_efficiency": 0.8,
        "full_well_e": 30000.0,
        "gain_dn_per_e": 2.0,
        "bit_depth": 16,
        "black_level_dn": 100.0,
        "temporal_dark_noise_e": 1.6,
        "dsnu_e": 0.5,
        "prnu": 0.003,
    },
    "twelve bits": {
        "photon_rate_per_s": 2e6,
        "exposure_time_s": 0.01,
        "quantum_efficiency": 0.6,
        "full_well_e": 10500.0,
        "gain_dn_per_e": 0.37,
        "bit_depth": 12,
        "black_level_dn": 40.0,
        "temporal_dark_noise_e": 6.0,
        "dark_current_e_per_s": 40.0,
        "dsnu_e": 4.0,
        "prnu": 0.006,
    },
    "noisy": NOISY_SENSOR,
}
SHAPE = (400, 500)


def made(name: str, **changes: Any) -> EmvaSensor:
    return EmvaSensor(kind="emva1288", **{**SENSORS[name], **changes})


def stacks(sensor: EmvaSensor, level: float, count: int) -> Array:
    """Return ``count`` images of a uniform surface, as digital numbers."""
    opened = sensor.chain().open(SHAPE, partial(generator_for, 1))
    flat = np.full(SHAPE, level, dtype=np.float32)
    number = int(level * 1e6)
    return np.stack([opened.read(LinearImage(flat, s=number, t=n)) for n in range(count)]).astype(np.float64)


def test_digital_numbers_saturate() -> None:
    sensor = made("twelve bits", gain_dn_per_e=1.0)
    assert (stacks(sensor, 10.0, 1) == 4095).all()


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("full_well_e", [9000.0, 1e6])
def test_saturation_radiance_is_where_the_response_ends(name: str, full_well_e: float) -> None:
    sensor = made(name, full_well_e=full_well_e, prnu=0.0, dsnu_e=0.0, temporal_dark_noise_e=0.0)
    level = sensor.chain().saturation_radiance
    half, most, beyond = (stacks(sensor, share * level, 1).mean() for share in (0.5, 1.3, 2.6))
    black = sensor.black_level_dn
    # Shot noise of 9000 electrons or more is 1 %; rounding half a digital number of some hundred.
    assert most == pytest.approx(beyond, rel=1e-3)
    assert half - black == pytest.approx(0.5 * (most - black), rel=5e-3)


def test_dark_current_and_hot_pixels() -> None:
    sensor = made("noisy", hot_pixel_share=0.01, hot_pixel_current_e_per_s=1e5, exposure_time_s=0.1, dsnu_e=0.0)
    images = stacks(sensor, 0.0, 20).mean(axis=0) - sensor.black_level_dn
    hot = images > 0.5 * 0.1 * 1e5 * sensor.gain_dn_per_e
    # Standard error of a share of 200,000 pixels, five of them.
    assert hot.mean() == pytest.approx(0.01, abs=5 * np.sqrt(0.01 / images.size))
    assert images[~hot].mean() / sensor.gain_dn_per_e == pytest.approx(30.0, abs=1.0)


@nightly
def test_two_point_correction_takes_the_pattern_out() -> None:
    sensor = made("noisy")
    dark, flat = stacks(sensor, 0.0, 60).mean(axis=0), stacks(sensor, 0.4, 60).mean(axis=0)
    images = stacks(sensor, 0.2, 60)
    corrected = st.camera.two_point_correction(images, dark, flat).mean(axis=0)
    raw = images.mean(axis=0)
    assert corrected.std() < 0.3 * raw.std()
    # Every pixel now responds like the mean of all.
    assert corrected.mean() == pytest.approx(float((images - dark).mean()), rel=1e-3)


def test_two_point_correction_of_images_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match="must have the shape"):
        st.camera.two_point_correction(np.ones((2, 3, 4)), np.zeros((3, 4)), np.ones((3, 5)))
    with pytest.raises(ValueError, match="flat must be brighter"):
        st.camera.two_point_correction(np.ones((3, 4)), np.ones((3, 4)), np.ones((3, 4)))


def test_bayer_filters() -> None:
    sensor = made("sixteen bits", bayer="grbg", bayer_response=(0.5, 1.0, 0.25), prnu=0.0)
    image = np.asarray(stacks(sensor, 0.3, 30).mean(axis=0)) - sensor.black_level_dn
    green, red, blue, other = image[::2, ::2], image[::2, 1::2], image[1::2, ::2], image[1::2, 1::2]
    for part, share in ((red, 0.5), (blue, 0.25), (other, 1.0)):
        assert part.mean() / green.mean() == pytest.approx(share, rel=2e-3)


def test_gamma_bends_the_response() -> None:
    linear, bent = (stacks(made("sixteen bits", gamma=gamma), 0.3, 10).mean() for gamma in (1.0, 0.5))
    assert bent / 65535 == pytest.approx(np.sqrt(linear / 65535), rel=1e-3)


def test_patterns_stay_and_noise_does_not() -> None:
    plain = {"kind": "emva1288", **SENSORS["noisy"]}
    scene = cube(sensor=plain, frames={"count": 2}, stage={"positions": 2, "baseline_mm": 5.0})
    # The brightest spots of the texture fill the wells.
    told = r"sensor: images reach a radiance of 0\.96.* full scale is 0\.7999; reduce the exposure time"
    with pytest.warns(st.SceneWarning, match=told):
        (recording, _), (again, _) = (st.simulate(scene) for _ in range(2))
    np.testing.assert_array_equal(recording["image"], again["image"])
    assert recording["image"].dtype == np.uint16
    assert recording.attrs["full_scale"] == 4095
    # The background is black: what is common to all images there is the offset of the pixels.
    ideal, _ = st.simulate(cube(sensor="ideal", frames={"count": 2}, stage={"positions": 2, "baseline_mm": 5.0}))
    black = (ideal["image"].values == 0).all(axis=(0, 1))
    assert black.sum() > 1000
    dark = recording["image"].values[..., black].reshape(4, -1).astype(np.float64)
    correlation = np.asarray(np.corrcoef(dark))[np.triu_indices(4, 1)]
    shared = 12.0**2 / (12.0**2 + 16.0**2 + 3.0 + 1 / 12 / 0.2**2)
    np.testing.assert_allclose(correlation, shared, atol=0.08)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_a_wall_shows_one_pattern_and_fresh_noise(preset: str) -> None:
    wall = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [400, 400]},
        "pose": {"position_mm": [0, 0, 660]},
        "texture": {"kind": "uniform"},
    }
    parts = {"objects": [wall], "stage": {"positions": 2, "baseline_mm": 5.0}, "seed": 3}
    scene = cube(**parts, frames={"count": 3}, sensor={"kind": "emva1288", "preset": preset})
    recording, _ = st.simulate(scene)
    images = recording["image"].values.reshape(6, -1).astype(np.float64)
    emva = scene.sensor
    assert isinstance(emva, EmvaSensor)
    electrons = 0.5 * emva.photon_rate_per_s * emva.exposure_time_s * emva.quantum_efficiency
    pattern = (emva.prnu * electrons) ** 2 + emva.dsnu_e**2
    noise = electrons + emva.temporal_dark_noise_e**2 + 1 / 12 / emva.gain_dn_per_e**2
    # 19,200 pixels: five standard errors of a correlation.
    bound = 5 / np.sqrt(images.shape[1])
    between = np.asarray(np.corrcoef(images))[np.triu_indices(6, 1)]
    np.testing.assert_allclose(between, pattern / (pattern + noise), atol=bound)
    # The pattern drops out of differences, and what remains of three pairs has nothing in common.
    differences = np.asarray(np.corrcoef(images[::2] - images[1::2])) - np.eye(3)
    assert np.abs(differences).max() < bound
    assert (images[0] - images[1]).std() / emva.gain_dn_per_e == pytest.approx(np.sqrt(2 * noise), rel=0.03)
    # An image does not depend on how many others there are.
    single, _ = st.simulate(cube(**parts, frames={"count": 1}, sensor={"kind": "emva1288", "preset": preset}))
    np.testing.assert_array_equal(single["image"].sel(t=0), recording["image"].sel(t=0))


@pytest.mark.parametrize(
    ("changes", "path", "message"),
    [
        ({"gain_dn_per_e": 0.0}, "sensor.gain_dn_per_e", "greater than 0"),
        ({"black_level_dn": 5000.0}, "sensor.black_level_dn", "must be below full scale, 4095 at 12 bits"),
        ({"quantum_efficiency": 1.2}, "sensor.quantum_efficiency", "less than or equal to 1"),
        ({"bit_depth": 20}, "sensor.bit_depth", "less than or equal to 16"),
        ({"prnu": float("nan")}, "sensor.prnu", ""),
        ({"kind": "other"}, "sensor", "`kind` gaussian"),
        ({"quantum_efficiency": 0}, "sensor.quantum_efficiency", "greater than 0"),
        ({"exposure_time_s": 0}, "sensor.exposure_time_s", "greater than 0"),
        ({"gain_dn_per_e": -1.0}, "sensor.gain_dn_per_e", "greater than 0"),
        ({"full_well_e": 4.0}, "sensor.full_well_e", "does not reach one digital number: 0.8 at 0.2 per electron"),
        ({"bit_depth": 0}, "sensor.bit_depth", "greater than or equal to 1"),
        ({"black_level_dn": 4094.5}, "sensor.black_level_dn", "leaves less than one digital number for light"),
        ({"black_level_dn": -1.0}, "sensor.black_level_dn", "greater than or equal to 0"),
        ({"temporal_dark_noise_e": 2e4}, "sensor.temporal_dark_noise_e", "the saturation capacity, 18000 electrons"),
        ({"dsnu_e": 1.8e4}, "sensor.dsnu_e", "the saturation capacity, 18000 electrons"),
        # 12 bits at 10 DN per electron saturate long before the full well.
        ({"gain_dn_per_e": 10.0, "dsnu_e": 500.0}, "sensor.dsnu_e", "the saturation capacity, 403.1 electrons"),
        ({"dark_current_e_per_s": 2e6}, "sensor.dark_current_e_per_s", "saturates the sensor without light: 20000"),
        ({"hot_pixel_share": 0.01}, "sensor.hot_pixel_current_e_per_s", "must not be below dark_current_e_per_s, 300"),
        ({"prnu": 1.0}, "sensor.prnu", "less than 1"),
        ({"gamma": 0.0}, "sensor.gamma", "greater than 0"),
        ({"bayer_response": [1.0, 0.0, 1.0]}, "sensor.bayer_response.1", "greater than 0"),
        ({"fullwell": 3.0}, "sensor.fullwell", "unknown key; did you mean 'full_well_e'"),
    ],
)
def test_impossible_sensors(changes: dict[str, Any], path: str, message: str) -> None:
    plain = cube().to_dict() | {"sensor": {"kind": "emva1288", **SENSORS["noisy"], **changes}}
    with pytest.raises(st.SceneError) as caught:
        Scene.from_dict(plain)
    assert [problem.path for problem in caught.value.problems] == [path]
    assert message in caught.value.problems[0].message
    # What a user reads names the place and shows the value.
    shown = str(caught.value).splitlines()[-1]
    assert shown.startswith(f"  - {path}: ")
    assert "(got " in shown


def test_all_that_is_impossible_is_said_at_once() -> None:
    wrong = {"gain_dn_per_e": 0.0, "quantum_efficiency": 0.0, "exposure_time_s": -1.0, "prnu": 2.0}
    plain = cube().to_dict() | {"sensor": {"kind": "emva1288", **SENSORS["noisy"], **wrong}}
    with pytest.raises(st.SceneError) as caught:
        Scene.from_dict(plain)
    assert {problem.path for problem in caught.value.problems} == {f"sensor.{name}" for name in wrong}


def test_scenes_keep_their_sensor() -> None:
    plain = cube(sensor={"kind": "emva1288", **SENSORS["noisy"]}).to_dict()
    assert Scene.from_dict(plain).to_dict() == plain
    assert cube(sensor={"bit_depth": 8}).to_dict()["sensor"]["kind"] == "gaussian"


NOISE = {"kind": "readout_noise", "temporal_dark_noise_e": 40.0}
WELL: dict[str, Any] = {"after": "full_well", "effect": {**NOISE, "name": "reset_noise"}}
NAMED: dict[str, Any] = {"after": "full_well", "effect": {**NOISE, "name": "other"}}


def sensor(*insertions: dict[str, Any]) -> EmvaSensor:
    return EmvaSensor.model_validate({"kind": "emva1288", "preset": "scientific_cmos", "insert": insertions})


def test_effects_go_where_they_are_told_to() -> None:
    own = [effect.key for effect in sensor().chain().effects]
    lag = {"after": "reset_noise", "effect": {"kind": "readout_lag", "lag": 0.1}}
    place = own.index("full_well") + 1
    keys = [effect.key for effect in sensor(WELL, lag).chain().effects]
    assert keys == [*own[:place], "reset_noise", "readout_lag", *own[place:]]


def test_an_effect_more_changes_no_draw_of_the_others() -> None:
    flat = LinearImage(np.full((300, 400), 0.5, dtype=np.float32), s=1, t=2)
    plain, noisy = (
        one.chain().open((300, 400), partial(generator_for, 4)).read(flat).astype(np.float64)
        for one in (sensor(), sensor(WELL))
    )
    # What differs is the new noise alone, rounded twice; shot noise is three times as strong, and drops out.
    added = (noisy - plain) / sensor().gain_dn_per_e
    rounding = 2 / 12 / sensor().gain_dn_per_e ** 2
    assert added.std() == pytest.approx(np.sqrt(40.0**2 + rounding), rel=5 / np.sqrt(2 * added.size))


def test_scenes_keep_what_is_inserted() -> None:
    plain = cube(sensor={"kind": "emva1288", "preset": "ccd_2002", "insert": [WELL]}).to_dict()
    assert Scene.from_dict(plain).to_dict() == plain


@pytest.mark.parametrize(
    ("insertion", "path", "message"),
    [
        (
            {**NAMED, "after": "gamma"},
            "after",
            "unknown effect 'gamma'; available: photon_conversion, ",
        ),
        ({**NAMED, "after": "gain"}, "effect", "'readout_noise' takes electrons, but 'gain' before it gives unrounded"),
        ({"after": "full_well", "effect": {"kind": "shot_noise"}}, "effect", "draws the same random numbers"),
        (
            {"after": "full_well", "effect": {"kind": "full_well", "full_well_e": -1.0, "name": "other"}},
            "effect.full_well_e",
            "greater than 0",
        ),
    ],
)
def test_insertions_that_do_not_fit(insertion: dict[str, Any], path: str, message: str) -> None:
    with pytest.raises(st.SceneError) as caught:
        cube(sensor={"kind": "emva1288", "preset": "ccd_2002", "insert": [WELL, insertion]})
    (problem,) = caught.value.problems
    assert problem.path == f"sensor.insert.1.{path}"
    assert message in problem.message


NAMES = sorted(PRESETS)
DOCS = Path(__file__).parents[3] / "docs" / "how_to" / "scenes" / "sensors.md"


def sensor_by_name(**fields: Any) -> EmvaSensor:
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
    made = sensor_by_name(preset=name).model_dump()
    assert {key: made[key] for key in preset.values} == dict(preset.values)


@pytest.mark.parametrize("name", NAMES)
def test_radiance_one_reaches_four_fifths_of_saturation(name: str) -> None:
    made = sensor_by_name(preset=name)
    electrons = made.photon_rate_per_s * made.exposure_time_s * made.quantum_efficiency
    # The rates are written with four digits.
    assert electrons / made.saturation_capacity_e == pytest.approx(0.8, rel=1e-3)


def test_a_given_field_wins_over_the_preset() -> None:
    made = sensor_by_name(preset="ccd_2002", prnu=0.02, exposure_time_s=0.005)
    assert (made.prnu, made.exposure_time_s) == (0.02, 0.005)
    assert made.full_well_e == PRESETS["ccd_2002"].values["full_well_e"]


@pytest.mark.parametrize("name", NAMES)
def test_dumped_scenes_are_complete(name: str) -> None:
    scene = cube(sensor={"kind": "emva1288", "preset": name, "dsnu_e": 1.0})
    plain = scene.to_dict()
    assert Scene.from_dict(yaml.safe_load(yaml.safe_dump(plain))) == scene
    assert Scene.from_dict(json.loads(json.dumps(plain))) == scene
    # Should a later version change the preset, the scene is still what it was: it says every field itself.
    # Without demosaicing, which no preset has, older scenes keep their hashes.
    assert all("demosaicing" not in preset.values for preset in PRESETS.values())
    assert set(plain["sensor"]) == set(EmvaSensor.model_fields) - {"demosaicing"}
    coloured = cube(sensor={"kind": "emva1288", "preset": name, "bayer": "rggb", "demosaicing": "malvar"})
    assert set(coloured.to_dict()["sensor"]) == set(EmvaSensor.model_fields)
    alone = {**plain, "sensor": {**plain["sensor"], "preset": None}}
    kept = Scene.from_dict(alone).sensor
    assert isinstance(kept, EmvaSensor)
    assert kept.model_dump(exclude={"preset"}) == sensor_by_name(preset=name, dsnu_e=1.0).model_dump(exclude={"preset"})


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
