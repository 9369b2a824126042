"""Scenes in bands: each band is the grey scene with its values, to the byte, and the truth is that of any of them."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from PIL import Image

import scenetruth as st
from scenetruth import compilation
from scenetruth.bands import COLOURS, ByBand, as_number, find_by_band, in_band
from scenetruth.provenance import scene_hash
from scenetruth.resources.cost_estimate import estimate_cost
from scenetruth.resources.workload import compute_workload, list_object_workloads
from scenetruth.scene import LEAF_SPECTRA, LEAF_WAVELENGTHS_NM, leaf_material
from scenetruth.scene.lighting import Lighting
from tests.helpers.nightly import by_night, nightly

BANDS = ("red", "green", "nir_850")
SHARES = ("diffuse", "specular", "transmitted", "ambient")


def by_band(*values: Any) -> dict[str, Any]:
    return dict(zip(BANDS, values, strict=True))


def coloured(**changes: Any) -> dict[str, Any]:
    """Return a scene of a wall and a ball in three bands."""
    noise: dict[str, Any] = {"kind": "noise", "wavelength_mm": [6, 30], "mean": 0.4}
    return {
        "camera": {"width": 24, "height": 18, "focal_length_px": 120, "bands": list(BANDS)},
        "stage": {"positions": 2, "baseline_mm": 5},
        "frames": {"count": 1},
        "background": by_band(0.1, 0.2, 0.3),
        "lighting": {
            "ambient": by_band(0.2, 0.3, 0.0),
            "lights": [
                {"kind": "directional", "direction": [0.3, 0.2, 1], "irradiance": by_band(0.5, 0.0, 0.7)},
                {
                    "kind": "point",
                    "position_mm": [-100, -100, 100],
                    "irradiance": by_band(0.1, 0.4, 0.2),
                    "reference_distance_mm": 400,
                },
            ],
        },
        "objects": [
            {
                "name": "wall",
                "mesh": {"kind": "plane", "size_mm": [60, 900]},
                "texture": noise,
                "tint": by_band(0.2, 1.0, 1.25),
                "pose": {"position_mm": [0, 0, 500]},
            },
            {
                "name": "ball",
                "mesh": {"kind": "sphere", "radius_mm": 12},
                "texture": {
                    "kind": "by_band",
                    "textures": by_band(
                        {"kind": "uniform", "radiance": 0.3},
                        {**noise, "mean": 0.5},
                        {"kind": "checkerboard", "square_mm": 6},
                    ),
                },
                "pose": {"position_mm": [0, 0, 440]},
            },
        ],
        "score": {"interior_margin_px": 0},
        **changes,
    }  # fmt: skip


def of_band(plain: Any, band: str) -> Any:
    """Return values with those of one band in place of mappings from bands, and of textures by band."""
    if isinstance(plain, list):
        return [of_band(each, band) for each in plain]
    if not isinstance(plain, dict):
        return plain
    if plain.get("kind") == "by_band":
        return of_band(plain["textures"][band], band)
    if set(plain) == set(BANDS):
        return plain[band]
    return {key: of_band(value, band) for key, value in plain.items() if key != "bands"}


GLOSS = {
    "refractive_index": 1.4,
    "roughness": 0.4,
    "reflectance": by_band(1.0, 0.5, 0.7),
    "transmittance": by_band(0.0, 0.2, 0.3),
}
VARIANTS: dict[str, dict[str, Any]] = {
    "exact": {},
    "sampled": {"render": {"supersampling": 2}},
    "adaptive": {"render": {"edges": "adaptive", "supersampling": 1}},
    "gloss": {"objects": [{**each, "material": GLOSS} for each in coloured()["objects"]]},
    "parallel": {"lighting": {"lights": coloured()["lighting"]["lights"][:1]}},
    "blurred": {"optics": {"psf": {"kind": "gaussian", "sigma_px": 0.6}, "vignetting": {}}},
}


@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
@pytest.mark.parametrize("variant", ["exact", *by_night("gloss", "parallel", "sampled", "adaptive", "blurred")])
def test_every_band_is_the_grey_scene_with_its_values_to_the_byte(variant: str) -> None:
    plain = coloured(**VARIANTS[variant])
    recording, truth = st.simulate(plain, save_radiance=True)
    assert recording.image.dims == ("s", "t", "y", "x", "channel")
    assert recording.channel.values.tolist() == list(BANDS)
    for band in BANDS:
        grey = st.Scene.from_dict(of_band(plain, band))
        assert st.Scene.from_dict(plain).in_band(band) == grey
        alone, same = st.simulate(grey, save_radiance=True)
        np.testing.assert_array_equal(recording.radiance.sel(channel=band), alone.radiance)
        np.testing.assert_array_equal(recording.image.sel(channel=band), alone.image)
        for name in same:
            np.testing.assert_array_equal(truth[name], same[name])


@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
def test_proportional_bands_are_the_grey_image_times_a_factor() -> None:
    """Rounding of float32 in the sums of a pixel is some units in the last place of the brightest value.

    Pixels with several facets are resolved by the brightness of a band, until errors are ``image_error`` in the root
    mean square of the image; single pixels have larger ones.
    """
    lamps, tints = {"red": 1.0, "green": 0.3, "blue": 1.7}, {"red": 1.0, "green": 0.6, "blue": 0.9}
    plain = coloured()
    plain["camera"]["bands"] = list(COLOURS)
    plain["background"] = 0.0
    light = {"kind": "directional", "direction": [0.3, 0.2, 1]}
    plain["lighting"] = {"lights": [{**light, "irradiance": {band: 0.5 * lamps[band] for band in COLOURS}}]}
    for item in plain["objects"]:
        item |= {"texture": plain["objects"][0]["texture"], "tint": tints}
    images = st.simulate(plain).recording.image
    for band in COLOURS:
        factor = lamps[band] * tints[band]
        assert np.ptp(images.sel(channel=band).values) > 0.1 * factor
        off = images.sel(channel=band).values - factor * images.sel(channel="red").values
        assert np.abs(off).max() < 5e-3
        assert np.sqrt(np.mean(off**2)) < 1e-4 * (1 + factor)
        assert np.mean(np.abs(off) > 1e-6) < 0.1


def uniform(sensor: dict[str, Any], size: tuple[int, int] = (60, 40), **changes: Any) -> dict[str, Any]:
    """Return an evenly bright scene that fills the image."""
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [900, 900]}, "texture": {"kind": "uniform"}}
    return {
        "camera": {"width": size[0], "height": size[1], "focal_length_px": 200, "bands": list(COLOURS)},
        "stage": {"positions": 2, "baseline_mm": 5},
        "frames": {"count": 1},
        "objects": [{**wall, "pose": {"position_mm": [0, 0, 500]}}],
        "sensor": sensor,
        **changes,
    }


def images_of(plain: Mapping[str, Any]) -> NDArray[np.float64]:
    return np.asarray(st.simulate(plain).recording.image.values, dtype=np.float64)


@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
def test_noise_of_bands_is_independent_and_does_not_depend_on_other_bands() -> None:
    sensor = {"kind": "emva1288", "preset": "industrial_cmos", "prnu": 0.02, "dsnu_e": 30}
    images = images_of(uniform(sensor, (120, 80)))
    deviations = (images - images.mean(axis=(2, 3), keepdims=True)).reshape(-1, 3)
    # Correlations of n independent pairs have a standard deviation of n^-1/2.
    correlation = np.corrcoef(deviations.T)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 5 / np.sqrt(len(deviations))
    plain = uniform(sensor, (120, 80))
    plain["camera"]["bands"] = ["blue", "nir", "red"]
    np.testing.assert_array_equal(images_of(plain)[..., [2, 0]], images[..., [0, 2]])


@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
@pytest.mark.parametrize("order", ["rggb", *by_night("bggr", "grbg", "gbrg")])
@pytest.mark.parametrize("method", ["bilinear", "malvar"])
def test_evenly_bright_scenes_are_uniform_behind_colour_filters(order: str, method: str) -> None:
    colours = {"red": 0.3, "green": 0.9, "blue": 0.6}
    sensor = {"noise_std": 0.0, "bit_depth": 16, "bayer": order, "demosaicing": method}
    plain = uniform(sensor)
    plain["objects"][0]["tint"] = colours
    images = images_of(plain)
    np.testing.assert_array_equal(images, np.broadcast_to(images[0, 0, 0, 0], images.shape))
    np.testing.assert_allclose(images[0, 0, 0, 0], [0.5 * 65535 * value for value in colours.values()], atol=0.5)
    mosaic = images_of({**plain, "sensor": {**sensor, "demosaicing": None}})
    assert mosaic.shape == images.shape[:-1]
    for (row, column), colour in zip(np.ndindex(2, 2), order, strict=True):
        assert set(np.unique(mosaic[..., row::2, column::2])) == {images[0, 0, 0, 0, "rgb".index(colour)]}


def test_pixels_behind_filters_keep_the_radiance_of_their_band() -> None:
    plain = uniform({"kind": "chain", "effects": [{"kind": "colour_filter_array", "order": "gbrg"}]}, (16, 12))
    plain["objects"][0] |= {
        "texture": {"kind": "noise", "wavelength_mm": [6, 30], "mean": 0.4},
        "tint": {"red": 0.1, "green": 0.5, "blue": 1.0},
    }
    recording = st.simulate(plain, save_radiance=True).recording
    assert recording.image.dims == ("s", "t", "y", "x")
    radiance = recording.radiance
    np.testing.assert_array_equal(recording.image[..., 1::2, 0::2], radiance.sel(channel="red")[..., 1::2, 0::2])
    np.testing.assert_array_equal(recording.image[..., 0::2, 1::2], radiance.sel(channel="blue")[..., 0::2, 1::2])
    np.testing.assert_array_equal(recording.image[..., 0::2, 0::2], radiance.sel(channel="green")[..., 0::2, 0::2])


def test_spectral_response_scales_the_photons_of_each_band() -> None:
    effects: list[dict[str, Any]] = [{"kind": "photon_conversion", "photon_rate_per_s": 1e4, "exposure_time_s": 0.1}]
    response = {"red": 0.5, "green": 1.0, "blue": 0.25}
    effects.append({"kind": "spectral_response", "response": response})
    images = images_of(uniform({"kind": "chain", "effects": effects}))
    np.testing.assert_allclose(images[0, 0, 0, 0], [500 * value for value in response.values()], rtol=1e-6)


def test_recordings_name_their_demosaicing() -> None:
    plain = uniform({"noise_std": 0.0, "bayer": "rggb", "demosaicing": "bilinear"}, (16, 12))
    recording = st.simulate(plain).recording
    assert recording.attrs["demosaicing"] == "bilinear"
    grey = copy.deepcopy(plain)
    del grey["camera"]["bands"]
    assert st.simulate(grey).recording.image.dims[-1] == "channel"
    assert "demosaicing" not in st.simulate({**plain, "sensor": {"noise_std": 0.0}}).recording.attrs


def test_spectra_of_leaves_are_materials_of_bands() -> None:
    bands = {"green": 550, "red": 660, "nir": 850}
    plain = uniform({"noise_std": 0.0, "bit_depth": None}, (16, 12))
    plain["camera"]["bands"] = list(bands)
    material = leaf_material("green_leaf", bands, refractive_index=1.0)
    plain["objects"][0] |= {"texture": {"kind": "uniform", "radiance": 1}, "material": material}
    plain["lighting"] = {"lights": [{"kind": "directional", "direction": [0, 0, 1], "irradiance": 1}]}
    at = [LEAF_WAVELENGTHS_NM.index(wavelength) for wavelength in bands.values()]
    reflected = np.array(LEAF_SPECTRA["green_leaf"].reflectance)[at]
    np.testing.assert_allclose(images_of(plain)[0, 0, 6, 8], reflected, atol=1e-4)
    plain["lighting"]["lights"][0]["direction"] = [0, 0, -1]
    transmitted = np.array(LEAF_SPECTRA["green_leaf"].transmittance)[at]
    np.testing.assert_allclose(images_of(plain)[0, 0, 6, 8], transmitted, atol=1e-4)


@nightly
@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
def test_images_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for count in (1, 2):
        monkeypatch.setattr(compilation, "thread_count", lambda count=count: count)
        found.append(st.simulate(coloured(sensor={"noise_std": 0.01})).recording.image.values.tobytes())
    assert found[0] == found[1]


def picture_scene(file: Path, bands: list[str]) -> dict[str, Any]:
    plain = uniform({"noise_std": 0.0, "bit_depth": None})
    plain["camera"] |= {"bands": bands}
    plain["objects"][0] |= {"texture": {"kind": "image", "file": str(file)}}
    return plain


def test_colours_of_pictures_are_red_green_and_blue(tmp_path: Path) -> None:
    file = tmp_path / "colour.png"
    Image.new("RGB", (4, 4), (51, 102, 204)).save(file)
    images = images_of(picture_scene(file, ["blue", "red", "green"]))
    np.testing.assert_allclose(images[0, 0, 0, 0], [0.8, 0.2, 0.4], atol=1e-6)
    grey = images_of(picture_scene(file, []))
    np.testing.assert_allclose(grey, 0.2126 * 0.2 + 0.7152 * 0.4 + 0.0722 * 0.8, atol=1e-6)
    with pytest.raises(st.SceneError, match=r"objects\.0\.texture\.file: .* band 'nir_850' \(`kind: by_band`\)"):
        st.simulate(picture_scene(file, ["red", "nir_850"]))


def test_grey_pictures_are_the_same_in_all_bands(tmp_path: Path) -> None:
    file = tmp_path / "grey.png"
    Image.new("L", (4, 4), 51).save(file)
    images = images_of(picture_scene(file, ["red", "nir_850"]))
    np.testing.assert_allclose(images, 0.2, atol=1e-6)


def test_scenes_without_bands_keep_their_values_and_hashes() -> None:
    plain = uniform({"noise_std": 0.01})
    del plain["camera"]["bands"]
    scene = st.Scene.from_dict(plain)
    written = scene.to_dict()
    assert "bands" not in written["camera"]
    assert "tint" not in written["objects"][0]
    assert set(written["sensor"]) == {"kind", "noise_std", "bit_depth", "full_scale_radiance"}
    explicit = copy.deepcopy(plain)
    explicit["camera"]["bands"] = []
    explicit["objects"][0]["tint"] = 1
    explicit["sensor"] |= {"bayer": None, "demosaicing": None}
    assert scene_hash(st.Scene.from_dict(explicit)) == scene_hash(scene)


def test_scenes_in_bands_survive_their_values_and_hash_by_value() -> None:
    scene = st.Scene.from_dict(coloured())
    again = st.Scene.from_dict(scene.to_dict())
    assert again == scene
    assert hash(again.lighting) == hash(scene.lighting)
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert scene.to_dict()["lighting"]["ambient"] == by_band(0.2, 0.3, 0.0)
    with pytest.raises(TypeError, match="cannot be changed"):
        scene.lighting.ambient["red"] = 2  # type: ignore[index]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"lighting": {"ambient": {"red": 0.1, "green": 0.1, "nir": 0.2}}},
            {
                "lighting.ambient: unknown band 'nir'; the camera has red, green, nir_850",
                "lighting.ambient: has no value for the band 'nir_850' of the camera",
            },
        ),
        ({"background": by_band(0.1, 2, 0.3)}, {"background.green: input should be less than or equal to 1"}),
        ({"background": by_band(0.1, True, 0.3)}, {"background.green: must be a number, not a boolean"}),
        ({"sensor": {"bayer": "rggb"}}, {"sensor: filters red, green and blue, but camera.bands is red, green"}),
        ({"sensor": {"demosaicing": "malvar"}}, {"sensor: demosaicing requires the order of the colour filters"}),
        (
            {"sensor": {"bayer": "rggb", "demosaicing": "malvar", "bit_depth": None}},
            {"sensor: demosaicing requires digital numbers"},
        ),
        (
            {"sensor": {"kind": "chain", "effects": [{"kind": "full_scale"}, {"kind": "full_range_gain"},
                                                     {"kind": "digitisation"}, {"kind": "demosaicing"}]}},
            {"sensor.effects.3: requires colour filters before it"},
        ),
    ],
)  # fmt: skip
def test_bands_that_do_not_fit_are_named(changes: dict[str, Any], expected: set[str]) -> None:
    with pytest.raises(st.SceneError) as caught:
        st.Scene.from_dict(coloured(**changes))
    found = [str(problem) for problem in caught.value.problems]
    assert len(found) == len(expected)
    assert all(any(text in one for one in found) for text in expected), found


def test_problems_of_bands_are_reported_together() -> None:
    plain = coloured()
    plain["camera"]["bands"] = ["red", "red"]
    plain["seed"] = -1
    with pytest.raises(st.SceneError, match="2 problems"):
        st.Scene.from_dict(plain)
    del plain["seed"]
    plain["camera"]["bands"] = []
    with pytest.raises(st.SceneError, match=r"6 problems(?s:.)*the camera is grey"):
        st.Scene.from_dict(plain)


@nightly
@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
def test_maps_of_light_are_those_of_each_band(tmp_path: Path) -> None:
    scene = st.Scene.from_dict(coloured(sensor={"noise_std": 0.0}))
    truth = st.make_truth(scene, truth_content="complete_with_light")
    assert truth["channel"].values.tolist() == list(BANDS)
    of_bands = ("surface_radiance", *(f"{name}_share" for name in SHARES), "lit_fraction")
    for band in BANDS:
        grey = st.make_truth(scene.in_band(band), truth_content="complete_with_light")
        for name in of_bands:
            assert truth[name].dims == ("channel", "t", "y", "x")
            np.testing.assert_array_equal(truth[name].sel(channel=band), grey[name])
    st.save_store(truth, tmp_path / "truth.zarr")
    xr.testing.assert_identical(st.load_store(tmp_path / "truth.zarr").load(), truth)


def test_shares_of_light_add_up_to_the_radiance_of_the_image_in_each_band() -> None:
    """Directional light on a uniform plane: the mean over a pixel is the value at its centre, to single precision."""
    plain = coloured()
    plain["lighting"]["lights"] = plain["lighting"]["lights"][:1]
    plain["objects"] = [{**plain["objects"][0], "texture": {"kind": "uniform", "radiance": 0.4}}]
    plain["objects"][0]["mesh"] = {"kind": "plane", "size_mm": [900, 900]}
    found = st.simulate(plain, truth_content="complete_with_light", save_radiance=True)
    radiance = found.recording["radiance"].sel(s=0).transpose("channel", "t", "y", "x").astype(float)
    parts = [found.truth[f"{name}_share"] * found.truth["surface_radiance"] for name in SHARES]
    assert float(radiance.std(["t", "y", "x"]).max()) < 1e-6 < float(radiance.std("channel").min())
    np.testing.assert_allclose(sum(parts), radiance, rtol=3e-7)


def test_surfaces_brighter_than_white_are_refused_with_their_band() -> None:
    plain = coloured()
    plain["objects"][0]["tint"] = by_band(0.2, 1.0, 1.8)
    with pytest.raises(
        st.SceneError, match=r"objects\.0\.tint: the texture times the tint reaches 1\..* in the band 'nir"
    ):
        st.simulate(plain)


def test_what_supports_grey_cameras_only_says_so() -> None:
    plain = coloured(sensor={"noise_std": 0.01})
    for refuse in (st.design.predict, st.design.budget):
        with pytest.raises(st.SceneError, match=r"camera\.bands: .*Scene\.in_band"):
            refuse(plain)
    with pytest.raises(st.SceneError, match=r"render\.backend: OpenGL cannot render bands; use raycast or auto"):
        st.simulate({**plain, "render": {"backend": "pyrender"}})
    with pytest.raises(st.ArgumentError, match=r"band: is not one of the bands of the camera \(red, green, nir_850\)"):
        st.Scene.from_dict(plain).in_band("blue")


@pytest.mark.filterwarnings("ignore::scenetruth.errors.SceneWarning")
def test_exports_contain_red_green_and_blue_or_name_the_bands(tmp_path: Path) -> None:
    plain = uniform({"noise_std": 0.0}, (16, 12))
    plain["objects"][0]["tint"] = {"red": 0.2, "green": 0.6, "blue": 1.0}
    plain["camera"]["bands"] = ["blue", "green", "red"]
    st.export(st.simulate(plain), "coco", output=tmp_path / "colours")
    for file in (tmp_path / "colours" / "images").glob("*.png"):
        np.testing.assert_array_equal(np.asarray(Image.open(file))[0, 0], [26, 77, 128])
    plain["objects"][0]["tint"] = {"red": 0.2, "nir_850": 0.6}
    plain["camera"]["bands"] = ["red", "nir_850"]
    simulation = st.simulate(plain)
    with pytest.raises(st.errors.ExportError, match=r"channel: are neither grey nor red, green and blue"):
        st.export(simulation, "coco", output=tmp_path / "pictures")
    st.export(simulation, "npz", output=tmp_path / "arrays")
    with pytest.raises(st.ArgumentError, match="save_images: must be tiff for a camera with bands"):
        st.run_scene(plain, stages=("render",), output=tmp_path / "run", save_images="png")


def test_cost_grows_with_the_bands() -> None:
    def cost(plain: dict[str, Any]) -> tuple[float, float, float]:
        scene = st.Scene.from_dict(plain)
        found = compute_workload(scene, list_object_workloads(scene)[0])
        forecast = estimate_cost(found, ["render"], slower=1.0).stages["render"]
        return forecast.memory_bytes, forecast.disk_bytes, forecast.seconds

    grey = uniform({"noise_std": 0.01}, (640, 480))
    del grey["camera"]["bands"]
    assert all(
        more > less for more, less in zip(cost(uniform({"noise_std": 0.01}, (640, 480))), cost(grey), strict=True)
    )


def test_models_are_restricted_to_a_band() -> None:
    lighting = Lighting.model_validate({"ambient": {"a": 0.1, "b": 0.2}})
    assert [where for where, _ in find_by_band(lighting)] == [("ambient",)]
    assert in_band(lighting, "b").ambient_irradiance == 0.2
    assert in_band(Lighting(ambient=0.3), "b") == Lighting(ambient=0.3)
    with pytest.raises(TypeError, match="differs between bands"):
        as_number(ByBand(a=1.0, b=2.0))
