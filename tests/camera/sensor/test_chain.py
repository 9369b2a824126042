"""Chains of effects: what each draws is its own, what they must fit, and what images they make."""

from __future__ import annotations

from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.camera import EmvaSensor, LinearImage, SensorChain, build_sensor_chain
from scenetruth.camera.sensor import Effect, OpenSensor
from scenetruth.discovery import kinds_in
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from tests.helpers.scenes import cube

DOCS = Path(__file__).parents[3] / "docs" / "how_to" / "scenes" / "sensors.md"
SHAPE = (40, 50)
LIGHT = [
    {"kind": "photon_conversion", "photon_rate_per_s": 1000.0, "exposure_time_s": 1.0},
    {"kind": "quantum_efficiency", "quantum_efficiency": 0.5},
]
# Effects that add numbers of their own, whatever the signal is.
ADDING: dict[str, dict[str, Any]] = {
    "readout_noise": {"kind": "readout_noise", "temporal_dark_noise_e": 5.0},
    "reset_noise": {"kind": "readout_noise", "temporal_dark_noise_e": 30.0, "name": "reset_noise"},
    "dark_signal_nonuniformity": {"kind": "dark_signal_nonuniformity", "dsnu_e": 8.0},
    "columns": {"kind": "dark_signal_nonuniformity", "dsnu_e": 3.0, "name": "columns"},
    "dark_current": {
        "kind": "dark_current",
        "exposure_time_s": 1.0,
        "hot_pixel_share": 0.2,
        "hot_pixel_current_e_per_s": 40.0,
    },
}
# Effects that leave everything below the full well as it is; most of them draw numbers.
IDLE: list[dict[str, Any]] = [
    {"kind": "readout_noise", "temporal_dark_noise_e": 0.0, "name": "idle"},
    {"kind": "photo_response_nonuniformity", "prnu": 0.0},
    {"kind": "dark_signal_nonuniformity", "dsnu_e": 0.0},
    {"kind": "dark_current", "exposure_time_s": 1.0},
    {"kind": "full_well", "full_well_e": 1e9},
]


def chain(*effects: dict[str, Any]) -> SensorChain:
    return SensorChain.model_validate({"effects": effects})


def opened(*effects: dict[str, Any], seed: int = 5) -> OpenSensor:
    return chain(*effects).open(SHAPE, partial(generator_for, seed, "sensor"))


def image(level: float = 0.6, **index: int) -> LinearImage:
    return LinearImage(np.full(SHAPE, level, dtype=np.float32), **index)


@given(
    some.lists(some.sampled_from(sorted(ADDING)), unique=True),
    some.integers(-4, 4),
    some.integers(-4, 4),
    some.integers(-1, 1),
)
@settings(deadline=None, max_examples=50)
def test_what_an_effect_draws_does_not_depend_on_the_others(names: list[str], s: int, t: int, s_y: int) -> None:
    dim = image(s=s, t=t, s_y=s_y)
    clean = opened(*LIGHT).read(dim).astype(np.float64)
    alone = [opened(*LIGHT, ADDING[name]).read(dim) - clean for name in names]
    together = opened(*LIGHT, *(ADDING[name] for name in names)).read(dim)
    # Images are float32: each rounds some hundred electrons to 3e-5.
    np.testing.assert_allclose(together, clean + sum(alone, np.zeros(SHAPE)), atol=1e-3)


@given(some.lists(some.sampled_from(IDLE), unique_by=lambda one: one["kind"]), some.integers(0, 5))
@settings(deadline=None, max_examples=30)
def test_shot_noise_stays_whatever_is_put_in(idle: list[dict[str, Any]], place: int) -> None:
    plain = opened(*LIGHT, {"kind": "shot_noise"}).read(image(s=1))
    dressed = opened(*LIGHT, *idle[:place], {"kind": "shot_noise"}, *idle[place:]).read(image(s=1))
    np.testing.assert_array_equal(plain, dressed)


@given(some.data())
@settings(deadline=None, max_examples=20)
def test_the_empty_chain_is_the_identity(data: some.DataObject) -> None:
    floats = some.floats(width=32, allow_nan=False, allow_infinity=False)
    radiance = np.array(data.draw(some.lists(floats, min_size=6, max_size=6)), dtype=np.float32).reshape(2, 3)
    read = SensorChain().open((2, 3), partial(generator_for, 0)).read(LinearImage(radiance))
    assert read.dtype == np.float32
    assert read.tobytes() == radiance.tobytes()


def test_ideal_is_the_empty_chain() -> None:
    assert build_sensor_chain(cube(sensor="ideal").sensor) == SensorChain()
    named, _ = st.simulate(cube(sensor="Ideal", frames={"count": 1}))
    empty, _ = st.simulate(cube(sensor={"kind": "chain"}, frames={"count": 1}))
    np.testing.assert_array_equal(named["image"], empty["image"])
    assert named["image"].dtype == empty["image"].dtype == np.float32
    assert named.attrs["full_scale"] == empty.attrs["full_scale"] == 1.0


def test_images_may_be_read_in_any_order_and_again() -> None:
    hot = {"hot_pixel_current_e_per_s": 1e5}
    emva = EmvaSensor.model_validate({"kind": "emva1288", "preset": "ccd_2002", "hot_pixel_share": 0.01, **hot})
    images = [image(0.1 * n + 0.1, s=n - 1, t=n) for n in range(4)]
    expected = [emva.chain().open(SHAPE, partial(generator_for, 5)).read(one) for one in images]
    for order in permutations(range(4)):
        sensor = emva.chain().open(SHAPE, partial(generator_for, 5))
        for number in (*order, order[0]):
            np.testing.assert_array_equal(sensor.read(images[number]), expected[number])


def test_an_explicit_chain_is_the_sensor_that_stands_for_it() -> None:
    emva = {"kind": "emva1288", "preset": "industrial_cmos", "gamma": 0.8, "bayer": "rggb", "prnu": 0.01}
    short = cube(sensor=emva, frames={"count": 1})
    effects = build_sensor_chain(short.sensor).model_dump(mode="json")
    long = cube(sensor=effects, frames={"count": 1})
    assert isinstance(long.sensor, SensorChain)
    first, second = (st.simulate(scene)[0] for scene in (short, long))
    np.testing.assert_array_equal(first["image"], second["image"])
    assert first["image"].dtype == second["image"].dtype == np.uint16
    assert first.attrs["full_scale"] == second.attrs["full_scale"] == 4095


def test_chains_without_digitisation_give_floats_in_their_unit() -> None:
    electrons = chain(*LIGHT, {"kind": "full_well", "full_well_e": 300.0})
    assert (electrons.unit, electrons.dtype) == ("electrons", np.dtype(np.float32))
    # 500 electrons at radiance 1: the well is full at 0.6.
    assert electrons.saturation_radiance == pytest.approx(0.6)
    assert electrons.full_scale == 300.0
    unlimited = chain(*LIGHT)
    assert (unlimited.saturation_radiance, unlimited.full_scale) == (1.0, 500.0)


def test_saturation_leaves_room_for_the_dark_current() -> None:
    dark = {"kind": "dark_current", "exposure_time_s": 1.0, "dark_current_e_per_s": 50.0}
    assert chain(*LIGHT, dark, {"kind": "full_well", "full_well_e": 300.0}).saturation_radiance == pytest.approx(0.5)


GAIN = {"kind": "gain", "gain_dn_per_e": 1.0}
BITS = {"kind": "digitisation", "bit_depth": 8}


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ([GAIN, BITS], {"0": "'gain' takes electrons, but the chain begins with radiance"}),
        ([*LIGHT[::-1], GAIN, BITS], {"0": "'quantum_efficiency' takes photons", "1": "takes radiance", "2": "takes"}),
        (
            [*LIGHT, {"kind": "gaussian_noise", "noise_std": 0.1}],
            {"2": "takes share of full scale, but 'quantum_efficiency' before it gives electrons"},
        ),
        ([*LIGHT, GAIN, BITS, {**BITS, "name": "again"}], {"4": "'digitisation' takes unrounded digital numbers"}),
        ([*LIGHT, GAIN], {"2": "append 'digitisation'"}),
        ([*LIGHT, {"kind": "shot_noise"}, {"kind": "shot_noise"}], {"3": "same random numbers as effect 2"}),
        ([*LIGHT, {**GAIN, "black_level_dn": 255.0}, BITS], {"2": "saturates the sensor without light"}),
        (
            [*LIGHT, {"kind": "dark_current", "exposure_time_s": 1.0, "dark_current_e_per_s": 300.0}, GAIN, BITS],
            {"2": "saturates the sensor without light"},
        ),
        ([{"kind": "halo"}], {"0": "'shot_noise'"}),
        ([*LIGHT, {"kind": "shot_noise", "name": "0/1"}], {"2.name": "should match pattern"}),
        (
            [*LIGHT, {**GAIN, "gain_dn_per_e": 0.0}, {**BITS, "bit_depth": 20}],
            {"2.gain_dn_per_e": "", "3.bit_depth": ""},
        ),
    ],
)
def test_chains_that_do_not_fit_are_refused_effect_by_effect(
    effects: list[dict[str, Any]], expected: dict[str, str]
) -> None:
    with pytest.raises(st.SceneError) as caught:
        cube(sensor={"kind": "chain", "effects": effects})
    found = {problem.path: problem.message for problem in caught.value.problems}
    assert set(found) == {f"sensor.effects.{path}" for path in expected}
    for path, message in expected.items():
        assert message in found[f"sensor.effects.{path}"]
    assert all("(got " in line for line in str(caught.value).splitlines()[1:])


def all_kinds() -> dict[str, type[Effect]]:
    found = kinds_in(Effect, "scenetruth.camera.sensor")
    return {kind: model for kind, model in found.items() if issubclass(model, Effect)}


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    found: dict[str, Any] = Scene.model_json_schema()["$defs"]
    return found


@pytest.mark.parametrize("kind", all_kinds())
def test_schema_and_page_tell_of_every_effect(kind: str, schema: dict[str, Any]) -> None:
    effect = all_kinds()[kind]
    assert schema[effect.__name__]["description"]
    assert all(field["description"] for field in schema[effect.__name__]["properties"].values())
    assert {"$ref": f"#/$defs/{effect.__name__}"} in schema["SensorChain"]["properties"]["effects"]["items"]["oneOf"]
    lines = [line.split(" | ") for line in DOCS.read_text(encoding="utf-8").splitlines()]
    assert [f"| `{kind}`", effect.takes, effect.gives] in [line[:3] for line in lines]


def test_sensors_on_the_page_can_be_made() -> None:
    import yaml

    page = DOCS.read_text(encoding="utf-8")
    blocks = [yaml.safe_load(block.split("```")[0]) for block in page.split("```yaml\n")[1:]]
    scenes = [cube(sensor=block["sensor"]) for block in blocks]
    assert {type(scene.sensor).__name__ for scene in scenes} == {"SensorChain", "EmvaSensor"}
    assert [build_sensor_chain(scene.sensor).unit for scene in scenes].count("electrons") == 1
