"""Scenes of rigs: thin lenses, photons, stages that need time."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest

from scenetruth.camera.sensor.sensor_types import EmvaSensor
from scenetruth.design.optimisation.catalogues import load_catalogues
from scenetruth.design.optimisation.rig_evaluation import BaseRig, build_rig
from scenetruth.design.optimisation.specification import IlluminationSpec
from scenetruth.errors import SceneError
from scenetruth.scene import Scene
from tests.design.optimise.small import scene

ENTRIES = load_catalogues()
RIG = {"lens": "c_mount_50mm", "camera": "industrial_cmos_5mp", "stage": "air_bearing"}


def base(light: IlluminationSpec | None = None, *free: str) -> BaseRig:
    return BaseRig(Scene.from_dict(scene()).to_dict(), {path: (path,) for path in free}, ENTRIES, light, 500.0)


def built(values: dict[str, Any], light: IlluminationSpec | None = None) -> Scene:
    return Scene.from_dict(build_rig(base(light), values).plain)


def test_a_thin_lens_that_is_focused() -> None:
    made = built({**RIG, "f_number": 8.0})
    # 1/f = 1/Z + 1/b; rays through its middle make the scale b / Z.
    image_mm = 1 / (1 / 50 - 1 / 500)
    assert made.camera.focal_px == pytest.approx(image_mm / 3.45e-3)
    defocus = made.optics.defocus
    assert defocus is not None
    assert (defocus.aperture_mm, defocus.focus_distance_mm) == (50 / 8, 500.0)
    # 2 µm of the lens, and Airy's disc of the effective f-number: its radius is 1.22 λ N, its core's σ 0.345 of that.
    airy_um = 0.345 * 1.22 * 0.55 * 8 * image_mm / 50
    assert made.optics.psf is not None
    assert made.optics.psf.finest_px == pytest.approx(math.hypot(2.0, airy_um) / 3.45, rel=1e-3)


def test_photons_of_a_lit_surface() -> None:
    light = IlluminationSpec(illuminance_lux=1000)
    made = built({**RIG, "f_number": 8.0, "exposure_s": 0.02}, light)
    assert isinstance(made.sensor, EmvaSensor)
    # A white surface of 1000 lux sends E / (4 N²) lux; a photon of 555 nm has h c / λ; a lux is 1 / 683 W/m².
    effective = 8 * (1 / (1 / 50 - 1 / 500)) / 50
    watts = 1000 / (4 * effective**2) / 683
    photons = watts / (6.62607e-34 * 2.99792e8 / 555e-9) * (3.45e-6) ** 2
    assert made.sensor.photon_rate_per_s == pytest.approx(photons, rel=1e-3)
    assert (made.sensor.exposure_time_s, made.shutter.exposure_time_s) == (0.02, 0.02)
    # Without light, a white surface fills 80 % of the full well, whatever the exposure.
    lit = built({**RIG, "exposure_s": 0.02}).sensor
    assert isinstance(lit, EmvaSensor)
    electrons = lit.photon_rate_per_s * 0.02 * lit.quantum_efficiency
    assert electrons == pytest.approx(0.8 * min(lit.full_well_e, (4095 - 16) / lit.gain_dn_per_e))


@pytest.mark.parametrize("name", list(ENTRIES.cameras))
def test_every_camera_makes_a_scene(name: str) -> None:
    made = built({**RIG, "camera": name})
    entry = ENTRIES.cameras[name]
    assert (made.camera.width, made.camera.pixel_pitch_um) == (entry.width, entry.pixel_pitch_um)
    assert isinstance(made.sensor, EmvaSensor)
    if entry.read_noise_e is not None:
        assert made.sensor.temporal_dark_noise_e == entry.read_noise_e


@pytest.mark.parametrize("name", list(ENTRIES.stages))
def test_stages_have_errors_and_need_time(name: str) -> None:
    entry = ENTRIES.stages[name]
    given = base()
    given.plain["frames"]["frame_interval_s"] = 60.0
    made = Scene.from_dict(build_rig(given, {"stage": name, "exposure_s": 0.01}).plain)
    assert made.stage.errors is not None
    assert made.stage.errors.yaw_urad == entry.yaw_urad
    moving = 4 / entry.speed_mm_per_s if entry.speed_mm_per_s else 0.0
    assert made.stage.time_per_position_s == pytest.approx(entry.settle_s + moving + 0.01)


def test_the_working_distance_moves_all_and_the_focus() -> None:
    given = base()
    given.plain["objects"].append({**copy.deepcopy(given.plain["objects"][0]), "name": "behind"})
    given.plain["objects"][1]["pose"]["position_mm"] = [1, 2, 600]
    made = Scene.from_dict(build_rig(given, {**RIG, "working_distance_mm": 450.0}).plain)
    assert [item.pose.position_mm[2] for item in made.objects] == [450.0, 550.0]
    assert made.optics.defocus is not None
    assert made.optics.defocus.focus_distance_mm == 450.0
    assert given.plain["objects"][0]["pose"]["position_mm"][2] == 500


def test_fields_of_the_scene_are_put_where_they_belong() -> None:
    given = base(None, "stage.baseline_mm")
    assert build_rig(given, {"stage.baseline_mm": 7.5}).plain["stage"]["baseline_mm"] == 7.5


def test_lenses_that_cannot_be_used() -> None:
    with pytest.raises(SceneError, match="pixel_pitch_um"):
        build_rig(base(), {"lens": "c_mount_50mm"})
    near = BaseRig(base().plain, {}, ENTRIES, None, 40.0)
    with pytest.raises(SceneError, match="above the focal length of the lens"):
        build_rig(near, RIG)
