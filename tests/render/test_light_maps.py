"""Maps of light: against rendered images, and against scenes with one kind of light only."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.render import choose_renderer
from scenetruth.scene.built_scene import build_scene

Map = NDArray[np.float64]

SHARES = ("diffuse_share", "specular_share", "transmitted_share", "ambient_share")
GLOSSY = {"refractive_index": 1.5, "roughness": 0.3, "reflectance": 0.6, "transmittance": 0.3}
LAMP = {"kind": "point", "position_mm": [40, -20, 10], "irradiance": 0.6, "reference_distance_mm": 100}
BEHIND = {"kind": "directional", "direction": [0.2, 0.1, -1], "irradiance": 0.5}
PLATE = {
    "name": "plate",
    "mesh": {"kind": "plane", "size_mm": [120, 120]},
    "pose": {"position_mm": [0, 0, 100]},
}


def scene(*objects: dict[str, Any], grey: float = 0.7, **lighting: Any) -> st.Scene:
    plain: dict[str, Any] = {
        "camera": {"width": 24, "height": 18, "focal_length_px": 30},
        "stage": {"positions": 3, "baseline_mm": 5},
        "frames": {"count": 1},
        "sensor": "ideal",
        "render": {"backend": "raycast"},
        "objects": [{"texture": {"kind": "uniform", "radiance": grey}, **item} for item in objects],
    }
    return st.Scene.from_dict(plain | ({"lighting": lighting} if lighting else {}))


def light(of: st.Scene) -> xr.Dataset:
    return st.make_truth(of, truth_content="complete_with_light").sel(t=0)


def parts(of: xr.Dataset) -> dict[str, Map]:
    """The radiance by each kind of light."""
    return {name: of[name].values * of["surface_radiance"].values for name in SHARES}


@cache
def plate() -> xr.Dataset:
    return light(scene({**PLATE, "material": GLOSSY}, ambient=0.1, lights=[LAMP, BEHIND]))


def test_shares_add_up() -> None:
    found = plate()
    np.testing.assert_allclose(sum(found[name].values for name in SHARES), 1.0, rtol=0, atol=1e-14)
    for name in SHARES:
        assert found[name].values.min() >= 0
        assert found[name].values.max() > 0.03


@pytest.mark.parametrize(
    ("name", "lighting", "changes", "grey"),
    [
        ("diffuse_share", {"lights": [LAMP]}, {"transmittance": 0.0}, 0.7),
        ("specular_share", {"lights": [LAMP]}, {}, 0.0),
        ("transmitted_share", {"lights": [BEHIND]}, {}, 0.7),
        ("ambient_share", {"ambient": 0.1}, {}, 0.7),
    ],
)
def test_part_is_the_light_of_a_scene_that_has_no_other(
    name: str, lighting: dict[str, Any], changes: dict[str, Any], grey: float
) -> None:
    alone = light(scene({**PLATE, "material": GLOSSY | changes}, grey=grey, **lighting))
    expected = alone["surface_radiance"].values
    if name == "diffuse_share":
        # A black plate shows the gloss, which the white one adds.
        black = scene({**PLATE, "material": GLOSSY}, grey=0.0, **lighting)
        expected = expected - light(black)["surface_radiance"].values
    np.testing.assert_allclose(parts(plate())[name], expected, rtol=1e-6, atol=1e-9)


def test_metal_reflects_specularly_only() -> None:
    found = light(scene({**PLATE, "material": {"metallic": 1.0, "roughness": 0.4}}, lights=[LAMP]))
    np.testing.assert_allclose(found["specular_share"], 1.0, rtol=0, atol=1e-14)


def test_radiance_is_that_of_images_whose_pixels_are_points() -> None:
    # The mean over a pixel of a smooth radiance L is L + (L_xx + L_yy) / 24 to fourth order.
    material = GLOSSY | {"refractive_index": 1.4, "roughness": 0.5}
    chosen = scene({**PLATE, "material": material}, ambient=0.2, lights=[LAMP, BEHIND], drift_per_frame=0.1)
    truth = light(chosen)
    centres = truth["surface_radiance"].values
    with choose_renderer(chosen, build_scene(chosen)).renderer as renderer:
        image = renderer.render(0.0, Viewpoint(np.zeros(3), np.eye(3))).astype(np.float64)
    curved = sum(np.roll(centres, step, axis) for step in (1, -1) for axis in (0, 1)) - 4 * centres
    difference, inner = image - centres, (slice(1, -1), slice(1, -1))
    assert np.abs(difference[inner]).max() > 1e-4
    assert np.abs((difference - curved / 24)[inner]).max() < 2e-6


def test_lit_fraction_is_weighted_by_irradiance() -> None:
    bar = {"name": "bar", "mesh": {"kind": "plane", "size_mm": [300, 6]}, "pose": {"position_mm": [0, -14, 50]}}
    upper = {"kind": "directional", "direction": [0, 0.4, 1], "irradiance": 0.9}
    ahead = {"kind": "directional", "direction": [0, 0, 1], "irradiance": 0.4}
    found = light(scene(PLATE, bar, ambient=0.3, lights=[upper, ahead]))
    levels = np.unique(np.round(found["lit_fraction"].values, 9))
    shares = np.array([0.4, 0.9 / np.sqrt(1.16)])
    np.testing.assert_allclose(levels, [*shares / shares.sum(), 1.0], atol=1e-9)


def test_sheet_before_a_lamp_lets_its_transmittance_pass() -> None:
    sheet = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [300, 6]},
        "pose": {"position_mm": [0, -14, 50]},
        "material": {"reflectance": 0.5, "transmittance": 0.4},
    }
    upper = {"kind": "directional", "direction": [0, 0.4, 1], "irradiance": 0.9}
    found = light(scene(PLATE, sheet, lights=[upper]))
    np.testing.assert_allclose(np.unique(np.round(found["lit_fraction"].values, 7)), [0.7 * 0.4, 1.0], atol=1e-7)


def test_unlit_surfaces_have_the_radiance_of_their_texture() -> None:
    found = light(scene({**PLATE, "mesh": {"kind": "plane", "size_mm": [30, 30]}}))
    seen = found["object_id"].values >= 0
    assert 0 < np.count_nonzero(seen) < seen.size
    np.testing.assert_allclose(found["surface_radiance"].values[seen], 0.7, rtol=1e-6)
    assert np.all(found["ambient_share"].values[seen] == 1)
    assert np.isnan(found["lit_fraction"]).all()
    for name in ("surface_radiance", *SHARES):
        assert np.isnan(found[name].values[~seen]).all()


def test_no_lamp_lights_surfaces_that_face_away() -> None:
    found = light(scene(PLATE, ambient=0.2, lights=[BEHIND]))
    assert np.isnan(found["lit_fraction"]).all()


def test_rows_of_a_rolling_shutter_have_the_light_of_their_time() -> None:
    lamp = {**LAMP, "motion": [{"kind": "velocity", "velocity_mm_per_frame": [30, 0, 0]}]}
    plain = scene({**PLATE, "material": GLOSSY}, lights=[lamp]).to_dict()
    rolling = st.Scene.from_dict(plain | {"shutter": {"readout_time_s": 1.0}})
    steady, moved = light(st.Scene.from_dict(plain)), light(rolling)
    change = np.abs(moved["surface_radiance"].values - steady["surface_radiance"].values).max(axis=1)
    middle = len(change) // 2
    # The outer rows are read 17 times as far from the middle of the image as the inner ones.
    assert change[[0, -1]].min() > 5 * change[middle - 1 : middle + 1].max() > 0


def test_shadow_distance_is_that_to_the_border_on_one_surface() -> None:
    bar = {"name": "bar", "mesh": {"kind": "plane", "size_mm": [300, 6]}, "pose": {"position_mm": [0, -14, 50]}}
    upper = {"kind": "directional", "direction": [0, 0.4, 1], "irradiance": 0.9}
    found = light(scene(PLATE, bar, lights=[upper]))
    lit = found["lit_fraction"].values
    assert lit.min() == 0 < lit.max()
    distance = found["shadow_distance"].values
    rows = np.flatnonzero((lit[1:] != lit[:-1]).all(axis=1) & (found["object_id"].values[1:] == 0).all(axis=1))
    borders = np.unique([rows, rows + 1])
    expected = np.abs(np.arange(len(lit))[:, None] - borders).min(axis=1)
    np.testing.assert_array_equal(distance, np.broadcast_to(expected[:, None], distance.shape))
