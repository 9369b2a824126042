"""Effects put into the sensor of EMVA 1288: where they go, and what they leave as it was."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.camera import EmvaSensor, LinearImage
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from tests.scenes import cube

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
