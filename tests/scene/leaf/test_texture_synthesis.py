"""What is painted on leaves: veins, mottling, hairs, both sides."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.leaf import (
    LeafMesh,
    LeafTexture,
    compute_entire_margin,
    compute_half_width_mm,
    make_main_veins,
    make_side_veins,
)
from scenetruth.scene.mesh import TriangleMesh, make_plane
from scenetruth.scene.scene_report import describe_scene
from scenetruth.scene.texture import Painted
from tests.helpers.scenes import cube

LENGTH = 40.0


def leaf_of(**changes: Any) -> TriangleMesh:
    plain = {"kind": "leaf", "length_mm": LENGTH, "resolution_mm": 2.0, **changes}
    return LeafMesh.model_validate(plain).make()


def texture_of(**changes: Any) -> LeafTexture:
    return LeafTexture.model_validate({"kind": "leaf", "texels_per_mm": 10.0, **changes})


@cache
def painted(seed: int = 4, mesh: TriangleMesh | None = None, **changes: Any) -> Painted:
    return texture_of(**changes).paint(mesh or leaf_of(), Path(), np.random.default_rng(seed))


def seen(item: Painted, a: Any, b: Any, back: bool = False) -> NDArray[np.float64]:
    """Return the radiance at points of the flat sheet; texture coordinates are linear in it."""
    mesh = leaf_of()
    uv = item.uv_back if back else item.uv
    assert uv is not None
    flat = np.column_stack([mesh.chart_mm.reshape(-1, 2), np.ones(3 * len(mesh.faces))])
    linear = np.linalg.lstsq(flat, uv.reshape(-1, 2), rcond=None)[0]
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    places = np.column_stack([a.ravel(), b.ravel(), np.ones(a.size)]) @ linear
    return item.texture.radiance(places).astype(np.float64).reshape(a.shape)


PLAIN = {"mottling_contrast": 0.0, "speckle_contrast": 0.0}


@pytest.mark.parametrize(("channel", "sign"), [("green", 1), ("near_infrared", -1)])
def test_veins_are_bright_in_green_and_dark_in_the_near_infrared(channel: str, sign: int) -> None:
    item = painted(channel=channel, **PLAIN)
    a = np.linspace(3, 30, 300)
    for back in (False, True):
        midrib, beside = seen(item, a, 0.0, back).mean(), seen(item, a[:, None], [-1.5, 1.5], back).mean()
        assert sign * (midrib - beside) > 0.15 * beside
    # Between veins radiance comes down, or up, to the mean that was asked for, but for the light around large veins.
    field = seen(item, *np.meshgrid(np.linspace(8, 25, 200), np.linspace(2, 8, 100)))
    extreme = field.min() if sign > 0 else field.max()
    assert extreme == pytest.approx(item_mean(channel), rel=0.08)


def item_mean(channel: str) -> float:
    return texture_of(channel=channel).settings["mean"]


def test_underside_is_paler_and_its_veins_are_stronger() -> None:
    item = painted(**PLAIN)
    grid = np.meshgrid(np.linspace(5, 28, 200), np.linspace(-6, 6, 100))
    upper, under = seen(item, *grid), seen(item, *grid, back=True)
    # The same veins: radiance below is a linear function of that above, with the stated factors.
    values = texture_of().settings
    expected = values["underside_lightness"] * (values["mean"] + 1.25 * (upper - values["mean"]))
    # Float32, and the spline's sixteen products.
    np.testing.assert_allclose(under, expected, atol=2e-6)
    full = painted()
    assert abs(np.corrcoef(seen(full, *grid).ravel(), seen(full, *grid, back=True).ravel())[0, 1]) < 0.9


def test_both_sides_are_the_same_material_points() -> None:
    item = painted()
    assert item.uv_back is not None
    np.testing.assert_allclose(item.uv_back, item.uv * (-1, 1) + (1, 0), atol=1e-12)
    assert item.uv.min() > 0
    assert item.uv[..., 0].max() < 0.5
    assert item.uv[..., 1].max() < 1


def test_mottling_keeps_its_band_and_its_contrast() -> None:
    band = (1.0, 4.0)
    changes = {"vein_contrast": 0.0, "speckle_contrast": 0.0, "mottling_wavelength_mm": band, "mottling_contrast": 0.1}
    item = painted(mesh=leaf_of(width_mm=38.0), **changes)
    count, pitch = 512, 20 / 512
    place = np.arange(count) * pitch
    mesh = leaf_of(width_mm=38.0)
    flat = np.column_stack([mesh.chart_mm.reshape(-1, 2), np.ones(3 * len(mesh.faces))])
    linear = np.linalg.lstsq(flat, item.uv.reshape(-1, 2), rcond=None)[0]
    a, b = np.meshgrid(place + 5, place - 10)
    values = item.texture.radiance(np.column_stack([a.ravel(), b.ravel(), np.ones(a.size)]) @ linear).reshape(a.shape)
    assert values.std() / values.mean() == pytest.approx(0.1, rel=0.25)
    taper = np.outer(*(2 * [np.blackman(count)]))
    power = np.abs(np.fft.fft2((values - values.mean()) * taper)) ** 2
    frequency = np.hypot(*np.meshgrid(*(2 * [np.fft.fftfreq(count, pitch)])))
    # A Blackman window spreads lines over 3 / 20 mm; its side lobes are below 1e-5, the spline's error (1/10)^4.
    spread = 3 / 20
    outside = (frequency > 1 / band[0] + spread) | (frequency < 1 / band[1] - spread)
    assert power[outside].sum() < 1e-3 * power.sum()


def test_nothing_jumps_across_the_midrib() -> None:
    item = painted()
    a = np.linspace(2, 38, 400)
    steps = np.abs(np.diff(seen(item, a[:, None], np.linspace(-0.4, 0.4, 161)), axis=1))
    elsewhere = np.abs(np.diff(seen(item, a[:, None], np.linspace(3.0, 3.8, 161)), axis=1))
    # The step across the midrib itself, 5 µm wide, against those beside it and in the blade.
    assert steps[:, 79:81].max() < 1.5 * max(np.delete(steps, [79, 80], axis=1).max(), elsewhere.max())
    assert steps.max() < 0.02


def test_all_values_can_be_shown() -> None:
    for channel in ("green", "near_infrared"):
        uv = np.random.default_rng(1).uniform(0, 1, (200_000, 2))
        values = painted(channel=channel).texture.radiance(uv)
        assert 0 < values.min() < values.max() < 1


def test_detail_is_smooth_on_the_raster() -> None:
    """The spectrum has died out before the raster's Nyquist frequency."""
    item = painted()
    rows, columns = item.texture.raster().shape
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns // 2) + 0.5) / columns, indexing="ij")
    side = item.texture.radiance(np.column_stack([u.ravel(), v.ravel()])).astype(np.float64).reshape(u.shape)
    taper = np.outer(np.blackman(side.shape[0]), np.blackman(side.shape[1]))
    power = np.abs(np.fft.fft2((side - side.mean()) * taper)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side.shape[1]), np.fft.fftfreq(side.shape[0])))
    # A Gaussian of 1.5 texels leaves exp(-(2 pi 0.45 1.5)^2) = 2e-8 of the power there.
    assert power[frequency > 0.45].sum() < 1e-6 * power.sum()


def test_veins_within_a_texel_have_their_mean() -> None:
    # A leaf of a nanometre: all of its veins, and of the network between them, lie within texels of 0.1 mm.
    small = leaf_of(length_mm=1e-6, width_mm=6e-7, resolution_mm=1e-7)
    item = texture_of(**PLAIN).paint(small, Path(), np.random.default_rng(1))
    values = item.texture.radiance(np.random.default_rng(2).uniform(0, 1, (100, 2)))
    usual = painted(**PLAIN).texture.radiance(np.random.default_rng(2).uniform(0, 1, (100, 2)))
    assert 0.5 * usual.min() < values.min() <= values.max() < 2 * usual.max()


def test_same_seed_same_leaf_other_seed_other_leaf() -> None:
    one, two, three = (painted.__wrapped__(seed).texture.raster() for seed in (4, 4, 2))
    assert (one == two).all()
    assert not np.allclose(one, three, atol=0.05)


@pytest.mark.parametrize("outline", ["ovate", "lanceolate", "cordate", "elliptic"])
def test_side_veins_curve_to_the_margin_inside_the_blade(outline: str) -> None:
    entry = LeafMesh.model_validate({"kind": "leaf", "outline": outline, "length_mm": LENGTH, "resolution_mm": 1})
    texture = texture_of(secondary_veins=7)
    veins = make_side_veins(entry, texture, np.random.default_rng(1))
    assert len(veins) >= 12
    margin = compute_entire_margin(entry)
    for vein in veins:
        points = vein.points_mm
        assert points[0, 1] == 0
        assert (np.sign(points[1:, 1]) == np.sign(points[1, 1])).all()
        # Inside: nearer to the midrib than the margin is there.
        ahead = points[points[:, 0] > 0.05 * LENGTH]
        widest = np.interp(ahead[:, 0], margin[len(margin) // 4 :, 0], margin[len(margin) // 4 :, 1])
        assert (np.abs(ahead[:, 1]) < widest + 0.02 * LENGTH).all()
        assert (np.diff(vein.width_mm) < 0).all()
    reach = max(np.abs(vein.points_mm[:, 1]).max() for vein in veins)
    assert reach > 0.6 * compute_half_width_mm(entry, np.linspace(0, LENGTH, 99)).max()


def test_every_lobe_has_its_veins_inside_the_blade() -> None:
    plain = {"kind": "leaf", "outline": "palmate", "lobes": 9, "length_mm": LENGTH, "resolution_mm": 1}
    entry = LeafMesh.model_validate(plain)
    margin = compute_entire_margin(entry)
    outline = np.concatenate([margin, margin[-2:0:-1] * (1, -1)])
    main = make_main_veins(entry)
    assert len(main) == 9
    ends = np.array([vein.points_mm[-1] for vein in main])
    for vein, end in zip(main, ends, strict=True):
        assert (vein.points_mm[0] == 0).all()
        # Points of the margin stand 0.1 mm apart.
        assert np.hypot(*(margin * (1, np.sign(end[1]) or 1.0) - end).T).min() < 0.1
        assert Outline(outline).contains_points(vein.points_mm[1:-1] * 0.999).all()
    veins = make_side_veins(entry, texture_of(secondary_veins=7), np.random.default_rng(1))
    starts = np.array([vein.points_mm[0] for vein in veins])
    turns = np.arctan2(ends[:, 1], ends[:, 0])
    # Each starts on a main vein, and every main vein has several on each side.
    apart = np.abs(starts[:, None, 1] * np.cos(turns) - starts[:, None, 0] * np.sin(turns))
    apart[starts @ np.array([np.cos(turns), np.sin(turns)]) <= 0] = np.inf
    lobe = apart.argmin(axis=1)
    assert apart.min(axis=1).max() < 1e-9
    for number, turn in enumerate(turns):
        across = [
            vein.points_mm[-1] @ (-np.sin(turn), np.cos(turn))
            for vein, at in zip(veins, lobe, strict=True)
            if at == number
        ]
        assert min(np.sum(np.array(across) > 0), np.sum(np.array(across) < 0)) >= 3
    for vein in veins:
        # They end where they come near to the margin.
        out = vein.points_mm[1:][~Outline(outline).contains_points(vein.points_mm[1:])]
        assert all(np.hypot(*(outline - point).T).min() < 0.01 * LENGTH for point in out)


def test_veins_of_lobes_are_seen() -> None:
    mesh = leaf_of(outline="palmate", resolution_mm=1.0)
    item = texture_of(**PLAIN).paint(mesh, Path(), np.random.default_rng(4))
    flat = np.column_stack([mesh.chart_mm.reshape(-1, 2), np.ones(3 * len(mesh.faces))])
    linear = np.linalg.lstsq(flat, item.uv.reshape(-1, 2), rcond=None)[0]
    assert isinstance(mesh.source, LeafMesh)
    for vein in make_main_veins(mesh.source):
        on = vein.points_mm[len(vein.points_mm) // 4 : 3 * len(vein.points_mm) // 4]
        step = on[-1] - on[0]
        beside = on + 1.5 * np.array([-step[1], step[0]]) / np.hypot(*step)
        bright, dark = (
            item.texture.radiance(np.column_stack([points, np.ones(len(points))]) @ linear).mean()
            for points in (on, beside)
        )
        assert bright > 1.2 * dark


def test_only_leaves_wear_leaves() -> None:
    with pytest.raises(st.SceneError, match="requires a mesh with `kind` leaf"):
        painted(mesh=make_plane((10, 10)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"texels_per_mm": 2.0}, "texels_per_mm: must be at least 5"),
        ({"texels_per_mm": 500.0}, "texels_per_mm: gives more than 64 million texels"),
    ],
)
def test_rasters_that_do_not_fit_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(st.SceneError, match=message):
        painted(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mean": 0.9}, "may range from"),
        ({"mottling_wavelength_mm": (3.0, 1.0)}, "shortest < longest"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        texture_of(**changes)


def test_report_tells_the_band_of_the_mottling() -> None:
    plain = cube().to_dict()
    item = plain["objects"][0]
    item["mesh"] = {"kind": "leaf", "length_mm": LENGTH, "resolution_mm": 2.0}
    item["texture"] = {"kind": "leaf", "mottling_wavelength_mm": (2.0, 8.0)}
    item["pose"] = {"position_mm": [-20, 0, 627.0]}
    item["motion"] = []
    scene = st.scene.Scene.from_dict(plain)
    report = describe_scene(scene, build_scene(scene), np.full((120, 160), 627.0))
    assert report.objects[0].wavelength_px == pytest.approx((4.0, 16.0))
