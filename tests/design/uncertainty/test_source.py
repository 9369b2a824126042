"""Causes are found by themselves, and each can be left on alone."""

from __future__ import annotations

import pytest

from scenetruth.camera import build_sensor_chain
from scenetruth.design.uncertainty import Calibration, active_sources, all_sources, contrast_sources, restrict_sources
from tests.helpers.budget_scenes import laboratory

CALIBRATED = Calibration(focal_length_percent=0, principal_point_px=0, baseline_percent=0)
OF_SCENES = [kind for kind, one in all_sources().items() if not one.of_surface and kind not in Calibration.model_fields]
OF_SCENES = [kind for kind in OF_SCENES if kind not in ("focal_length", "principal_point", "baseline")]


def test_all_causes_are_found_and_named() -> None:
    found = all_sources()
    assert {"noise", "stage_yaw", "timing", "focal_length", "slope", "edges", "lens_residual"} <= set(found)
    assert all(one.title and one.kind == kind for kind, one in found.items())
    assert len({one.title for one in found.values()}) == len(found)


def test_a_scene_with_everything_has_all_of_them() -> None:
    assert [one.kind for one in active_sources(laboratory(), CALIBRATED)] == OF_SCENES
    assert len(active_sources(laboratory(), Calibration())) == len(OF_SCENES) + 3
    assert active_sources(laboratory(everything=False), CALIBRATED) == []


@pytest.mark.parametrize("kind", OF_SCENES)
def test_a_cause_alone_is_on_alone(kind: str) -> None:
    scene = laboratory()
    alone = restrict_sources(scene, (kind,))
    assert [one.kind for one in active_sources(alone, CALIBRATED)] == [kind]
    # What is left of it is as large as it was.
    assert all_sources()[kind].size(alone, CALIBRATED) == all_sources()[kind].size(scene, CALIBRATED)
    assert all_sources()[kind].remedy(scene, CALIBRATED) is not None


def test_without_any_cause_the_sensor_has_no_noise() -> None:
    perfect = restrict_sources(laboratory(), ())
    assert active_sources(perfect, CALIBRATED) == []
    kinds = [effect.kind for effect in build_sensor_chain(perfect.sensor).effects]
    assert "photon_conversion" in kinds
    assert not {"shot_noise", "readout_noise"} & set(kinds)
    # Rounding to 16 bits, with the contrast that the sensor has.
    scene = laboratory()
    before, after = build_sensor_chain(scene.sensor), build_sensor_chain(perfect.sensor)
    assert after.saturation_radiance == pytest.approx(before.saturation_radiance, rel=0.01)
    assert after.full_scale == 2**16 - 1


def test_with_everything_on_it_is_the_scene() -> None:
    scene = laboratory()
    whole = restrict_sources(scene, [one.kind for one in active_sources(scene, CALIBRATED)])
    assert whole.stage == scene.stage
    assert whole.optics == scene.optics
    assert build_sensor_chain(whole.sensor) == build_sensor_chain(scene.sensor)
    assert restrict_sources(scene, (), seed=7).seed == 7


def test_what_takes_contrast_stays_on_with_the_sensor() -> None:
    found = contrast_sources(active_sources(laboratory(), CALIBRATED))
    assert found == {"lens_blur", "defocus", "motion_blur", "vignetting", "brightness", "shading"}
