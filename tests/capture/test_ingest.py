"""Recordings from image files: order, missing files, times, bit depth, and every mistake of a folder by name."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import map_coordinates

import scenetruth
from scenetruth.errors import CaptureError, CaptureWarning
from tests.helpers.captured_folders import texture

SHAPE = (12, 16)


def write_all(
    folder: Path, images: NDArray[Any], name: str = "pos{s}_t{t:03d}.tif", first: tuple[int, int] = (0, 0)
) -> dict[tuple[int, int], Path]:
    """Write images (s, t, y, x[, channel]) under names of a format."""
    files = {}
    for s, t in np.ndindex(*images.shape[:2]):
        file = folder / name.format(s=s + first[0], t=t + first[1])
        file.parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(file, images[s, t])
        files[s, t] = file
    return files


def stack(positions: int = 3, frames: int = 4, bits: int = 12, seed: int = 1) -> NDArray[np.uint16]:
    draw = np.random.default_rng(seed)
    images = draw.integers(0, 2**bits - 1, (positions, frames, *SHAPE)).astype(np.uint16)
    images[..., 0, 0] = 2**bits - 2  # uses all bits, without saturation
    return images


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    st.integers(1, 5),
    st.integers(1, 12),
    st.sampled_from(["pos{s}_t{t}.tif", "s{s:+d}_t{t:+d}.tif", "p{s:02d}/{t:04d}.tif", "t{t:03d}_x{s}.tif"]),
    st.sampled_from([(0, 0), (1, 1), (0, 95)]),
)
def test_images_stand_at_their_indices(
    tmp_path_factory: pytest.TempPathFactory, positions: int, frames: int, name: str, first: tuple[int, int]
) -> None:
    """Also where names sort differently from numbers, as t10 before t9."""
    folder = tmp_path_factory.mktemp("images")
    images = stack(positions, frames)
    write_all(folder, images, name, first)
    found = scenetruth.read_images(folder / name, 500, 5, bit_depth=12)
    assert np.array_equal(found.image, images)
    assert found.image.dtype == np.uint16
    expected = scenetruth.make_recording(images, 500, 5, full_scale=4095)
    assert found.drop_vars("image").equals(expected.drop_vars("image"))
    assert found.attrs == expected.attrs


def test_rows_make_a_grid(tmp_path: Path) -> None:
    images = np.stack([stack(2, 2, seed=row) for row in range(3)])
    for row in range(3):
        write_all(tmp_path, images[row], f"r{row}_s{{s}}_t{{t}}.tif")
    found = scenetruth.read_images(
        tmp_path / "r{row}_s{s}_t{t}.tif", 500, 5, bit_depth=12, stage_y_mm=[-3, 0, 3]
    )  # fmt: skip
    assert np.array_equal(found.image, images)
    with pytest.raises(CaptureError, match="stage_y_mm"):
        scenetruth.read_images(tmp_path / "r{row}_s{s}_t{t}.tif", 500, 5, bit_depth=12)


def test_missing_images_are_named_and_invalid(tmp_path: Path) -> None:
    images = stack()
    images[0, 0, 5, 6] = 4095
    files = write_all(tmp_path, images)
    for index in ((1, 2), (2, 0)):
        files[index].unlink()
    with pytest.warns(CaptureWarning, match=r"2 images are missing .*: pos1_t002.tif, pos2_t000.tif"):
        found = scenetruth.read_images(tmp_path / "pos{s}_t{t:03d}.tif", 500, 5, bit_depth=12)
    assert json.loads(found.attrs["missing_images"]) == ["pos1_t002.tif", "pos2_t000.tif"]
    invalid = np.isnan(found.image)
    assert invalid.sum() == 2 * SHAPE[0] * SHAPE[1] + 1
    assert invalid[1, 2].all()
    assert invalid[2, 0].all()
    assert invalid[0, 0, 5, 6]  # saturated, which floats have no other mark for
    seen = np.isfinite(found.image.values)
    assert np.array_equal(found.image.values[seen], images[seen].astype(np.float32))
    assert found.attrs["full_scale"] == 4095


def test_first_and_last_files_are_missed_only_if_their_number_is_given(tmp_path: Path) -> None:
    files = write_all(tmp_path, stack(3, 4), first=(1, 1))
    files[0, 0].unlink()
    for t in range(4):
        files[2, t].unlink()
    pattern = tmp_path / "pos{s}_t{t:03d}.tif"
    with pytest.warns(CaptureWarning, match=r"1 image is missing"):
        assert scenetruth.read_images(pattern, 500, 5, bit_depth=12).sizes["s"] == 2
    with pytest.raises(CaptureError, match=r"open whether the 3 run from 0 to 2 or from 1 to 3.*first_position"):
        scenetruth.read_images(pattern, 500, 5, bit_depth=12, positions=3)
    with pytest.warns(CaptureWarning, match=r"5 images are missing"):
        found = scenetruth.read_images(pattern, 500, 5, bit_depth=12, positions=3, first_position=1)
    assert np.isnan(found.image[2]).all()
    with pytest.raises(CaptureError, match="beyond 0 to 1"):
        scenetruth.read_images(pattern, 500, 5, bit_depth=12, positions=2, first_position=0)
    with pytest.raises(CaptureError, match="more than 2"):
        scenetruth.read_images(pattern, 500, 5, bit_depth=12, frames=2)


def test_wrong_pattern_gets_the_nearest(tmp_path: Path) -> None:
    write_all(tmp_path, stack())
    with pytest.raises(CaptureError, match=r"nearest: pos\{s\}_t\{t:03d\}.tif \(12 files\)"):
        scenetruth.read_images(tmp_path / "pos{s}_t{t:02d}.tif", 500, 5)
    (tmp_path / "empty").mkdir()
    with pytest.raises(CaptureError, match="no image files"):
        scenetruth.read_images(tmp_path / "empty" / "pos{s}_t{t}.tif", 500, 5)
    with pytest.raises(CaptureError, match="folder does not exist"):
        scenetruth.read_images(tmp_path / "nothing" / "pos{s}_t{t}.tif", 500, 5)


def test_all_problems_of_a_folder_come_together_before_any_image_is_read(tmp_path: Path) -> None:
    files = write_all(tmp_path, stack())
    files[0, 1].write_text("no image")
    tifffile.imwrite(files[1, 1], np.zeros(SHAPE[::-1], dtype=np.uint16))
    tifffile.imwrite(files[1, 2], stack()[0, 0], extratags=[(274, "H", 1, 6, False)])
    tifffile.imwrite(files[2, 2], np.zeros(SHAPE, dtype=np.uint8))
    (tmp_path / "pos0_t0002.tif").write_bytes(files[0, 2].read_bytes())
    with pytest.raises(CaptureError) as caught:
        scenetruth.read_images(tmp_path / "pos{s}_t{t}.tif", 500, 5, bit_depth=12)
    listed = {problem.path: problem.message for problem in caught.value.problems}
    assert "two files of the same image (s = 0, t = 2)" in listed["pattern"]
    assert "cannot be read" in listed["pos0_t001.tif"]
    assert "exchanged" in listed["pos1_t001.tif"]
    assert "Exif orientation 6" in listed["pos1_t002.tif"]
    assert "8 bits per value, fewer than the 12" in listed["pos2_t002.tif"]


def test_bit_depth_is_checked_by_the_values(tmp_path: Path) -> None:
    write_all(tmp_path, stack(bits=12))
    pattern = tmp_path / "pos{s}_t{t:03d}.tif"
    with pytest.raises(CaptureError, match="values up to 4,094, more than the 1,023 of 10 bits"):
        scenetruth.read_images(pattern, 500, 5, bit_depth=10)
    with pytest.warns(CaptureWarning, match="no value needs more than 12 of the 16 bits"):
        scenetruth.read_images(pattern, 500, 5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenetruth.read_images(pattern, 500, 5, bit_depth=12)
    for file in tmp_path.iterdir():
        tifffile.imwrite(file, tifffile.imread(file) << 4)
    with pytest.raises(CaptureError, match="multiples of 16: the numbers are stored in the upper bits"):
        scenetruth.read_images(pattern, 500, 5, bit_depth=12)


def test_times_of_the_names_are_those_of_the_images(tmp_path: Path) -> None:
    images = stack(2, 4)
    for s, t in np.ndindex(2, 4):
        if (s, t) != (1, 1):
            tifffile.imwrite(tmp_path / f"s{s}_{t}_20240301-12{t:02d}{3 * s:02d}.tif", images[s, t])
    with pytest.warns(CaptureWarning, match="1 image is missing"):
        found = scenetruth.read_images(tmp_path / "s{s}_{t}_{time:%Y%m%d-%H%M%S}.tif", 500, 5, bit_depth=12)
    assert found.attrs["frame_interval_s"] == 60
    # Position s = 1 is taken 3 s later; the reference is position 0, frame 1.
    assert found.planned_time_s.values.tolist() == [[-60, 0, 60, 120], [-57, 3, 63, 123]]


def test_plane_of_a_mosaic_has_the_geometry_of_its_pixels(tmp_path: Path) -> None:
    images = stack(2, 2)
    write_all(tmp_path, images)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[3, 4] = True
    options: dict[str, Any] = {"bit_depth": 12, "bayer": "grbg", "principal_point_px": (8.0, 6.5), "line_time_s": 1e-5}
    pattern = tmp_path / "pos{s}_t{t:03d}.tif"
    blue = scenetruth.read_images(pattern, 500, 5, plane="blue", exclusion_mask=mask, **options)
    assert np.array_equal(blue.image, images[..., 1::2, 0::2])
    assert blue.exclusion_mask.values.sum() == 1
    assert blue.exclusion_mask.values[1, 2]
    assert blue.attrs["focal_length_px"] == 250
    assert blue.attrs["principal_point_px"] == [4.0, 2.75]
    assert blue.attrs["line_time_s"] == 2e-5
    whole = scenetruth.read_images(pattern, 500, 5, **options)
    assert np.array_equal(whole.image, images)
    assert whole.attrs["principal_point_px"] == [8.0, 6.5]


def test_colours_have_channels(tmp_path: Path) -> None:
    images = np.random.default_rng(1).integers(0, 256, (2, 2, *SHAPE, 3)).astype(np.uint8)
    write_all(tmp_path, images)
    found = scenetruth.read_images(tmp_path / "pos{s}_t{t:03d}.tif", 500, 5)
    assert found.image.dims == ("s", "t", "y", "x", "channel")
    assert np.array_equal(found.image, images)
    with pytest.raises(CaptureError, match="a Bayer mosaic has one"):
        scenetruth.read_images(tmp_path / "pos{s}_t{t:03d}.tif", 500, 5, bayer="rggb")


def test_encoded_images_are_linear_radiance(tmp_path: Path) -> None:
    light = np.random.default_rng(1).uniform(0, 1, (1, 2, *SHAPE))
    for t in range(2):
        Image.fromarray(np.rint(255 * light[0, t] ** (1 / 2.2)).astype(np.uint8)).save(tmp_path / f"t{t}.png")
    found = scenetruth.read_images(tmp_path / "t{t}.png", 500, 5, encoding="gamma")
    assert found.attrs["full_scale"] == 1
    assert float(np.nanmax(np.abs(found.image - light))) < 2.2 * 0.5 / 255 + 1e-6


@pytest.mark.parametrize(
    ("options", "paths"),
    [
        ({"bit_depth": 17}, ["bit_depth"]),
        ({"encoding": "log", "gamma": 0}, ["encoding", "gamma"]),
        ({"bayer": "rgb", "plane": "white"}, ["bayer", "plane"]),
        ({"plane": "red"}, ["plane"]),
        ({"focal_mm": 3}, ["focal_mm"]),
    ],
)
def test_invalid_arguments_are_found_first(options: dict[str, Any], paths: list[str]) -> None:
    with pytest.raises(CaptureError) as caught:
        scenetruth.read_images("no_folder/{s}.png", 500, 5, **options)
    assert [problem.path for problem in caught.value.problems] == paths


def test_invalid_geometry_names_its_argument(tmp_path: Path) -> None:
    write_all(tmp_path, stack())
    with pytest.raises(CaptureError, match="stage_x_mm"):
        scenetruth.read_images(tmp_path / "pos{s}_t{t:03d}.tif", 500, 5, bit_depth=12, stage_x_mm=[0, 1])
    with pytest.raises(CaptureError, match="focal_length_px"):
        scenetruth.read_images(tmp_path / "pos{s}_t{t:03d}.tif", -500, 5, bit_depth=12)


def test_progress_counts_images(tmp_path: Path) -> None:
    write_all(tmp_path, stack())
    seen: list[tuple[str, int, int]] = []
    scenetruth.read_images(
        tmp_path / "pos{s}_t{t:03d}.tif", 500, 5, bit_depth=12, progress=lambda *each: seen.append(each)
    )
    assert seen == [("read", number + 1, 12) for number in range(12)]


def test_missing_images_do_not_prevent_an_estimate(tmp_path: Path) -> None:
    """The refined method leaves them out; filters over whole scans reject them."""
    surface = texture((60, 110), 3, 8.0)
    y, x = np.mgrid[:44, :60].astype(float)
    noise = np.random.default_rng(1)
    images = [
        [255 * map_coordinates(surface, [y + 8, x + 25 + 4 * s], order=5) + noise.normal(0, 1, y.shape)]
        for s in range(-2, 3)
    ]
    files = write_all(tmp_path, np.rint(images).astype(np.uint8))
    files[3, 0].unlink()
    with pytest.warns(CaptureWarning, match="pos3_t000"):
        holed = scenetruth.read_images(tmp_path / "pos{s}_t{t:03d}.tif", 500, 5)
    with pytest.raises(scenetruth.EstimateError, match="no valid pixel"):
        scenetruth.estimate(holed, "plane_sweep")
    estimate = scenetruth.estimate(holed, "refined").sel(t=0)
    assert json.loads(estimate.attrs["excluded_images"]) == [[1, 0]]
    depth = estimate.depth.where(np.isfinite(estimate.depth_std))
    assert float(depth.notnull().mean()) > 0.5
    # f B / d = 500 x 5 / 4.
    assert abs(float(depth.median()) - 625) < 1
