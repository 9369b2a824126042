"""What constraints measure, against formulas and the models of the camera."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from scenetruth.design.optimisation import (
    CONSTRAINT_MODULES,
    ConstraintSpec,
    RigContext,
    evaluate_bound,
    load_catalogues,
)
from scenetruth.design.prediction import predict, recommend
from scenetruth.discovery import kinds_in
from scenetruth.scene import Scene
from scenetruth.simulation import simulate
from tests.helpers.small_specification import scene

KINDS = kinds_in(ConstraintSpec, *CONSTRAINT_MODULES)
FOCAL, DEPTH = 500.0, 500.0


def facts(**changes: Any) -> RigContext:
    plain = scene()
    plain["stage"] |= {"positions": 5, "time_per_position_s": 0.05, "errors": {"yaw_urad": 100.0}}
    plain["frames"] = {"count": 5, "frame_interval_s": 2.0}
    plain["shutter"] = {"exposure_time_s": 0.02}
    plain["optics"] = {"defocus": {"aperture_mm": 4.0, "focus_distance_mm": 500.0}}
    for path, value in changes.items():
        section, _, key = path.partition("__")
        plain[section] = {**plain.get(section, {}), key: value}
    made = Scene.from_dict(plain)
    return RigContext(made, predict(made), "all")


@pytest.fixture(scope="module")
def wall() -> RigContext:
    return facts()


def value(kind: str, rig: RigContext, **settings: Any) -> float:
    return KINDS[kind](kind=kind, max=1e9, **settings).value(rig)  # type: ignore[attr-defined, no-any-return]


@pytest.mark.parametrize(
    ("kind", "settings", "expected"),
    [
        ("working_distance", {}, DEPTH),
        ("field_of_view", {}, 64.0),
        ("field_of_view", {"axis": "y"}, 48.0),
        ("field_of_view", {"seen_by": "all"}, 64.0 - 16.0),
        ("disparity", {}, 4.0),
        ("total_disparity", {}, 16.0 / 64.0),
        ("stereo_angle", {}, math.degrees(2 * math.atan(8 / 500))),
        ("window", {}, 2.3548 * 6.0),
        ("time_per_capture", {}, 0.25),
        ("exposure", {}, 0.02),
        ("frame_interval", {}, 2.0),
        ("recording_time", {}, 8.0),
        ("recording_time", {"of": "window"}, 8.0),
        ("images", {}, 25.0),
        # 64 x 48 px, one byte each, 5 positions in 2 s.
        ("data_rate", {}, 64 * 48 * 5 / 2 / 1e6),
        # A velocity of 0.1 mm per frame is 0.1 px here, over a hundredth of the interval. One of 0.2 mm towards Z adds
        # 0.0004 px per px from the middle, and one in 20 points is farther than 0.9 times 32 px to one side.
        ("motion_blur", {}, 0.01 * (0.1 + 0.0004 * 0.9 * 32)),
        ("flow", {}, 0.1),
        ("stage_travel", {}, 16.0),
        ("defocus_blur", {"depths_mm": [400, 600]}, 500 * 4 * (1 / 400 - 1 / 500)),
    ],
)
def test_values(wall: RigContext, kind: str, settings: dict[str, Any], expected: float) -> None:
    # Over some points of the wall, which is seen from in front.
    assert value(kind, wall, **settings) == pytest.approx(expected, rel=0.02)


def test_every_kind_is_tested_and_tells_what_it_is(wall: RigContext) -> None:
    elsewhere = {"depth_of_field", "grey_level", "texture_wavelength", "stage_error", "price"}
    (marks,) = [one for one in test_values.pytestmark if one.args[0] == ("kind", "settings", "expected")]
    assert {kind for kind, _, _ in marks.args[1]} | elsewhere == set(KINDS)
    for kind, model in KINDS.items():
        limit = model(kind=kind, min=0.0)
        assert limit.title  # type: ignore[attr-defined]
        (told,) = limit.checked(wall)  # type: ignore[attr-defined]
        assert (told.kind, told.unit, told.sense) == (kind, model.unit, "at least")  # type: ignore[attr-defined]


def test_blur_at_the_ends_of_the_depth_of_field(wall: RigContext) -> None:
    whole = value("depth_of_field", wall, blur_px=0.5)
    defocus = wall.scene.optics.defocus
    assert defocus is not None
    # 1 / near and 1 / far lie evenly around 1 / focus; their depths differ by the whole.
    near = (500 - whole + math.hypot(500, whole)) / 2
    ends = defocus.blur_diameter_px(np.array([near, near + whole]), FOCAL)
    assert ends == pytest.approx([0.5, 0.5], rel=1e-9)
    assert value("depth_of_field", wall, blur_px=5.0) == math.inf
    assert value("depth_of_field", facts(optics__defocus=None), blur_px=0.5) == math.inf


def test_grey_values_and_texture(wall: RigContext) -> None:
    causes = wall.causes
    assert value("grey_level", wall) == causes.grey_level + 3 * causes.contrast < 1
    # The band is 4 to 16 mm, a pixel 1 mm.
    assert 4 < value("texture_wavelength", wall) < 16
    # 100 µrad at 500 px are 0.05 px, and little more at the image's border.
    assert value("stage_error", wall) == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize(("exposure_s", "saturated"), [(0.009, False), (0.011, True)])
def test_grey_levels_are_too_bright_where_simulations_and_checks_say_so(exposure_s: float, saturated: bool) -> None:
    """Squares of 0 and 1 have a mean of 0.5 and deviate by 0.5: three deviations are brighter than they ever are."""
    plain = scene()
    plain["objects"][0]["texture"] = {"kind": "checkerboard", "square_mm": 12.0, "radiances": [0.0, 1.0]}
    # White gives 1000 digital numbers of 1023 in 10 ms, and the well holds more.
    plain["sensor"] = {"kind": "emva1288", "photon_rate_per_s": 2e5, "exposure_time_s": exposure_s, "gain_dn_per_e": 1}
    plain["sensor"] |= {"quantum_efficiency": 0.5, "bit_depth": 10, "full_well_e": 5000, "black_level_dn": 0}
    made = Scene.from_dict(plain)
    rig = RigContext(made, predict(made), "all")
    told = value("grey_level", rig)
    assert told == pytest.approx(exposure_s * 1e5 / 1023, rel=1e-2)
    assert (told > 1) == saturated
    assert any("of full scale, saturated" in line for line in recommend(made, rig.prediction)) == saturated
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        simulate(made)
    assert any("sensor: images reach a radiance of 1, but" in str(one.message) for one in caught) == saturated


def test_prices(wall: RigContext) -> None:
    entries = load_catalogues()
    lens, camera = entries.lenses["c_mount_50mm"], entries.cameras["vga_cmos"]
    assert math.isnan(value("price", wall))
    told = replace(wall, lens=lens.model_copy(update={"price_eur": 300.0}), camera=camera)
    assert math.isnan(value("price", told))
    assert value("price", replace(told, camera=camera.model_copy(update={"price_eur": 500.0}))) == 800.0


def test_margins() -> None:
    assert evaluate_bound("a", "a", 3.0, "at most", 4.0, "mm").margin == 0.25
    assert evaluate_bound("a", "a", 3.0, "at least", 4.0, "mm").margin == -0.25
    assert evaluate_bound("a", "a", 4.0, "at most", 4.0, "mm").holds
    assert not evaluate_bound("a", "a", math.nan, "at most", 4.0, "mm").holds
    assert evaluate_bound("a", "a", math.inf, "at least", 4.0, "mm").holds


def test_bounds_that_bound_nothing() -> None:
    with pytest.raises(ValidationError, match="has no bound"):
        KINDS["images"](kind="images")
    with pytest.raises(ValidationError, match="cannot be satisfied"):
        KINDS["images"](kind="images", min=3, max=2)
