"""The sensor of EMVA 1288: what it makes of light, and which sensors cannot be."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import PRESETS, EmvaSensor, LinearImage
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from tests.nightly import nightly
from tests.scenes import cube
from tests.sensors import NOISY_SENSOR

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
    told = r"sensor: images reach a radiance of 0\.96.* full scale is 0\.7999; expose"
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
