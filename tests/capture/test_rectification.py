"""Resampling to an ideal rig: geometry against the projection of the calibration, images against formulas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st_
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import binary_erosion

from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration, import_capture
from scenetruth.capture.calibration import RigGeometry
from scenetruth.errors import CaptureError
from scenetruth.storage import load_store
from tests.helpers.skewed_rigs import CAMERA, POSITIONS_MM, plane_image, skewed_rig, write_folder

DEPTH_MM = 400.0
Array = NDArray[np.float64]


def geometry_of(rig: RigCalibration) -> RigGeometry:
    return RigGeometry.from_values(rig.values, rig.layout, rig.positions_mm, rig.reference)


def ideal_axes(rig: RigCalibration) -> Array:
    """X along the axis; Z in the plane of the axis and of Z of the reference camera."""
    x = rig.axis
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def recorded(rig: RigCalibration, depth_mm: float = DEPTH_MM, noise: Array | None = None) -> Array:
    """Return what the real cameras record of a plane Z = depth in the frame of the ideal rig, shape (s, 1, y, x)."""
    geometry, axes = geometry_of(rig), ideal_axes(rig)
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays = CAMERA.ray_directions(np.stack([columns, rows], axis=-1)).reshape(-1, 3)
    images = []
    for centre, rotation in zip(geometry.centres_mm, geometry.rotations, strict=True):
        origin = geometry.to_reference(centre) @ axes
        along = rays @ rotation.T @ geometry.frame[1] @ axes
        points = origin + (depth_mm - origin[2]) / along[:, 2:] * along
        images.append(plane_image(points).reshape(rows.shape))
    return np.array(images)[:, None]


def ideal_image(recording: xr.Dataset, s: int, depth_mm: float = DEPTH_MM) -> Array:
    """Return the image of the plane by the camera that a recording describes."""
    c_x, c_y = recording.attrs["principal_point_px"]
    y, x = np.mgrid[: recording.sizes["y"], : recording.sizes["x"]].astype(float)
    rays = np.dstack([x - c_x, y - c_y, np.full_like(x, recording.attrs["focal_length_px"])])
    points = depth_mm / recording.attrs["focal_length_px"] * rays
    points[..., 0] += float(recording["stage_x_mm"][s])
    return plane_image(points)


def away_from_borders(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where the mirrored border of an image has no effect on its spline, to 0.43^6."""
    return np.asarray(binary_erosion(known, iterations=6))


@given(seed=st_.integers(0, 10**6), size=st_.floats(0.0, 3.0), depth=st_.floats(200.0, 2000.0))
@settings(deadline=None, max_examples=20)
def test_points_are_found_where_the_calibration_projects_them(seed: int, size: float, depth: float) -> None:
    from scenetruth.capture.rectification import recorded_pixels, step_factor

    rig = skewed_rig(seed, size, aspect=2e-3)
    points = np.random.default_rng(seed).uniform([-15, -10, 0.9 * depth], [15, 10, 1.1 * depth], (20, 3))
    geometry, axes = geometry_of(rig), ideal_axes(rig)
    expected = geometry.project(geometry.to_stage(points @ axes.T))
    for position, x_mm in enumerate(POSITIONS_MM):
        inside = points - np.array([step_factor(rig) * x_mm, 0.0, 0.0])
        np.testing.assert_allclose(recorded_pixels(rig, inside, position), expected[position], atol=1e-8)


@pytest.mark.parametrize("stored", [False, True])
def test_rectified_images_are_those_of_an_ideal_rig(tmp_path: Path, *, stored: bool) -> None:
    rig = skewed_rig(1)
    write_folder(tmp_path / "lab", recorded(rig), DEPTH_MM)
    found = import_capture(tmp_path / "lab", calibration=rig, output=tmp_path / "run" if stored else None)
    if stored:
        assert load_store(tmp_path / "run" / "recording.zarr").identical(found.load())
    along = np.hypot(1.0, np.hypot(3e-3, 4e-3)) * (1 + 2e-3)
    np.testing.assert_allclose(found.stage_x_mm, np.array(POSITIONS_MM) * along, rtol=1e-12)
    assert found.attrs["baseline_mm"] == pytest.approx(4.0 * along)
    assert "distortion" not in found.attrs
    for s in range(3):
        image = found.image[s, 0].values / 65535
        known = np.isfinite(image)
        # Displacements of the guide along Z and Y, roll and lens move borders by 2 px, splines need 3 more.
        assert known[8:-8, 8:-8].all()
        # Waves of 7.5 px and more: the spline is right to 1e-3 of the contrast; 16 bits.
        within = away_from_borders(known)
        np.testing.assert_allclose(image[within], ideal_image(found, s)[within], atol=5e-4)
    # The recorded image is displaced by tenths of a pixel.
    assert np.abs(recorded(rig)[2, 0] - ideal_image(found, 2))[8:-8, 8:-8].max() > 0.01


def test_a_plane_of_a_mosaic_is_rectified(tmp_path: Path) -> None:
    rig = skewed_rig(2)
    colours = {"bayer": "grbg", "plane": "blue"}
    write_folder(tmp_path, recorded(rig), DEPTH_MM, camera=colours)
    found = import_capture(tmp_path, calibration=rig)
    assert found.attrs["focal_length_px"] == 500
    image = found.image[0, 0].values / 65535
    known = np.isfinite(image)
    assert known[5:-5, 5:-5].all()
    # Waves of 3.75 px of this plane.
    within = away_from_borders(known)
    np.testing.assert_allclose(image[within], ideal_image(found, 0)[within], atol=0.02)
    write_folder(tmp_path, recorded(rig), DEPTH_MM, camera={"bayer": "grbg"})
    with pytest.raises(CaptureError, match="must be red, green or blue"):
        import_capture(tmp_path, calibration=rig)


def test_noise_share_is_the_variance_of_resampled_noise(tmp_path: Path) -> None:
    rig = skewed_rig(3)
    generator = np.random.default_rng(0)
    noise = generator.uniform(0.2, 0.8, (3, 40, CAMERA.height, CAMERA.width))
    write_folder(tmp_path, noise, DEPTH_MM)
    found = import_capture(tmp_path, calibration=rig)
    assert found.noise_share.dims == ("s", "y", "x")
    image = found.image.values[:, :, 8:-8, 8:-8] / 65535
    measured = np.square(image - 0.5).mean(axis=1) / (0.6**2 / 12)
    share = found.noise_share.values[:, 8:-8, 8:-8]
    assert share.min() < 0.75
    # 40 images of 4,480 pixels; kurtosis of uniform noise; classes of equal share.
    order = np.argsort(share.ravel())
    for part in np.array_split(order, 8):
        assert measured.ravel()[part].mean() == pytest.approx(share.ravel()[part].mean(), rel=0.02)


def test_without_errors_only_the_lens_resamples(tmp_path: Path) -> None:
    camera = Camera(width=96, height=72, focal_length_px=1000)
    plain = RigCalibration.from_camera(camera, POSITIONS_MM)
    images = np.random.default_rng(1).uniform(0.2, 0.8, (3, 2, 72, 96))
    write_folder(tmp_path, images, DEPTH_MM)
    found = import_capture(tmp_path, calibration=plain)
    np.testing.assert_allclose(found.image.values / 65535, images, atol=1e-5)
    np.testing.assert_allclose(found.noise_share, 1.0, atol=1e-6)
    assert found.attrs["principal_point_px"] == [47.5, 35.5]


@pytest.mark.parametrize("depth_mm", [300.0, 700.0])
def test_distance_is_found_from_the_images(tmp_path: Path, depth_mm: float) -> None:
    rig = skewed_rig(4)
    write_folder(tmp_path, recorded(rig, depth_mm), None)
    # Disparities of 13 and 6 px, to a quarter of a pixel.
    assert import_capture(tmp_path, calibration=rig).attrs["rectified_depth_mm"] == pytest.approx(depth_mm, rel=0.04)


def test_distance_is_asked_for_where_images_show_none(tmp_path: Path) -> None:
    noise = np.random.default_rng(5).uniform(0.2, 0.8, (3, 1, 72, 96))
    write_folder(tmp_path, noise, None)
    with pytest.raises(CaptureError, match="distance_mm: is missing, and the images do not determine it"):
        import_capture(tmp_path, calibration=skewed_rig())


def test_missing_saturated_and_masked_pixels_stay_invalid(tmp_path: Path) -> None:
    rig = skewed_rig(6)
    images = recorded(rig)
    images[0, 0, 30:33, 40:43] = 1.0
    write_folder(tmp_path, images, DEPTH_MM)
    (tmp_path / "s+1_t+0.tif").unlink()
    with pytest.warns(match="1 image is missing"):
        found = import_capture(tmp_path, calibration=rig)
    assert np.isnan(found.image[2]).all()
    image = found.image[0, 0].values / 65535
    known = np.isfinite(image)
    assert not known[30:33, 40:43].all()
    assert known[8:-8, 8:-8].mean() > 0.95
    within = away_from_borders(known)
    np.testing.assert_allclose(image[within], ideal_image(found, 0)[within], atol=5e-4)


def test_excluded_pixels_move_with_the_images(tmp_path: Path) -> None:
    rig = skewed_rig(8)
    plain = write_folder(tmp_path, recorded(rig), DEPTH_MM, files={"mask": "mask.tif"})
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8)
    mask[30, 40] = 255
    tifffile.imwrite(tmp_path / "mask.tif", mask)
    assert plain["files"]["mask"] == "mask.tif"
    found = import_capture(tmp_path, calibration=rig, output=tmp_path / "run")
    assert found.exclusion_mask.dims == ("s", "y", "x")
    geometry, axes = geometry_of(rig), ideal_axes(rig)
    for s in range(3):
        excluded = found.exclusion_mask.values[s]
        c_x, c_y = found.attrs["principal_point_px"]
        rows, columns = np.nonzero(excluded[8:-8, 8:-8])
        ray = np.array([columns.mean() + 8 - c_x, rows.mean() + 8 - c_y, found.attrs["focal_length_px"]])
        point = ray * DEPTH_MM / ray[2] + [float(found.stage_x_mm[s]), 0, 0]
        # The spline of 7 x 7 pixels around the excluded pixel.
        assert 40 <= excluded[8:-8, 8:-8].sum() <= 60
        seen = geometry.project(geometry.to_stage(point[None] @ axes.T))[s, 0]
        np.testing.assert_allclose(seen, [40, 30], atol=0.6)


def test_pixels_that_are_not_square_need_resampled_images(tmp_path: Path) -> None:
    # 2e-3 of half the 72 rows: 0.07 px.
    rig = skewed_rig(aspect=2e-3)
    write_folder(tmp_path, recorded(rig), DEPTH_MM)
    with pytest.raises(CaptureError, match="pixels that are not square"):
        import_capture(tmp_path, calibration=rig, geometry="recorded")


def test_calibrations_of_other_rigs_are_rejected(tmp_path: Path) -> None:
    rig = skewed_rig()
    images = recorded(rig)
    write_folder(tmp_path / "size", images[..., :90], DEPTH_MM)
    with pytest.raises(CaptureError, match="96 x 72 px, but the images have 90 x 72 px"):
        import_capture(tmp_path / "size", calibration=rig)
    write_folder(tmp_path / "step", images, DEPTH_MM, stage={"baseline_mm": 5.0})
    with pytest.raises(CaptureError, match=r"positions -4, 0, 4 mm, but the stage has -5, 0, 5 mm"):
        import_capture(tmp_path / "step", calibration=rig)
    write_folder(tmp_path / "count", images[:2], DEPTH_MM)
    with pytest.raises(CaptureError, match=r"has 3 positions .* but the stage has 2"):
        import_capture(tmp_path / "count", calibration=rig)
    write_folder(tmp_path / "lab", images, DEPTH_MM)
    with pytest.raises(CaptureError, match="undistort: must not be combined"):
        import_capture(tmp_path / "lab", calibration=rig, undistort=True)
    file = rig.save(tmp_path / "calibration.yaml")
    assert import_capture(tmp_path / "lab", calibration=file).identical(
        import_capture(tmp_path / "lab", calibration=rig)
    )


def test_only_new_visits_keep_a_tolerance(tmp_path: Path) -> None:
    rig = skewed_rig()
    given = {"errors": {"preset": "screw_stage", "repeatability_um": 1.5}, "step_std": 1e-3}
    write_folder(tmp_path, recorded(rig), DEPTH_MM, stage=given)
    found = import_capture(tmp_path, calibration=rig)
    stated = {name: value for name, value in found.attrs.items() if name.startswith("stage_tolerance")}
    assert stated == {"stage_tolerance_repeatability_um": 1.5}


@given(place=st_.floats(-3.0, 3.0))
@settings(deadline=None, max_examples=20)
def test_share_is_the_sum_of_the_squared_weights(place: float) -> None:
    from scenetruth.capture.corrections import spline_share

    # An independent implementation of interpolating splines.
    weights = make_interp_spline(np.arange(65.0), np.eye(65), k=5)(32 + place)
    assert spline_share(np.array([place]), 5)[0] == pytest.approx(np.square(weights).sum(), abs=1e-5)
