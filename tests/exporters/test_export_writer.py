"""What is refused before anything is written, what is replaced, and what an export tells of itself."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth import exporters
from scenetruth.exporters import load_formats
from scenetruth.exporters.export_source import CameraPair, ExportSource
from tests.helpers.exported_scene import Export, scene
from tests.helpers.nightly import nightly

PACKAGES = {
    **{"kitti": "cv2", "spring": "h5py", "exr": "OpenEXR", "ply": "plyfile"},
    **{"hdf5": "h5py", "vtu": "meshio"},
}
WITHOUT_IMAGES = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}


def tiny(**changes: Any) -> st.Scene:
    """A wall of one colour, the quickest scene that there is."""
    wall = WITHOUT_IMAGES | {"pose": {"position_mm": [0, 0, 100]}}
    plain = {"camera": {"width": 20, "height": 16, "focal_length_px": 30}, "frames": {"count": 2}, "objects": [wall]}
    plain |= {"stage": {"positions": 3, "baseline_mm": 4.0}, "render": {"backend": "raycast", "supersampling": 1}}
    return scene(**(plain | changes))


def problems_of(info: pytest.ExceptionInfo[st.ExportError]) -> dict[str, str]:
    return {problem.path: problem.message for problem in info.value.problems}


def test_every_format_says_what_it_means_and_what_it_loses() -> None:
    assert set(load_formats()) == set(st.export_formats())
    for kind, model in load_formats().items():
        meaning = model.meaning()
        assert "ost:" in meaning or "is lost" in meaning, kind
        assert model.summary
        reserved = {"recording", "maps", "folder", "out", "format", "method", "row", "overwrite"}
        assert not reserved & set(model.model_fields)


def test_every_class_of_the_modules_of_formats_is_one() -> None:
    folder = Path(exporters.__path__[0])
    text = "".join(file.read_text(encoding="utf-8") for file in folder.glob("*_formats.py"))
    assert set(re.findall(r"^class (\w+)", text, re.MULTILINE)) == {cls.__name__ for cls in load_formats().values()}


@nightly
def test_a_run_is_exported_as_its_data_sets_are(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    st.save_store(recording, tmp_path / "run" / "recording.zarr")
    st.save_store(truth, tmp_path / "run" / "truth.zarr")
    for kind in load_formats():
        one = st.export(tmp_path / "run", kind, output=tmp_path / kind)
        other = st.export((recording, truth), kind, output=tmp_path / "again" / kind)
        assert one.files == other.files
        for name in one.files:
            # No file holds when it was written, or in which order variables came.
            assert (one.folder / name).read_bytes() == (other.folder / name).read_bytes(), name
        told = json.loads((one.folder / "export.json").read_text())
        assert told["format"] == kind
        assert told["from"] == "truth"
        assert told["recording_hash"] == recording.attrs["recording_hash"]
        assert tuple(told["files"]) == one.files
        assert {path.relative_to(one.folder).as_posix() for path in one.folder.rglob("*") if path.is_file()} == {
            "export.json",
            *one.files,
        }


@pytest.mark.parametrize(("kind", "package"), PACKAGES.items())
def test_a_missing_package_has_a_remedy(
    export: Export, monkeypatch: pytest.MonkeyPatch, kind: str, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(st.ExportError, match=rf"needs the package {package}.*pip install 'scenetruth\[formats\]'"):
        export(kind)


def test_only_formats_with_packages_need_them(export: Export, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in PACKAGES.values():
        monkeypatch.setitem(sys.modules, package, None)
    for kind in set(load_formats()) - set(PACKAGES):
        assert export(kind).files


def test_unknown_formats_and_options_are_told_with_what_there_is(export: Export) -> None:
    with pytest.raises(st.ExportError, match=r"must be one of coco, colmap.*did you mean 'kitti'"):
        export("kiti")
    with pytest.raises(st.ExportError) as info:
        export("KITTI", lft=0, image_bits=12, flow="smooth")
    told = problems_of(info)
    assert set(told) == {"lft", "image_bits", "flow"}
    assert "did you mean 'left'?" in told["lft"]
    assert "options are" in told["lft"]
    assert "8 or 16" in told["image_bits"]
    with pytest.raises(st.ExportError, match="it has no options"):
        export("tiff", bits=3)


def test_everything_that_is_missing_is_told_at_once(tmp_path: Path) -> None:
    recording, truth = st.simulate(tiny())
    with pytest.raises(st.ExportError) as info:
        st.export((recording, truth), "kitti", output=tmp_path / "x", left=1)
    told = problems_of(info)
    assert set(told) == {"flow_next", "displacement_next", "left"}
    assert "--truth-content complete" in told["flow_next"]
    assert "flow='instantaneous'" in told["flow_next"]
    assert "--truth-views all" in told["left"]
    assert not list(tmp_path.iterdir())


def test_estimates_lack_finite_flow_and_other_variables(recording: xr.Dataset, tmp_path: Path) -> None:
    estimate = st.make_estimate(disparity=np.full((3, 48, 64), 3.0), recording=recording)
    with pytest.raises(st.ExportError) as info:
        st.export((recording, estimate), "spring", output=tmp_path / "x")
    assert set(problems_of(info)) == {"flow_next", "flow_previous", "displacement_next", "displacement_previous"}
    assert "use flow='instantaneous'" in problems_of(info)["flow_next"]
    with pytest.raises(st.ExportError, match=r"velocity: is missing; flow='instantaneous' needs velocity") as info:
        st.export((recording, estimate), "spring", output=tmp_path / "x", flow="instantaneous")
    assert set(problems_of(info)) == {"flow", "velocity"}
    # Disparity alone is enough for pairs: d = f B / Z.
    done = st.export((recording, estimate), "pfm", output=tmp_path / "pfm")
    told = json.loads((done.folder / "export.json").read_text())
    assert told["from"].startswith("estimate by")


def test_last_position_has_no_neighbour_to_the_right(export: Export) -> None:
    with pytest.raises(st.ExportError, match=r"left: has no right neighbour.*use one of \[-1, 0\] \(got 1\)"):
        export("pfm", left=1)
    with pytest.raises(st.ExportError, match=r"left: must be a position with maps, one of \[-1, 0, 1\] \(got 7\)"):
        export("pfm", left=7)


def test_unequal_and_falling_stages_have_the_disparity_of_the_pair(tmp_path: Path) -> None:
    # The reference stands in the middle, at 0; s = -1 is the first in the list.
    for places, left, right, apart in (([-3.0, 0.0, 8.0], 0, 1, 8.0), ([5.0, 0.0, -2.0], 0, -1, 5.0)):
        stage = {"positions_mm": places}
        recording, truth = st.simulate(tiny(stage=stage), truth_views="all")
        done = st.export((recording, truth), "npz", output=tmp_path / f"{apart}")
        source = ExportSource(recording, truth)
        pair = source.pair(left)
        assert pair == CameraPair(left, right, apart)
        assert np.unique(source.disparity(source.depth(0, 0), pair)).tolist() == pytest.approx([30 * apart / 100])
        assert done.files


def test_a_grid_of_rows_is_taken_row_by_row(tmp_path: Path) -> None:
    stage = {"positions": 2, "baseline_mm": 4.0, "rows": 3, "row_spacing_mm": 5.0}
    recording, truth = st.simulate(tiny(stage=stage), truth_views="all")
    with pytest.raises(st.ExportError, match=r"s_y: must be one row of cameras.*--row N.*got \[-1, 0, 1\]"):
        st.export((recording, truth), "ply", output=tmp_path / "x")
    st.save_store(recording, tmp_path / "run" / "recording.zarr")
    st.save_store(truth, tmp_path / "run" / "truth.zarr")
    done = st.export(tmp_path / "run", "opencv_yaml", output=tmp_path / "y", row=1)
    assert "data: [ -4.0, -5.0, 0.0 ]" in (done.folder / "s+1.yml").read_text()
    with pytest.raises(st.ExportError, match=r"row: must be one of the rows \[-1, 0, 1\] \(got 4\)"):
        st.export(tmp_path / "run", "ply", output=tmp_path / "z", row=4)


def test_a_truth_of_the_reference_belongs_to_its_own_row(tmp_path: Path) -> None:
    stage = {"positions": 2, "baseline_mm": 4.0, "rows": 2, "row_spacing_mm": 5.0}
    recording, truth = st.simulate(tiny(stage=stage))
    assert st.export((recording.sel(s_y=0), truth.sel(s_y=0)), "ply", output=tmp_path / "x").files
    with pytest.raises(st.ExportError, match=r"s_y: is not the row of the truth, which is 0"):
        st.export((recording.sel(s_y=1), truth.sel(s_y=1)), "ply", output=tmp_path / "y")
    st.save_store(recording, tmp_path / "run" / "recording.zarr")
    st.save_store(
        st.make_estimate(depth=np.full((2, 16, 20), 90.0), recording=recording), tmp_path / "run" / "estimate.zarr"
    )
    assert st.export(tmp_path / "run", "ply", output=tmp_path / "z", row=0, method="structure_tensor").files
    with pytest.raises(st.ExportError, match=r"row: must be 0: the estimate covers only this row"):
        st.export(tmp_path / "run", "ply", output=tmp_path / "z", row=1, method="structure_tensor")


def test_one_format_among_all_is_described() -> None:
    assert list(st.export_formats("png", "PFM")) == ["png", "pfm"]
    with pytest.raises(st.ExportError, match=r"format: must be one of .*; did you mean 'sintel'"):
        st.export_formats("sintl")


def test_pairs_that_are_none_are_refused_or_told(tmp_path: Path) -> None:
    errors = {"repeatability_um": 50, "straightness_um": 50, "yaw_urad": 100}
    stage = {"positions": 2, "baseline_mm": 4.0, "errors": errors, "time_per_position_s": 0.01}
    camera = {"width": 20, "height": 16, "focal_length_px": 30, "distortion": {"k1": -0.1}}
    recording, truth = st.simulate(tiny(stage=stage, camera=camera))
    with pytest.raises(st.ExportError) as info:
        st.export((recording, truth), "pfm", output=tmp_path / "x")
    assert set(problems_of(info)) == {"camera.distortion", "camera_position_mm", "image_time_s"}
    done = st.export((recording, truth), "pfm", output=tmp_path / "x", nominal=True)
    assert len(done.notes) == 3
    assert "up to" in done.notes[1]


def test_rows_taken_from_different_places_are_no_points(tmp_path: Path) -> None:
    shutter = {"exposure_time_s": 0.001, "readout_time_s": 0.01, "stage_speed_mm_per_s": 20.0}
    recording, truth = st.simulate(tiny(shutter=shutter))
    for kind in ("ply", "colmap"):
        with pytest.raises(st.ExportError, match=r"shutter.stage_speed_mm_per_s: moves the camera.*\(got 20.0\)"):
            st.export((recording, truth), kind, output=tmp_path / "x")
    assert st.export((recording, truth), "exr", output=tmp_path / "x").files


def test_a_lens_that_cam_files_do_not_know_is_told(tmp_path: Path) -> None:
    camera = {"width": 20, "height": 16, "focal_length_px": 30, "distortion": {"k1": -0.1}}
    recording, truth = st.simulate(tiny(camera=camera), truth_content="complete")
    done = st.export((recording, truth), "sintel", output=tmp_path / "x")
    assert "the lens has distortion" in done.notes[0]


def test_pixels_and_runs_must_be_the_same(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(
        st.ExportError, match=r"x: has 32 pixels, which differ from the 64.*recording\.sel\(x=maps\.x\)"
    ):
        st.export((recording, truth.isel(x=slice(0, None, 2))), "exr", output=tmp_path / "x")
    with pytest.raises(st.ExportError, match=r"x: has 62 pixels"):
        st.export((recording, truth.isel(x=slice(2, None))), "exr", output=tmp_path / "x")
    other = truth.assign_attrs(recording_hash="0" * 16)
    with pytest.raises(st.MismatchError):
        st.export((recording, other), "exr", output=tmp_path / "x")
    with pytest.raises(st.ExportError) as info:
        st.export((recording.drop_vars("image"), truth.drop_vars("depth")), "exr", output=tmp_path / "x")
    assert {"recording.image", "truth.depth"} <= set(problems_of(info))


def test_one_frame_has_no_flow(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(st.ExportError, match=r"t: needs two consecutive frames"):
        st.export((recording.sel(t=[0]), truth.sel(t=[0])), "flo", output=tmp_path / "x")
    assert st.export((recording.sel(t=[0]), truth.sel(t=[0])), "pfm", output=tmp_path / "x").files


def test_a_run_without_truth_names_the_estimate(recording: xr.Dataset, tmp_path: Path) -> None:
    st.save_store(recording, tmp_path / "run" / "recording.zarr")
    with pytest.raises(st.StoreError, match=r"truth.zarr: no such store.*--method NAME"):
        st.export(tmp_path / "run", "npz", output=tmp_path / "x")
    with pytest.raises(st.StoreError, match=r"nothing: no such directory; give the directory of a run"):
        st.export(tmp_path / "nothing", "npz", output=tmp_path / "x")


def test_an_export_is_replaced_only_when_told_and_foreign_files_stay(export: Export, tmp_path: Path) -> None:
    done = export("flo")
    with pytest.raises(st.OutputExistsError, match="exists already"):
        export("flo")
    (done.folder / "notes.txt").write_text("mine")
    before = (done.folder / "images" / "s+0_t+0.png").read_bytes()
    again = export("flo", overwrite=True, image_bits=16)
    assert (done.folder / "notes.txt").read_text() == "mine"
    assert (done.folder / "images" / "s+0_t+0.png").read_bytes() != before
    assert "notes.txt" not in json.loads((again.folder / "export.json").read_text())["files"]
    # Inside a folder of the export, nothing can stay: it is refused.
    (done.folder / "flow" / "mine.flo").write_text("mine")
    with pytest.raises(st.OutputExistsError, match=r"contains files not written by scenetruth \(flow/mine.flo\)"):
        export("flo", overwrite=True)
    assert (done.folder / "flow" / "mine.flo").read_text() == "mine"


def test_folders_of_others_are_never_replaced(export: Export, tmp_path: Path) -> None:
    (tmp_path / "png").mkdir()
    (tmp_path / "png" / "photo.png").write_text("mine")
    with pytest.raises(st.OutputExistsError, match=r"is a directory without the export.json of an export"):
        export("png", overwrite=True)
    (tmp_path / "png" / "export.json").write_text('{"made_by": "another", "files": ["photo.png"]}')
    with pytest.raises(st.OutputExistsError):
        export("png", overwrite=True)
    (tmp_path / "tiff").write_text("mine")
    with pytest.raises(st.OutputExistsError, match=r"is a file"):
        export("tiff", overwrite=True)
    assert (tmp_path / "png" / "photo.png").read_text() == "mine"


def test_a_failed_export_leaves_nothing(export: Export, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from scenetruth.exporters import image_formats

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(image_formats, "write_flo", full)
    with pytest.raises(st.StoreError, match="the disk is full"):
        export("flo")
    assert not [path for path in tmp_path.iterdir() if not path.name.endswith(".lock")]
