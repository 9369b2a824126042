"""The lens to buy: nearest in the catalogue, with its stop, image distance and predictions."""

from __future__ import annotations

from dataclasses import replace

import pytest

from scenetruth.design.optimisation import (
    DesignSpec,
    EvaluationTask,
    RigDesign,
    StandardLens,
    choose_f_stop,
    choose_standard_lens,
    describe_standard_lens,
    evaluate_rig,
    load_catalogues,
    prepare_problem,
)
from scenetruth.number_format import format_percent
from tests.helpers.small_specification import spec

RIG = RigDesign(3, {}, {}, {}, {}, (), None, "")


def task() -> EvaluationTask:
    """Return the evaluation of a wall at 500 mm, whose focal length is free, in mm."""
    plain = spec(variables={"camera.focal_length_mm": {"from": 5, "to": 120}}, constraints=[])
    plain["scene"]["camera"] = {"width": 64, "height": 48, "focal_length_mm": 12.0, "pixel_pitch_um": 3.45}
    return prepare_problem(DesignSpec.from_dict(plain)).task


@pytest.mark.parametrize(
    ("wanted", "stop"), [(8.0, 8.0), (10.2, 11.0), (9.0, 8.0), (3.0, 2.8), (1.0, 1.8), (90.0, 16.0)]
)
def test_stops_are_engraved_ones_within_the_lens(wanted: float, stop: float) -> None:
    assert choose_f_stop(wanted, load_catalogues().lenses["c_mount_16mm"]) == stop


def test_catalogue_has_the_focal_lengths_of_shops() -> None:
    lengths = {one.focal_length_mm for one in load_catalogues().lenses.values()}
    assert lengths >= {8, 12, 16, 25, 35, 50, 75, 100}


@pytest.mark.parametrize("lens_mm", [8, 12, 16, 25, 35, 50, 75])
def test_a_length_in_pixels_of_a_focused_lens_is_that_lens(lens_mm: float) -> None:
    # A thin lens of f, focused at Z = 500 mm, has its image at f Z / (Z - f).
    image_mm = lens_mm * 500 / (500 - lens_mm)
    found = choose_standard_lens(task(), {"camera.focal_length_mm": image_mm})
    assert found is not None
    assert (found.focal_length_mm, found.image_distance_mm) == pytest.approx((lens_mm, image_mm))
    assert found.is_that_of_the_rig


def test_another_length_is_replaced_and_predicted_anew() -> None:
    of = task()
    values = {"camera.focal_length_mm": 30.0 * 500 / 470}
    found = choose_standard_lens(of, values)
    assert found is not None
    assert not found.is_that_of_the_rig
    assert (found.wanted_focal_length_mm, found.focal_length_mm) == pytest.approx((30.0, 35.0), rel=1e-3)
    rig = evaluate_rig(of, values)
    again = evaluate_rig(of, {**values, "lens": "c_mount_35mm", "f_number": found.f_number})
    assert found.predicted == again.predicted != rig.predicted
    words = " ".join(describe_standard_lens(found, of.objectives, replace(RIG, predicted=rig.predicted)))
    assert "The rig has a lens of 30 mm. The nearest" in words
    assert "35 mm lens for 2/3 inch sensors at f/8 (assumed: the scene states no aperture)" in words
    assert "37.63 mm behind it" in words


def test_without_a_pixel_size_no_lens_is_named() -> None:
    plain = spec(variables={"camera.focal_length_px": {"from": 400, "to": 1200}}, constraints=[])
    of = prepare_problem(DesignSpec.from_dict(plain)).task
    assert choose_standard_lens(of, {"camera.focal_length_px": 500.0}) is None
    assert list(describe_standard_lens(None, (), RIG)) == []
    (words,) = describe_standard_lens(None, (), replace(RIG, parameters={"camera.focal_length_px": 500.0}))
    assert words.startswith("No lens is named")


def test_stops_and_broken_constraints_are_named() -> None:
    lens = StandardLens("35 mm lens", 35.0, 8.0, 30.0, 7.2, 37.6, 500.0, {}, ("field of view",))
    words = " ".join(describe_standard_lens(lens, (), RIG))
    assert "lens of 30 mm at f/7.2" in words
    assert "35 mm lens at f/8" in words
    assert "constraints are not satisfied: field of view" in words


@pytest.mark.parametrize(("stop", "wanted"), [(2.0, 2.05), (4.0, 5.0), (5.6, 4.9)])
def test_a_wider_stop_of_the_same_lens_states_the_exposure_time(stop: float, wanted: float) -> None:
    lens = StandardLens("35 mm lens", 35.0, stop, 35.0, wanted, 37.6, 500.0, {})
    words = " ".join(describe_standard_lens(lens, (), RIG))
    assert f"has this lens, 35 mm lens, at f/{wanted:.2g}; the nearest full stop is f/{stop:.2g}" in words
    # The light that reaches the sensor is proportional to the square of the aperture.
    shorter = 1 - (stop / wanted) ** 2
    assert ("shorter by" in words) is (shorter > 0)
    if shorter > 0:
        assert f"shorter by {format_percent(shorter)} compensates" in words
