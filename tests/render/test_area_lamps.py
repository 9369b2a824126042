"""Images of surfaces under lamps with a size against closed forms and against exact light at every sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as PillowImage
from scipy import ndimage

import scenetruth as st
from scenetruth import compilation
from scenetruth.camera import Viewpoint
from scenetruth.render import choose_renderer
from scenetruth.render.area_lamps import AreaLamps
from scenetruth.scene.built_scene import build_scene
from tests.helpers.nightly import NIGHTLY, by_night, nightly

Floats = NDArray[np.float64]
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


@nightly
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


def bar(name: str, size_mm: list[float], place_mm: list[float], angle_deg: float) -> dict[str, Any]:
    black = {"kind": "uniform", "radiance": 0.0}
    pose = {"position_mm": place_mm, "rotations": [{"axis": [0, 0, 1], "angle_deg": angle_deg}]}
    return {"name": name, "mesh": {"kind": "plane", "size_mm": size_mm}, "pose": pose, "texture": black}


@pytest.mark.parametrize("kind", ["disc", "ring", "rectangle", "sphere"])
def test_narrow_and_crossing_shadows_are_interpolated_within_the_tolerance(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two narrow bars and a square cast shadows of a few pixels from outside the image, and those of the bars cross."""
    sizes: dict[str, dict[str, Any]] = {
        "disc": {"radius_mm": 25}, "ring": {"inner_radius_mm": 20, "radius_mm": 26}, "rectangle": {"size_mm": [60, 20]},
        "sphere": {"radius_mm": 30},
    }  # fmt: skip
    aim = {} if kind == "sphere" else {"target_mm": [0, 0, 500]}
    bars = [
        bar("first", [40, 3], [-62, -8, 440], 20), bar("second", [3, 60], [-50, 4, 440], 5),
        bar("square", [14, 14], [-46, 16, 455], 40),
    ]  # fmt: skip
    lamp = {"kind": kind, "position_mm": [-200, 40, 100], **aim, **sizes[kind]}
    plain = scene_of(lamp, objects=[ground(), *bars]).model_dump(mode="json")
    # One sample per pixel: images are the shares of the light at the centres.
    scene = st.load_scene({**plain, "render": {"backend": "raycast", "supersampling": 1}})
    clear = st.load_scene({**plain, "lighting": {**plain["lighting"], "shadows": False}})
    expected = exact_image(scene, monkeypatch)
    shade = 1 - expected / image_of(clear)
    # Of the light of the lamp, as `_INTERPOLATED`.
    assert np.abs(image_of(scene) - expected).max() < 2e-3 * expected.max()
    assert np.count_nonzero((shade > 0.01) & (shade < 0.99)) > 500
    assert shade.max() > 0.9


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
    # Samples away from shadows and outlines are not computed one by one; most others lie in pixels with several facets.
    some, left = np.sum(shares, axis=0)
    assert left < 0.8 * some
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


def panel_light(x: Floats, y: Floats, gap: float, left: Floats, right: Floats, above: Floats, below: Floats) -> Floats:
    """Return the irradiance of points by a part of a parallel panel of radiance 1, by Gauss points over that part.

    The part reaches from ``left`` to ``right`` and from ``above`` to ``below``.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    total = np.zeros_like(x)
    for u, one in zip(0.5 * (nodes + 1), 0.5 * weights, strict=True):
        for v, other in zip(0.5 * (nodes + 1), 0.5 * weights, strict=True):
            square = (left + u * (right - left) - x) ** 2 + (above + v * (below - above) - y) ** 2 + gap**2
            total += one * other * gap**2 / square**2
    return np.asarray(total * np.maximum(right - left, 0) * np.maximum(below - above, 0))


def test_penumbra_of_a_square_cut_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hole of 20 mm in a sheet, cut out by the opacity of its picture, in front of the ground."""
    alpha = np.full((128, 128), 255, dtype=np.uint8)
    alpha[44:84, 44:84] = 0
    PillowImage.fromarray(np.dstack([np.zeros_like(alpha)] * 3 + [alpha])).save(tmp_path / "card.png")
    (tmp_path / "card.mtl").write_text("newmtl card\nmap_Kd card.png\n")
    corners = "v -32 -32 0\nv 32 -32 0\nv 32 32 0\nv -32 32 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    (tmp_path / "card.obj").write_text(f"mtllib card.mtl\n{corners}usemtl card\nf 1/1 2/2 3/3 4/4\n")
    card = {
        "name": "card", "mesh": {"kind": "file", "file": str(tmp_path / "card.obj")},
        "pose": {"position_mm": [0, 0, 500 - HEIGHT]}, "texture": {"kind": "embedded"},
    }  # fmt: skip
    at = np.array([60.0, -35.0])
    panel = {"kind": "rectangle", "position_mm": [*at, -20], "direction": [0, 0, 1], "size_mm": [60, 50]}
    scene = scene_of(panel, objects=[ground(), card], focal_px=2100.0)
    found = image_of(scene)
    # Means over pixels, by 4 x 4 points: light bends where an edge leaves the panel.
    steps = (np.arange(4) - 1.5) / 4
    column, row = (np.add.outer(np.arange(size), steps).ravel() - (size - 1) / 2 for size in (96, 72))
    x, y = np.meshgrid(column / 2100 * 500, row / 2100 * 500)
    # The part of the panel that is visible through the hole.
    sides = [
        np.clip(place + (side - place) * 520 / HEIGHT, middle - half, middle + half)
        for place, middle, half in ((x, at[0], 30.0), (y, at[1], 25.0))
        for side in (-10.0, 10.0)
    ]
    zero = np.zeros(1)
    radiance = 0.8 / panel_light(zero, zero, 500.0, zero - 30, zero + 30, zero - 25, zero + 25)
    expected = (radiance * panel_light(x, y, 520.0, *sides)).reshape(72, 4, 96, 4).mean(axis=(1, 3))
    whole = float(
        radiance[0] * panel_light(at[:1], at[1:], 520.0, at[:1] - 30, at[:1] + 30, at[1:] - 25, at[1:] + 25)[0]
    )
    # The camera sees the ground through the hole; the contour of the opacity rounds its corners by a texel.
    beyond = np.maximum(np.abs(x), np.abs(y)).reshape(72, 4, 96, 4).max(axis=(1, 3))
    clear = beyond * (500 - HEIGHT) / 500 < 9.5
    partly = clear & (expected > 0.02 * whole) & (expected < 0.98 * whole)
    assert np.count_nonzero(partly) > 300
    assert (expected[clear] == 0).any()
    off = np.abs(found - expected)[clear] / whole
    # One share serves for all samples of a pixel, also where it bends.
    assert np.quantile(off, 0.99) < 1e-3
    assert off.max() < 4e-3
    if NIGHTLY:
        exact = exact_image(scene, monkeypatch)
        # Of the pixel means, and of the corners of the hole.
        assert np.abs(exact - expected)[clear].max() < 1.2e-3 * whole


def test_a_leaf_shines_through_under_a_panel() -> None:
    """A panel behind a flat leaf that transmits 0.6 times its texture."""
    leaf = {
        "name": "leaf",
        "mesh": {"kind": "leaf", "outline": "ovate", "length_mm": 60, "width_mm": 40, "resolution_mm": 3},
        "pose": {"position_mm": [-20, 0, 400]}, "texture": {"kind": "uniform", "radiance": 0.5},
        "material": {"transmittance": 0.6, "reflectance": 0.3},
    }  # fmt: skip
    panel = {"kind": "rectangle", "position_mm": [30, 20, 600], "direction": [0, 0, -1], "size_mm": [60, 50]}
    scene = scene_of(panel, objects=[leaf])
    world = build_scene(scene)
    assert np.ptp(world.bodies[0].vertices_mm[:, 2]) == 0
    found = image_of(scene)
    x, y = np.meshgrid((np.arange(96) - 47.5) / 700 * 400, (np.arange(72) - 35.5) / 700 * 400)
    zero = np.zeros(1)
    radiance = 0.8 / panel_light(zero, zero, 500.0, zero - 30, zero + 30, zero - 25, zero + 25)
    expected = 0.5 * 0.6 * radiance * panel_light(x, y, 200.0, x * 0, x * 0 + 60, x * 0 - 5, x * 0 + 45)
    # Inside the outline by two pixels.
    inside = ndimage.binary_erosion(found > 0.5 * expected.min(), iterations=2)
    assert np.count_nonzero(inside) > 500
    assert found[inside] == pytest.approx(expected[inside], rel=1e-3)


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
