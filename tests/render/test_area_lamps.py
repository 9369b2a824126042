"""Images of surfaces under lamps with a size against closed forms and against exact light at every sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth import compilation
from scenetruth.camera import Viewpoint
from scenetruth.render import choose_renderer
from scenetruth.render.area_lamps import AreaLamps
from scenetruth.scene.built_scene import build_scene
from tests.helpers.nightly import by_night, nightly

Image = NDArray[np.float32]
HEIGHT = 60.0
"""Distance of the sheet in front of the ground, mm."""
DISC = {"kind": "disc", "position_mm": [0, 0, -20], "direction": [0, 0, 1], "radius_mm": 40}
RING = {**DISC, "kind": "ring", "inner_radius_mm": 30, "radius_mm": 60}
PANEL = {"kind": "rectangle", "position_mm": [150, 0, -20], "target_mm": [0, 0, 500], "size_mm": [90, 40]}
BALL = {"kind": "sphere", "position_mm": [-200, 40, 100], "radius_mm": 30}
STRENGTH = {"irradiance": 0.8, "reference_distance_mm": 500}


def scene_of(
    *lamps: dict[str, Any], objects: list[dict[str, Any]], ambient: float = 0.0, focal_px: float = 700.0
) -> st.Scene:
    return st.load_scene(
        {
            "camera": {"width": 96, "height": 72, "focal_length_px": focal_px},
            "stage": {"positions": 2, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "render": {"backend": "raycast"},
            "objects": objects,
            "lighting": {"ambient": ambient, "lights": [{**STRENGTH, **lamp} for lamp in lamps]},
        }
    )


def image_of(scene: st.Scene) -> Image:
    with choose_renderer(scene, build_scene(scene)).renderer as renderer:
        return renderer.render(0.0, Viewpoint.on_axis(0.0))


def ground(**other: Any) -> dict[str, Any]:
    white = {"kind": "uniform", "radiance": 1.0}
    return {
        "name": "ground", "mesh": {"kind": "plane", "size_mm": [300, 300]}, "pose": {"position_mm": [0, 0, 500]},
        "texture": white, **other,
    }  # fmt: skip


def sheet(x_mm: float, **other: Any) -> dict[str, Any]:
    """Return a sheet in front of the ground whose right edge is at x."""
    black = {"kind": "uniform", "radiance": 0.0}
    return {
        "name": "sheet", "mesh": {"kind": "plane", "size_mm": [400, 600]},
        "pose": {"position_mm": [x_mm - 200, 0, 500 - HEIGHT]}, "texture": black, **other,
    }  # fmt: skip


BOWL = {
    "name": "ball", "mesh": {"kind": "sphere", "radius_mm": 22, "resolution_mm": 1.5},
    "pose": {"position_mm": [8, -3, 470]}, "texture": {"kind": "noise", "wavelength_mm": [3, 12]},
    "material": {"refractive_index": 1.5, "roughness": 0.25},
}  # fmt: skip


def segment(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of a disc of radius 1 beyond x."""
    x = np.clip(x, -1, 1)
    return np.asarray((np.arccos(x) - x * np.sqrt(1 - x**2)) / np.pi)


def test_penumbra_on_a_plane() -> None:
    edge = -8.0
    lit, shaded = (
        image_of(scene_of(DISC, objects=items, focal_px=2100.0)) for items in ([ground()], [ground(), sheet(edge)])
    )
    # Points on the ground, and the place on the lamp at which they see the edge of the sheet.
    x = (np.arange(96) - 47.5) / 2100 * 500
    on_lamp = x + (edge - x) * 520 / HEIGHT
    # Parts of the lamp differ in light by 6e-3, and these differences cancel to first order.
    expected = lit[36] * segment(on_lamp / 40)
    clear = x * (500 - HEIGHT) / 500 > edge + 0.5
    assert np.abs(shaded[36] - expected)[clear].max() < 2e-3 * lit.max()
    assert np.count_nonzero(clear & (expected > 0.05) & (expected < 0.95 * lit[36])) >= 8


def exact_image(scene: st.Scene, monkeypatch: pytest.MonkeyPatch) -> Image:
    """Return the image with light computed at every sample."""
    with monkeypatch.context() as patch:
        patch.setattr(AreaLamps, "_view_of", lambda *_: None)
        return image_of(scene)


@pytest.mark.parametrize("lamp", [BALL, *by_night(DISC, RING, PANEL)])
def test_interpolation_agrees_with_light_at_every_sample(lamp: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(lamp, objects=[ground(), BOWL], ambient=0.2)
    found, expected = image_of(scene), exact_image(scene, monkeypatch)
    differs = np.abs(found - expected)
    # At outlines, one share of the lamp serves for all samples of a surface in a pixel.
    assert np.sqrt(np.mean(differs**2)) < 2e-3
    assert np.percentile(differs, 95) < 2e-3
    assert expected.max() > 0.3


@pytest.mark.parametrize("kind", ["directional", *by_night("point")])
def test_light_of_corners_and_centres_agrees_with_light_at_every_sample(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lamp: dict[str, Any] = {"kind": "directional", "direction": [0.3, 0.2, 1], "irradiance": 0.8}
    if kind == "point":
        lamp = {"kind": "point", "position_mm": [-120, -80, 100], **STRENGTH}
    leaf = sheet(-8.0, material={"transmittance": 0.3}) | {"pose": {"position_mm": [-208, 0, 430]}}
    ball = BOWL | {"material": {"refractive_index": 1.5, "roughness": 0.5}}
    plain = scene_of(objects=[ground(), ball, leaf], ambient=0.2).model_dump(mode="json")
    scene = st.load_scene({**plain, "lighting": {"ambient": 0.2, "lights": [lamp]}})
    quick, shares = AreaLamps.on_samples, []

    def counted(self: AreaLamps, *given: Any) -> Any:
        found = quick(self, *given)
        assert found is not None
        shares.append((len(found[0]), len(found[2])))
        return found

    monkeypatch.setattr(AreaLamps, "on_samples", counted)
    found = image_of(scene)
    monkeypatch.undo()
    expected = exact_image(scene, monkeypatch)
    assert np.abs(found - expected).max() < 2e-4
    # Most samples away from shadows and outlines are not computed one by one.
    some, left = np.sum(shares, axis=0)
    assert left < 0.5 * some
    assert expected.max() > 0.3


def test_tiny_lamps_are_points() -> None:
    objects = [ground(), BOWL]
    place = {"position_mm": BALL["position_mm"]}
    tiny, point = (
        image_of(scene_of({**lamp, **place}, objects=objects))
        for lamp in ({"kind": "sphere", "radius_mm": 1e-3}, {"kind": "point"})
    )
    differs = np.abs(tiny - point)
    assert np.percentile(differs, 97) < 1e-3
    # Pixels at the border of the shadow have 16 samples in both.
    assert differs.max() < 0.1


def test_without_shadows_nothing_is_in_the_way() -> None:
    scene = scene_of(DISC, objects=[ground(), sheet(-12.0)])
    bright = scene.model_copy(update={"lighting": scene.lighting.model_copy(update={"shadows": False})})
    # To the right of the sheet.
    assert image_of(bright)[:, 60:] == pytest.approx(image_of(scene_of(DISC, objects=[ground()]))[:, 60:], abs=1e-6)


def test_sheets_shade_by_their_transmittance() -> None:
    half = {"texture": {"kind": "uniform", "radiance": 0.5}, "material": {"transmittance": 0.6}}
    opaque, clear, both = (
        image_of(scene_of(DISC, objects=items))
        for items in ([ground(), sheet(-12.0)], [ground()], [ground(), sheet(-12.0, **half)])
    )
    # In the penumbra to the right of the sheet.
    expected = opaque[:, 30:] + 0.3 * (clear[:, 30:] - opaque[:, 30:])
    assert both[:, 30:] == pytest.approx(expected, abs=2e-3)
    assert (clear[:, 30:] - opaque[:, 30:]).max() > 0.1


@nightly
def test_lamps_with_and_without_a_size_add_up() -> None:
    objects = [ground(), BOWL]
    sun = {"kind": "directional", "direction": [0.2, 0.1, 1], "irradiance": 0.3}
    scene = scene_of(RING, objects=objects)
    lights = [*scene.lighting.model_dump(mode="json")["lights"], sun]
    plain = scene.model_dump(mode="json")
    both = st.load_scene({**plain, "lighting": {**plain["lighting"], "lights": lights}})
    alone = st.load_scene({**plain, "lighting": {**plain["lighting"], "lights": [sun]}})
    total = image_of(scene) + image_of(alone)
    differs = np.abs(image_of(both) - total)
    assert np.percentile(differs, 95) < 2e-3


def test_images_do_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(RING, BALL, objects=[ground(), BOWL], ambient=0.2)
    images = []
    for count in (1, 2):
        monkeypatch.setattr(compilation, "thread_count", lambda number=count: number)
        images.append(image_of(scene).tobytes())
    assert images[0] == images[1]
