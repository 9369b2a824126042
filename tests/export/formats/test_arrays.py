"""Plain archives and images: npz, png, tiff."""

from __future__ import annotations

import json

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from tests.export.conftest import Export
from tests.export.readers import opencv_image


@pytest.mark.parametrize("compress", [True, False])
def test_archives_hold_every_variable(export: Export, recording: xr.Dataset, truth: xr.Dataset, compress: bool) -> None:
    done = export("npz", compress=compress)
    for name, dataset in (("recording", recording), ("truth", truth)):
        with np.load(done.folder / f"{name}.npz") as found:
            assert set(found) == {"meta", *map(str, dataset.variables)}
            for key, item in dataset.variables.items():
                np.testing.assert_array_equal(found[str(key)], item.values)
                assert found[str(key)].dtype.kind in "fiubU"
            meta = json.loads(str(found["meta"]))
    assert meta["variables"]["flow_next"] == {
        "dims": ["image_component", "s", "t", "y", "x"],
        "units": "px",
        "long_name": "where the surface point is in the camera's image of t + 1, minus the pixel",
    }
    assert meta["attributes"]["focal_length_px"] == 80
    assert meta["attributes"]["principal_point_px"] == [31.5, 23.5]


def test_images_as_16_bit_png_and_float_tiff(export: Export, recording: xr.Dataset) -> None:
    png, tiff = export("png"), export("tiff")
    assert len(png.files) == len(tiff.files) == 9
    for s, t in ((-1, 0), (1, 1)):
        expected = recording.image.sel(s=s, t=t).values
        values = opencv_image(png.folder / "images" / f"s{s:+d}_t{t:+d}.png")
        assert values.dtype == np.uint16
        assert np.abs(values / 65535 - expected).max() <= 0.5 / 65535 + 1e-7
        np.testing.assert_array_equal(imageio.imread(tiff.folder / "images" / f"s{s:+d}_t{t:+d}.tiff"), expected)


def test_colours_are_written_as_far_as_formats_take_them(tmp_path: str) -> None:
    images = np.random.default_rng(0).random((2, 1, 6, 8, 3)).astype(np.float32)
    recording = st.make_recording(images, focal_length_px=50, baseline_mm=2)
    estimate = st.make_estimate(depth=np.full((1, 6, 8), 90.0), recording=recording)
    with pytest.raises(st.ExportError, match=r"image: has colours.*use tiff"):
        st.export((recording, estimate), "png", output=f"{tmp_path}/png")
    with pytest.raises(st.ExportError, match="image_bits: must be 8 for colours"):
        st.export((recording, estimate), "pfm", output=f"{tmp_path}/pfm", image_bits=16)
    done = st.export((recording, estimate), "tiff", output=f"{tmp_path}/tiff")
    np.testing.assert_array_equal(imageio.imread(done.folder / "images" / "s+0_t+0.tiff"), images[0, 0])
    done = st.export((recording, estimate), "pfm", output=f"{tmp_path}/pfm")
    found = imageio.imread(done.folder / "t+0" / "im0.png")
    assert np.abs(found / 255 - images[0, 0]).max() <= 0.5 / 255 + 1e-6
