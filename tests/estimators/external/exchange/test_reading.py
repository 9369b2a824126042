"""What programs leave: every form and shape is the same estimate, and everything that is wrong is told at once."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.external import read_results
from scenetruth.exporters.image_files import write_flo, write_pfm

Array = NDArray[Any]
Make = Callable[..., xr.Dataset]
SIZE = (3, 36, 48)


@pytest.fixture
def recording(recording_of: Make) -> xr.Dataset:
    return recording_of(np.uint8, 0, 255)


def maps() -> dict[str, Array]:
    """Return all quantities, (c, t, y, x) or (t, y, x), float32, with some pixels unknown."""
    draws = np.random.default_rng(5)
    depth = draws.uniform(80, 120, SIZE)
    found = {
        "depth": depth,
        # f V_X / Z, as `recording_of` has it.
        "disparity": 80.0 * 5.0 / depth,
        "flow": draws.normal(size=(2, *SIZE)),
        "velocity": draws.normal(size=(3, *SIZE)),
        "depth_std": draws.uniform(0, 1, SIZE),
        "disparity_std": draws.uniform(0, 1, SIZE),
        "velocity_std": draws.uniform(0, 1, (3, *SIZE)),
    }
    unknown = draws.random(SIZE) < 0.1
    for values in found.values():
        values[..., unknown] = np.nan
    return {name: values.astype(np.float32) for name, values in found.items()}


def same(found: xr.Dataset, expected: xr.Dataset) -> None:
    assert set(found.data_vars) == set(expected.data_vars)
    for name in expected.data_vars:
        assert np.array_equal(found[name].values, expected[name].values, equal_nan=True), name
    assert found["t"].values.tolist() == expected["t"].values.tolist()


def write_npz(file: Path, values: Array) -> None:
    np.savez_compressed(file, some_name=values)


def write_old_zarr(file: Path, values: Array) -> None:
    zarr.save_array(file, values, zarr_format=2)


def write_zarr_group(file: Path, values: Array) -> None:
    zarr.save_group(file, some_name=values)


def damaged_zarr(folder: Path) -> None:
    zarr.save_array(folder / "depth.zarr", DEPTH)
    (folder / "depth.zarr" / "zarr.json").write_text('{"zarr_format": 3, "node_type": "array"}')


def write_colour_pfm(file: Path, values: Array) -> None:
    """Write three components as the colours of a PFM, big endian: a positive scale says so."""
    _, height, width = values.shape
    known = np.where(np.isfinite(values), values, np.inf)
    rows = np.moveaxis(known, 0, -1)[::-1].astype(">f4")
    file.write_bytes(f"PF\n{width} {height}\n1.0\n".encode() + rows.tobytes())


def test_arrays_of_all_quantities_are_those_of_make_estimate(recording: xr.Dataset, tmp_path: Path) -> None:
    arrays = maps()
    for name, values in arrays.items():
        np.save(tmp_path / f"{name}.npy", values)
    same(read_results(tmp_path, recording), st.make_estimate(recording=recording, **arrays))  # type: ignore[arg-type]


def test_flow_and_the_rate_of_depth_make_velocity(recording: xr.Dataset, tmp_path: Path) -> None:
    arrays = {name: maps()[name] for name in ("depth", "flow")}
    arrays["depth_rate"] = np.full(SIZE, -0.5, dtype=np.float32)
    arrays["status"] = np.random.default_rng(6).integers(0, 3, SIZE).astype(np.uint8)
    for name, values in arrays.items():
        np.save(tmp_path / f"{name}.npy", values)
    found = read_results(tmp_path, recording)
    same(found, st.make_estimate(recording=recording, **arrays))  # type: ignore[arg-type]
    assert {"velocity", "status"} <= set(found.data_vars)


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("frames", [True, False])
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8"])
@pytest.mark.parametrize("name", ["depth", "flow", "velocity"])
def test_every_shape_means_the_same(
    name: str, dtype: str, frames: bool, last: bool, recording: xr.Dataset, tmp_path: Path
) -> None:
    values = maps()[name]
    values = values if frames else values[..., 1, :, :]
    expected = st.make_estimate(recording=recording, **{name: values})  # type: ignore[arg-type]
    if last and name != "depth":
        values = np.moveaxis(values, 0, -1)
    np.save(tmp_path / f"{name}.npy", values.astype(dtype))
    found = read_results(tmp_path, recording)
    same(found, expected)
    assert found.sizes["t"] == (3 if frames else 1)


@pytest.mark.parametrize(
    ("name", "ending", "write"),
    [
        ("depth", ".npy", np.save),
        ("depth", ".npz", write_npz),
        ("depth", ".pfm", write_pfm),
        ("depth", ".zarr", zarr.save_array),
        ("velocity", ".zarr", write_old_zarr),
        ("flow", ".zarr", write_zarr_group),
        ("flow", ".npz", write_npz),
        ("flow", ".flo", write_flo),
        ("velocity", ".npy", np.save),
        ("velocity", ".pfm", write_colour_pfm),
    ],
)
@pytest.mark.parametrize("frames", [(0,), (-1, 0, 1), (-1, 1)])
def test_every_form_of_file_means_the_same(
    name: str,
    ending: str,
    write: Callable[[Path, Array], None],
    frames: tuple[int, ...],
    recording: xr.Dataset,
    tmp_path: Path,
) -> None:
    values = maps()[name][..., [t + 1 for t in frames], :, :]
    if ending == ".flo":
        # It has one mark for both components.
        values = np.where(np.isfinite(values).all(axis=0), values, np.nan).astype(np.float32)
    for place, t in enumerate(frames):
        file = f"{name}{ending}" if frames == (0,) else f"{name}_t{t:+d}{ending}"
        write(tmp_path / file, values[..., place, :, :])
    expected = st.make_estimate(recording=recording, t=list(frames), **{name: values})  # type: ignore[arg-type]
    same(read_results(tmp_path, recording), expected)


def test_frames_that_only_some_quantities_have_are_unknown_in_the_others(recording: xr.Dataset, tmp_path: Path) -> None:
    arrays = maps()
    np.save(tmp_path / "disparity.npy", arrays["disparity"])
    for t in (-1, 0):
        np.save(tmp_path / f"flow_t{t:+d}.npy", arrays["flow"][:, t + 1])
    found = read_results(tmp_path, recording)
    assert found["t"].values.tolist() == [-1, 0, 1]
    assert np.array_equal(found["flow"].values[:, :2], arrays["flow"][:, :2], equal_nan=True)
    assert np.isnan(found["flow"].values[:, 2]).all()


def test_the_note_tells_frames_units_and_the_method(recording: xr.Dataset, tmp_path: Path) -> None:
    arrays = {name: values[..., :2, :, :].astype(np.float64) for name, values in maps().items()}
    interval_s = recording.attrs["frame_interval_s"]
    assert interval_s == 0.5
    np.save(tmp_path / "depth.npy", arrays["depth"] / 1000)
    np.save(tmp_path / "depth_std.npy", arrays["depth_std"] / 10)
    np.save(tmp_path / "velocity.npy", arrays["velocity"] / interval_s)
    np.save(tmp_path / "flow.npy", arrays["flow"] / interval_s)
    units = {"depth": "m", "depth_std": "cm", "velocity": "mm/s", "flow": "px/s"}
    (tmp_path / "results.json").write_text(json.dumps({"t": [-1, 0], "method": "matcher 2.1", "units": units}))
    found = read_results(tmp_path, recording)
    names = ("depth", "depth_std", "velocity", "flow")
    expected = st.make_estimate(recording=recording, t=[-1, 0], **{name: arrays[name] for name in names})  # type: ignore[arg-type]
    for name in names:
        # float32's rounding of the estimate, once before and once after the factor.
        np.testing.assert_allclose(found[name].values, expected[name].values, rtol=2e-7)
    assert found["t"].values.tolist() == [-1, 0]
    assert found.attrs["method"] == "matcher 2.1"


def test_pixels_of_thinned_out_images_are_those_of_their_columns(recording: xr.Dataset, tmp_path: Path) -> None:
    """A program that sees every second pixel finds half the disparity and half the flow; depth stays."""
    part = recording.isel(x=slice(1, None, 2), y=slice(1, None, 2))
    arrays = {name: maps()[name][..., 1::2, 1::2] for name in ("disparity", "flow", "velocity", "disparity_std")}
    for name, values in arrays.items():
        np.save(tmp_path / f"{name}.npy", values / 2 if name != "velocity" else values)
    same(read_results(tmp_path, part), st.make_estimate(recording=part, **arrays))  # type: ignore[arg-type]


def test_other_files_are_left_alone(recording: xr.Dataset, tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", maps()["depth"])
    (tmp_path / "log.txt").write_text("done")
    (tmp_path / "preview.png").write_bytes(b"")
    (tmp_path / "cache").mkdir()
    np.save(tmp_path / "cache" / "features.npy", np.zeros(3))
    same(read_results(tmp_path, recording), st.make_estimate(recording=recording, depth=maps()["depth"]))


def one(values: Any, name: str = "depth.npy") -> Callable[[Path], None]:
    return lambda folder: np.save(folder / name, values)


def text(name: str, content: str | bytes) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return write


def twice(folder: Path) -> None:
    np.save(folder / "depth.npy", np.ones(SIZE))
    write_pfm(folder / "depth.pfm", np.ones(SIZE[1:]))


DEPTH = np.full(SIZE, 100.0, dtype=np.float32)
WRONG: dict[str, tuple[Callable[[Path], None], str]] = {
    "nothing": (lambda folder: None, "contains no results; write at least one of depth.npy"),
    "near name": (one(DEPTH, "depht.npy"), r"depht\.npy: .* did you mean 'depth'"),
    "strange name": (one(DEPTH, "features.npy"), r"features\.npy: .* valid: depth, disparity"),
    "capitals": (one(DEPTH, "Depth.npy"), r"Depth\.npy: .* did you mean 'depth'"),
    "unread form": (text("depth.exr", "v/1"), r"depth\.exr: has an unsupported format; write \.npy"),
    "unread form of a frame": (text("flow_t+0.tiff", "II"), r"flow_t\+0\.tiff: has an unsupported format"),
    "store": (lambda folder: (folder / "estimate.zarr").mkdir(), r"estimate\.zarr: estimate stores are not supported"),
    "no zarr": (lambda folder: (folder / "depth.zarr").mkdir(), r"depth\.zarr: cannot be read"),
    "damaged zarr": (damaged_zarr, r"depth\.zarr: cannot be read"),
    "two in zarr": (
        lambda folder: zarr.save_group(folder / "depth.zarr", a=DEPTH, b=DEPTH),
        r"must contain one array, or one named 'depth'; got a, b",
    ),
    "zarr as a file": (text("depth.zarr", "v/1"), r"depth\.zarr: has an unsupported format"),
    "no sign": (one(DEPTH[0], "depth_t0.npy"), r"depth_t0\.npy: .* depth_t\+0\.npy"),
    "no such frame": (one(DEPTH[0], "depth_t+7.npy"), r"depth_t\+7\.npy: the recording has no such frame"),
    "several in one": (one(DEPTH, "depth_t+0.npy"), r"depth_t\+0\.npy: must contain only the frame of its name; got 3"),
    "two files": (twice, r"depth: is defined by several files.*depth\.npy, depth\.pfm"),
    "std alone": (one(DEPTH, "depth_std.npy"), "at least one of depth, disparity, flow, velocity"),
    "transposed": (one(np.swapaxes(DEPTH, 1, 2)), r"depth\.npy: .* transposed to \(x, y\)"),
    "too large": (one(np.ones((37, 49))), r"one pixel too large: a half-pixel grid"),
    "too small": (one(np.ones((36, 47))), r"one pixel too small: a half-pixel grid"),
    "half": (one(np.ones((18, 24))), "every 2nd pixel"),
    "components": (one(np.ones((4, *SIZE)), "flow.npy"), r"flow\.npy: .* it requires 2 components"),
    "frames first": (one(np.ones((3, 2, *SIZE[1:])), "flow.npy"), "components must precede frames"),
    "empty": (one(np.ones((0, *SIZE[1:]))), "is empty"),
    "one dimension": (one(np.ones(36 * 48)), r"has the shape \(1728,\)"),
    "frames": (one(DEPTH[:2]), r'contains 2 frames, the recording 3; list them in results\.json, {"t": \[-1, 0\]}'),
    "integers": (one(DEPTH.astype(np.uint16)), r"contains integers \(uint16\); write float32"),
    "booleans": (one(DEPTH > 0), r"contains booleans \(bool\); write float32"),
    "complex": (one(DEPTH * 1j), r"contains complex numbers"),
    "objects": (one(DEPTH.astype(object)), "contains Python objects"),
    "words": (one(np.full(SIZE, "far")), r"does not contain numbers"),
    "infinite": (one(np.where(np.arange(48) == 3, np.inf, DEPTH)), "contains 108 infinite or too large values"),
    "no number": (one(DEPTH * np.nan), "contains only NaN"),
    "negative": (one(-DEPTH), r"depth\.npy: must be positive: 5184 pixels are not"),
    "negative disparity": (one(-DEPTH, "disparity.npy"), r"disparity\.npy: must be positive .* change the sign"),
    "status": (one(np.full(SIZE, 4, dtype=np.uint8), "status.npy"), r"status\.npy: must contain 0 \(invalid\), 1"),
    "no npy": (text("depth.npy", "1 2 3"), r"depth\.npy: is not a \.npy file"),
    "cut npy": (text("depth.npy", b"\x93NUMPY\x01\x00"), r"depth\.npy: "),
    "no npz": (text("depth.npz", "PK"), r"depth\.npz: cannot be read"),
    "two in npz": (
        lambda folder: np.savez(folder / "depth.npz", a=DEPTH, b=DEPTH),
        r"must contain one array, or one named 'depth'; got a, b",
    ),
    "no pfm": (text("depth.pfm", "P6\n48 36\n255\n"), r"is not a \.pfm file"),
    "scaled pfm": (text("depth.pfm", "Pf\n48 36\n-0.5\n"), "has a scale other than 1"),
    "cut pfm": (text("depth.pfm", "Pf\n48 36\n-1.0\n1234"), "contains 4 bytes .* require 6912"),
    "no flo": (text("flow.flo", "PIEH"), r"is not a \.flo file"),
    "depth as flo": (text("depth.flo", "PIEH"), r"\.flo files are for flow only"),
    "no json": (text("results.json", "{"), r"results\.json: cannot be read"),
    "strange key": (text("results.json", '{"frames": [0]}'), r"results\.json: frames: is unknown"),
    "strange unit": (text("results.json", '{"units": {"depth": "px"}}'), r"units\.depth: must be one of mm, cm, m, um"),
    "strange frames": (text("results.json", '{"t": [5]}'), "the recording has no such frames"),
}


@pytest.mark.parametrize(("write", "message"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_is_told_with_the_file(
    write: Callable[[Path], None], message: str, recording: xr.Dataset, tmp_path: Path
) -> None:
    write(tmp_path)
    with pytest.raises(st.EstimateError, match=message):
        read_results(tmp_path, recording)


def test_everything_wrong_is_told_at_once(recording: xr.Dataset, tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", -DEPTH)
    np.save(tmp_path / "disparity.npy", DEPTH.astype(np.uint8).swapaxes(1, 2))
    np.save(tmp_path / "flwo.npy", DEPTH)
    (tmp_path / "flow.flo").write_bytes(b"nothing")
    (tmp_path / "results.json").write_text('{"unit": {}}')
    with pytest.raises(st.EstimateError) as caught:
        read_results(tmp_path, recording)
    told = str(caught.value)
    for part in (
        "must be positive",
        "contains integers",
        "transposed to",
        "flwo.npy",
        "flow.flo",
        "results.json: unit",
    ):
        assert part in told, part


def test_a_folder_that_is_not_there_is_told(recording: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(st.EstimateError, match="does not exist: no output was written"):
        read_results(tmp_path / "none", recording)
    (tmp_path / "file").write_text("")
    with pytest.raises(st.EstimateError, match="is not a folder"):
        read_results(tmp_path / "file", recording)
