"""Reflection of GGX microfacets against closed forms, integrals over the hemisphere, and conservation of energy."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenetruth.render.reflectance_kernels import (
    albedo_tables,
    fresnel,
    mean_entering,
    reflect_ambient,
    reflect_light,
)
from scenetruth.render.reflection import pack_materials
from scenetruth.scene.material import Material
from tests.helpers.nightly import nightly

Floats = NDArray[np.float64]

cosines = st.floats(0.05, 1.0)
azimuths = st.floats(0.0, 6.28)
# Few materials, since each has tables of its own.
materials = st.sampled_from(
    [
        Material(refractive_index=1.33, roughness=0.2),
        Material(refractive_index=1.5, roughness=0.9),
        Material(refractive_index=1.4, roughness=0.6, roughness_along=0.25),
        Material(metallic=1.0, roughness=0.4),
        Material(refractive_index=1.8, roughness=0.5, roughness_along=0.8, metallic=0.3),
    ]
)


def direction(cosine: float, azimuth: float) -> Floats:
    level = np.sqrt(1 - cosine**2)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), cosine])


def reflect(material: Material, view: Floats, light: Floats, irradiance: float = 1.0) -> tuple[Floats, Floats]:
    """Return factors and gloss for lights, shape (n, 3), on a plane with x along its tangent."""
    count = len(light)
    factors, gloss = np.zeros((2, count))
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    seen = (np.zeros(3), np.tile(-view, (count, 1)), up, np.zeros(count, dtype=np.int32))
    surface = (np.array([[2.0, 0.0, 0.0]]), np.zeros(1, dtype=np.int32), *pack_materials([material]))
    reflect_light(np.full(count, irradiance), np.ascontiguousarray(light), seen, surface, factors, gloss)
    return factors, gloss


def reflect_uniform(material: Material, view: Floats) -> tuple[float, float]:
    factors, gloss = np.zeros((2, 1))
    seen = (np.zeros(3), -view[None], np.array([[0.0, 0.0, 1.0]]), np.zeros(1, dtype=np.int32))
    surface = (np.array([[2.0, 0.0, 0.0]]), np.zeros(1, dtype=np.int32), *pack_materials([material]))
    reflect_ambient(1.0, seen, surface, factors, gloss)
    return float(factors[0]), float(gloss[0])


@cache
def hemisphere(count: int = 160) -> tuple[Floats, Floats]:
    """Return directions, by the midpoint rule in angles, and their weights, which are those of cosines over π."""
    polar = (np.arange(count) + 0.5) / count * np.pi / 2
    around = (np.arange(4 * count) + 0.5) / (4 * count) * 2 * np.pi
    theta, phi = (item.ravel() for item in np.meshgrid(polar, around, indexing="ij"))
    light = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    # The cosine is in the radiance already.
    return light, np.sin(theta) * (np.pi / 2 / count) * (2 * np.pi / (4 * count)) / np.pi


def test_fresnel_reflectance_has_its_limits() -> None:
    assert fresnel(1.0, 1.5) == pytest.approx(0.04, rel=1e-12)
    assert fresnel(1e-9, 1.5) == pytest.approx(1.0, abs=1e-8)
    # At Brewster's angle, tan θ = n, only light polarised across the plane of incidence is reflected.
    cosine = 1 / np.sqrt(1 + 1.5**2)
    assert fresnel(cosine, 1.5) == pytest.approx(0.5 * ((1.5**2 - 1) / (1.5**2 + 1)) ** 2, rel=1e-12)


@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0])
def test_gloss_at_normal_incidence_has_its_closed_form(roughness: float) -> None:
    # D = 1 / (π α²), G = 1: radiance of a light of irradiance 1 is π F D / 4, in units of radiance 1 / π.
    up = np.array([0.0, 0.0, 1.0])
    values = pack_materials([Material(refractive_index=1.5, roughness=roughness)])
    further = values.values[0, 7] * (1 - values.tables[0, 1, -1, 0]) ** 2 / (1 - values.values[0, 6])
    _, gloss = reflect(Material(refractive_index=1.5, roughness=roughness), up, up[None])
    assert gloss[0] - further == pytest.approx(0.04 / (4 * roughness**2), rel=1e-9)


@pytest.mark.parametrize("index", [0.0, 1.5])
@pytest.mark.parametrize(("along", "across"), [(0.2, 0.2), (0.6, 0.6), (0.3, 0.7)])
def test_directional_albedo_is_the_integral_over_the_hemisphere(index: float, along: float, across: float) -> None:
    light, weights = hemisphere(400)
    table = albedo_tables(index, along, across)
    for node, cosine in ((-1, 1.0), (41, (41 / 63) ** 2), (30, (30 / 63) ** 2)):
        view = direction(cosine, 0.0)
        half = light + view
        half /= np.linalg.norm(half, axis=1)[:, None]
        spread = (half[:, 0] / along) ** 2 + (half[:, 1] / across) ** 2 + half[:, 2] ** 2
        distribution = 1 / (np.pi * along * across * spread**2)

        def visible(way: Floats) -> Floats:
            slope = ((along * way[..., 0]) ** 2 + (across * way[..., 1]) ** 2) / way[..., 2] ** 2
            return np.asarray(2 / (1 + np.sqrt(1 + slope)))

        reflectance = distribution * visible(light) * visible(view) / (4 * cosine)
        if index:
            c = half @ view
            g = np.sqrt(index**2 - 1 + c**2)
            reflectance *= 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)
        # The midpoint rule and the tables have 1e-3.
        assert np.pi * weights @ reflectance == pytest.approx(table[node, 0], rel=1e-3)


@nightly
@given(materials, cosines, azimuths)
def test_white_surfaces_reflect_what_they_receive(material: Material, cosine: float, azimuth: float) -> None:
    light, weights = hemisphere()
    view = direction(cosine, azimuth)
    factors, gloss = reflect(material, view, light)
    assert weights @ (factors + gloss) == pytest.approx(1.0, abs=2e-3)
    # In uniform light, exactly.
    assert sum(reflect_uniform(material, view)) == pytest.approx(1.0, abs=1e-12)


@given(materials, cosines, azimuths, st.floats(0.0, 1.0))
def test_uniform_light_is_the_integral_of_all_lights(
    material: Material, cosine: float, azimuth: float, texture: float
) -> None:
    light, weights = hemisphere()
    view = direction(cosine, azimuth)
    factors, gloss = reflect(material, view, light)
    both, own = reflect_uniform(material, view)
    assert weights @ (texture * factors + gloss) == pytest.approx(texture * both + own, abs=2e-3)
    assert texture * both + own <= 1 + 1e-12


@given(materials, cosines, azimuths, cosines, azimuths)
def test_reflection_is_reciprocal(material: Material, one: float, turn: float, other: float, way: float) -> None:
    view, light = direction(one, turn), direction(other, way)
    forth = np.array(reflect(material, view, light[None])) / light[2]
    back = np.array(reflect(material, light, view[None])) / view[2]
    np.testing.assert_allclose(forth, back, rtol=1e-9, atol=1e-15)


@given(cosines, azimuths, cosines, st.floats(0.01, 1.0))
def test_matt_sheets_pass_their_share_of_the_light_behind(
    cosine: float, azimuth: float, other: float, share: float
) -> None:
    behind = direction(other, 1.0) * (1, 1, -1)
    factors, gloss = reflect(Material(transmittance=share), direction(cosine, azimuth), behind[None], 0.7)
    assert factors[0] == pytest.approx(0.7 * share * other, rel=1e-12)
    assert gloss[0] == 0.0


@pytest.mark.parametrize("cosine", [0.2, 0.6, 1.0])
@pytest.mark.parametrize(
    "material",
    [
        Material(refractive_index=1.5, roughness=0.1, transmittance=0.4),
        Material(refractive_index=1.4, roughness=0.6, roughness_along=0.25, transmittance=0.4, metallic=0.3),
    ],
)
def test_light_that_leaves_a_sheet_is_what_enters_times_its_transmittance(material: Material, cosine: float) -> None:
    """The integral over all directions to the camera; midpoints of 160 angles leave 1e-4."""
    behind = direction(cosine, 0.7) * (1, 1, -1)
    views, weights = hemisphere()
    up = np.tile([0.0, 0.0, 1.0], (len(views), 1))
    factors, gloss = np.zeros((2, len(views)))
    along, optics = np.array([[2.0, 0.0, 0.0]]), pack_materials([material])
    seen = (np.zeros(3), -views, up, np.zeros(len(views), dtype=np.int32))
    light = np.tile(behind, (len(views), 1))
    reflect_light(np.ones(len(views)), light, seen, (along, np.zeros(1, dtype=np.int32), *optics), factors, gloss)
    sent = float((factors * views[:, 2]) @ weights)
    face = np.array([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 2.0, 0.0]]])
    entered = mean_entering(face, along, np.full(3, np.nan), -behind, optics.tables[0])
    assert sent == pytest.approx(cosine * 0.4 * (1 - material.metallic) * entered, rel=2e-4)
    assert not gloss.any()


def test_shares_that_enter_are_means_by_the_light_that_faces_receive() -> None:
    """Of two faces at right angles at different distances from a lamp, whose parts follow from single faces."""
    optics = pack_materials([Material(refractive_index=1.5, roughness=0.2, transmittance=0.4)])
    one = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0.0, 0, 0], [0, 0, 6], [0, 6, 0]]])
    along, lamp = np.array([[1.0, 0, 0], [0, 1.0, 0]]), np.array([20.0, 5.0, 30.0])
    args = lamp, np.zeros(3), optics.tables[0]
    away = lamp - one.mean(axis=1)
    # Area times cosine over the squared distance: E of a lamp of intensity 1, on 8 and 18 mm².
    received = np.array([8 * away[0, 2], 18 * away[1, 0]]) / np.linalg.norm(away, axis=1) ** 3
    shares = [mean_entering(one[k : k + 1], along[k : k + 1], *args) for k in range(2)]
    assert shares[0] != pytest.approx(shares[1], rel=1e-3)
    assert mean_entering(one, along, *args) == pytest.approx(received @ shares / received.sum(), rel=1e-12)
    assert mean_entering(one[:, [0, 2, 1]], along, *args) == pytest.approx(mean_entering(one, along, *args), rel=1e-12)


@given(materials, cosines)
def test_opaque_surfaces_pass_nothing(material: Material, cosine: float) -> None:
    behind = direction(cosine, 1.0) * (1, 1, -1)
    assert not np.any(reflect(material, direction(0.8, 0.0), behind[None]))


def test_roughness_along_turns_with_the_tangent() -> None:
    rough = Material(refractive_index=1.5, roughness=0.6, roughness_along=0.2)
    turned = Material(refractive_index=1.5, roughness=0.2, roughness_along=0.6)
    view, light = direction(0.7, 0.3), direction(0.5, 2.0)
    quarter = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        reflect(rough, view, light[None]), reflect(turned, quarter @ view, (quarter @ light)[None]), rtol=1e-9
    )


def test_result_does_not_depend_on_the_number_of_threads() -> None:
    light, _ = hemisphere()
    material = Material(refractive_index=1.4, roughness=0.4, roughness_along=0.2)
    found = []
    own = numba.get_num_threads()
    for threads in (1, own):
        numba.set_num_threads(threads)
        found.append(np.array(reflect(material, direction(0.6, 0.4), light)).tobytes())
    numba.set_num_threads(own)
    assert found[0] == found[1]
