"""Layouts of public data sets and benchmarks: COCO, KITTI 2015, MPI Sintel, Spring."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.errors import Problem
from scenetruth.exporters.camera_geometry import CameraPose, compute_pose
from scenetruth.exporters.export_source import CameraPair, ExportSource
from scenetruth.exporters.format_base import FlowOptions, PairOptions, PictureOptions
from scenetruth.exporters.image_files import FLO_TAG, image_name, write_flo, write_mask, write_picture
from scenetruth.schema import read_object_names

__all__ = ["Coco", "Kitti", "Sintel", "Spring", "hidden_next"]


def hidden_next(source: ExportSource, s: int, t: int) -> NDArray[np.bool_]:
    """Return the mask of the points of a frame that are not visible to the camera in the next frame.

    Exact for the first frame of a truth (``occluded_in_time``) and for t = 0 of the reference camera (``visible``). In
    other frames, marked points are projected into the next frame: a point is visible if it lies in the plane of the
    surface at the nearest pixel, within the footprint of a pixel. Outlines are accurate to half a pixel.
    """
    marked = source.raw("occluded_in_time", s, t).astype(bool)
    if t - 1 not in source.recording["t"].values:
        return marked
    if (s, t) == (0, 0) and "visible" in source.maps:
        return np.asarray(
            (source.raw("object_id", s, t) >= 0) & ~source.maps["visible"].sel(s=s, t=1).values.astype(bool)
        )
    rows, columns = np.nonzero(marked)
    flow = source.flow(s, t, "finite")[:, rows, columns]
    x, y = columns + flow[0], rows + flow[1]
    depth = source.depth_then(s, t, "finite")[rows, columns]
    seen = _is_seen(source, (s, t + 1), np.stack([x, y]), depth)
    hidden = marked.copy()
    hidden[rows, columns] = ~seen
    return hidden


def _is_seen(
    source: ExportSource, place: tuple[int, int], points: NDArray[np.float64], depth: NDArray[np.float64]
) -> NDArray[np.bool_]:
    height, width = source.size
    x, y = points
    inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    column, row = (np.clip(np.rint(along), 0, most - 1).astype(int) for along, most in ((x, width), (y, height)))
    own = source.intrinsics
    centre = own.principal_point_px

    def ray(column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        tangents = (column - centre[0]) / own.focal_length_px, (row - centre[1]) / own.focal_length_px
        return np.stack([*tangents, np.ones_like(column)])

    normal, nearest = source.map("normal", *place)[:, row, column], source.depth(*place)[row, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        towards = (normal * ray(column.astype(float), row.astype(float))).sum(axis=0)
        # Intersection of the ray of the point with the plane of the surface at the pixel.
        on_plane = nearest * towards / (normal * ray(x, y)).sum(axis=0)
        return np.asarray(inside & (np.abs(on_plane - depth) < depth / own.focal_length_px))


class Coco(PictureOptions):
    """Instance masks of every frame as COCO's JSON, with the images.

    ``images/s+0_t+0.png`` and ``annotations.json``: one annotation for every object visible in an image, with
    ``segmentation`` as run lengths (uncompressed: ``counts`` of pixels alternately outside and inside, column by column
    from the left; ``size`` is height, width), ``area`` in pixels, ``bbox`` (left, top, width, height) between the outer
    edges of the pixels, ``iscrowd`` 0. A pixel belongs to the object at its centre. Categories are the names of the
    objects (the supercategory of ``plant/leaf-1`` is ``plant``); ``category_id`` counts from 1, because COCO reserves 0
    for the background, and ``object_id`` from 0, as in the truth. Masks contain visible parts. Lost: depth, motion,
    fractional pixels.
    """

    kind: Literal["coco"] = "coco"
    """Name of the format."""
    summary: ClassVar[str] = "instance masks of every frame as COCO's JSON, with the images"

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements."""
        yield from super().problems(source)
        if "object_id" not in source.maps:
            yield Problem("object_id", "is missing: only a truth contains the objects of pixels; export the truth")

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write images and masks."""
        height, width = source.size
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        names = read_object_names(source.maps)
        # Objects of one name are instances of one category; unnamed objects are named by number.
        categories: dict[str, int] = {}
        for s in source.views:
            for t in source.frames:
                name = f"{image_name(s, t)}.png"
                write_picture(folder / "images" / name, source.image(s, t), self.image_bits)
                image = {"id": len(images) + 1, "file_name": name, "width": width, "height": height, "s": s, "t": t}
                images.append(image)
                objects = source.raw("object_id", s, t)
                for number in sorted(set(objects[objects >= 0].tolist())):
                    label = names[number] if number < len(names) else f"object {number}"
                    category = categories.setdefault(label, len(categories) + 1)
                    about = {"id": len(annotations) + 1, "image_id": image["id"], "category_id": category}
                    annotations.append({**about, **_annotation(objects == number), "object_id": number})
        entries = {
            "info": {"description": "instance masks, made by scenetruth", "version": "1.0"},
            "licenses": [],
            "images": images,
            "annotations": annotations,
            "categories": [_category(label, number) for label, number in categories.items()],
        }
        (folder / "annotations.json").write_text(json.dumps(entries, ensure_ascii=False), encoding="utf-8")
        return [f"{len(annotations)} masks in {len(images)} images"]


def _category(label: str, number: int) -> dict[str, Any]:
    # Parts of a plant are named plant/part.
    whole, slash, _ = label.partition("/")
    return {"id": number, "name": label, "supercategory": whole if slash else "object"}


def _annotation(mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.nonzero(mask)
    left, top = int(columns.min()), int(rows.min())
    box = [left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1]
    return {
        "segmentation": {"counts": _run_lengths(mask), "size": list(mask.shape)},
        "area": len(rows),
        "bbox": box,
        "iscrowd": 0,
    }


def _run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Return run lengths along the columns, beginning outside the mask."""
    flat = np.concatenate([[False], mask.ravel(order="F")])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    return [int(length) for length in np.diff(np.concatenate([[0], ends, [mask.size]]))]


_DISPARITY_STEPS, _FLOW_STEPS, _FLOW_ZERO, _LARGEST = 256, 64, 2**15, 2**16 - 1


class Kitti(FlowOptions, PairOptions, PictureOptions):
    """Scene flow as 16-bit PNG, in the layout of KITTI 2015.

    For the n-th frame t with a recorded frame t + 1: ``image_2/00000n_10.png`` and ``_11.png`` (left camera, frames t
    and t + 1), ``image_3/`` (right camera), ``disp_occ_0/00000n_10.png`` (disparity at t), ``disp_occ_1/00000n_10.png``
    (disparity of the same points at t + 1, at their pixels of frame t), ``flow_occ/00000n_10.png``, and
    ``calib_cam_to_cam/00000n.txt`` with KITTI's P_rect_02 and P_rect_03, whose baseline is in metres. Rows run from the
    top down. Disparity is uint16 = round(256 d), d = x_left - x_right in px, positive; 0 where invalid. Flow is three
    uint16, (round(64 u) + 2^15, round(64 v) + 2^15, 1) in the order red, green, blue, with u positive to the right, v
    downwards, from frame t to t + 1 in px; all three are 0 where invalid. Points that are occluded in other images are
    included (``occ``); the last frame has no files. Lost: resolution below 1/256 px of disparity (0.0011 px rms) and
    1/64 px of flow (0.0045 px rms); disparities of 256 px or more and flows beyond 512 px become invalid. With ``flow:
    instantaneous``, flow is dx/dt, and disp_occ_1 is extrapolated by one frame at the present velocity.
    """

    kind: Literal["kitti"] = "kitti"
    """Name of the format."""
    summary: ClassVar[str] = "scene flow as 16-bit PNG: disparity at t and t + 1, flow, images of a pair (KITTI 2015)"
    packages: ClassVar[tuple[str, ...]] = ("cv2",)

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements."""
        yield from super().problems(source)
        yield from self.motion_problems(source, ("displacement_next",), ("velocity",))

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write the files of every frame except the last."""
        pair = self.get_pair(source)
        lost = 0
        for number, t in enumerate(source.pairs_of_frames):
            name = f"{number:06d}"
            for place, s in (("image_2", pair.left), ("image_3", pair.right)):
                for part, frame in (("10", t), ("11", t + 1)):
                    write_picture(folder / place / f"{name}_{part}.png", source.image(s, frame), self.image_bits)
            now, then = source.depth(pair.left, t), source.depth_then(pair.left, t, self.flow)
            for place, depth in (("disp_occ_0", now), ("disp_occ_1", then)):
                lost += _write_kitti_disparity(folder / place / f"{name}_10.png", source.disparity(depth, pair))
            lost += _write_kitti_flow(folder / "flow_occ" / f"{name}_10.png", source.flow(pair.left, t, self.flow))
            file = folder / "calib_cam_to_cam" / f"{name}.txt"
            file.parent.mkdir(exist_ok=True)
            file.write_text(_kitti_calibration(source, pair), encoding="ascii")
        notes = ["disparities have steps of 1/256 px (0.0011 px rms), flow has steps of 1/64 px (0.0045 px rms)"]
        if lost:
            notes.append(f"{lost} values out of range (disparity under 256 px, flow within 512 px) became invalid")
        return [*notes, *self.flow_notes(), *self.pair_notes(source)]


def _write_kitti_disparity(file: Path, disparity: NDArray[np.float64]) -> int:
    """Write a disparity map; return the number of valid values outside the range of the format."""
    steps = np.rint(_DISPARITY_STEPS * np.nan_to_num(disparity, nan=0.0, posinf=0.0))
    # 0 marks invalid pixels: values that round to 0 are outside the range.
    fits = (steps >= 1) & (steps <= _LARGEST)
    _write_kitti(file, np.where(fits, steps, 0).astype(np.uint16))
    return int((np.isfinite(disparity) & ~fits).sum())


def _write_kitti_flow(file: Path, flow: NDArray[np.float64]) -> int:
    known = np.isfinite(flow).all(axis=0)
    steps = np.rint(_FLOW_STEPS * np.where(known, flow, 0)) + _FLOW_ZERO
    fits = known & ((steps >= 0) & (steps <= _LARGEST)).all(axis=0)
    u, v = np.where(fits, steps, 0).astype(np.uint16)
    # OpenCV expects the order blue, green, red.
    _write_kitti(file, np.stack([fits.astype(np.uint16), v, u], axis=-1))
    return int((known & ~fits).sum())


def _write_kitti(file: Path, values: NDArray[np.uint16]) -> None:
    import cv2

    file.parent.mkdir(parents=True, exist_ok=True)
    found, coded = cv2.imencode(".png", values)
    if not found:
        msg = f"OpenCV could not encode {file.name}"
        raise OSError(msg)
    file.write_bytes(coded.tobytes())


def _kitti_calibration(source: ExportSource, pair: CameraPair) -> str:
    own = source.intrinsics
    f, (c_x, c_y) = own.focal_length_px, own.principal_point_px
    height, width = source.size
    lines = []
    for camera, along in (("02", 0.0), ("03", -f * pair.baseline_mm / 1000)):
        matrix = (f, 0.0, c_x, along, 0.0, f, c_y, 0.0, 0.0, 0.0, 1.0, 0.0)
        lines += [
            f"S_rect_{camera}: {float(width)!r} {float(height)!r}",
            f"R_rect_{camera}: 1 0 0 0 1 0 0 0 1",
            f"P_rect_{camera}: {' '.join(map(repr, matrix))}",
        ]
    return "\n".join(lines) + "\n"


class Sintel(FlowOptions, PictureOptions):
    """Flow, depth, cameras and occlusions in the binary files of MPI Sintel.

    Under ``training/``, for frame number n (from 0001, in order of t) of one camera:
    ``clean/SEQUENCE/frame_0001.png``, ``flow/SEQUENCE/frame_0001.flo``, ``depth/SEQUENCE/frame_0001.dpt``,
    ``camdata_left/SEQUENCE/frame_0001.cam``, ``occlusions/SEQUENCE/frame_0001.png``,
    ``invalid/SEQUENCE/frame_0001.png``. Binary files start with the tag 202021.25 as float32, little endian; rows run
    from the top down. .flo as in Middlebury: u to the right, v downwards, from frame t to t + 1 in px, 1e10 where no
    surface is visible. .dpt contains width, height and Z in mm as float32, NaN where no surface is visible (Sintel
    itself has no marker, because every pixel shows a surface). .cam contains M (3 x 3) and N (3 x 4) as float64 with x
    = M N X, X in the world in mm, x in px with integer pixel centres. Occlusions are 255 where a point is not visible
    in frame t + 1: occluded or outside the image. Invalid is 255 where there is no flow, or in the last frame no depth.
    The last frame has no flow and no occlusions; estimates have no occlusions. Occlusions are exact where a point is
    visible both a frame earlier and later, in the first frame, and at t = 0 of the reference camera; elsewhere they
    follow from the depth of frame t + 1, with outlines accurate to half a pixel. Lost: motion in depth, digits beyond
    float32. With ``flow: instantaneous``, flow is dx/dt per frame, and there are no occlusions.
    """

    kind: Literal["sintel"] = "sintel"
    """Name of the format."""
    camera: Annotated[int, Field(ge=-100_000, le=100_000)] = 0
    """Position s of the camera."""
    sequence: Annotated[str, Field(pattern=r"^\w[\w-]{0,99}$")] = "scene"
    """Name of the sequence directory: letters, digits, _ and -."""
    summary: ClassVar[str] = "flow, depth, camera, occlusions as .flo, .dpt, .cam, PNG (MPI Sintel)"

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements."""
        yield from super().problems(source)
        if self.camera not in source.views:
            remedy = "; render with `--truth-views all` for the others" if len(source.views) == 1 else ""
            yield Problem("camera", f"must be a position with maps, one of {source.views}{remedy}", self.camera)
        if "depth" not in source.maps and "disparity" not in source.maps:
            yield Problem("depth", "is missing; use the format flo for flow alone")

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write all frames."""
        s, matrix = self.camera, _sintel_matrix(source)
        for number, t in enumerate(source.frames, start=1):

            def file(what: str, ending: str, name: str = f"frame_{number:04d}") -> Path:
                place = folder / "training" / what / self.sequence
                place.mkdir(parents=True, exist_ok=True)
                return place / f"{name}.{ending}"

            write_picture(file("clean", "png"), source.image(s, t), self.image_bits)
            depth = source.depth(s, t)
            _write_sintel_depth(file("depth", "dpt"), depth)
            _write_sintel_camera(file("camdata_left", "cam"), matrix, compute_pose(source, s, t))
            unknown = np.asarray(~np.isfinite(depth))
            if t in source.pairs_of_frames:
                flow = source.flow(s, t, self.flow)
                write_flo(file("flow", "flo"), flow)
                unknown = np.asarray(~np.isfinite(flow).all(axis=0))
                if self.flow == "finite" and "occluded_in_time" in source.maps:
                    write_mask(file("occlusions", "png"), hidden_next(source, s, t))
            write_mask(file("invalid", "png"), unknown)
        notes = (
            ["the lens has distortion, which .cam files do not support: x = M N X does not hold"]
            if source.distortion
            else []
        )
        return [*self.flow_notes(), *notes]


def _tag() -> bytes:
    return np.array(FLO_TAG, dtype="<f4").tobytes()


def _write_sintel_depth(file: Path, depth: NDArray[np.float64]) -> None:
    height, width = depth.shape
    file.write_bytes(_tag() + np.array([width, height], dtype="<i4").tobytes() + depth.astype("<f4").tobytes())


def _write_sintel_camera(file: Path, matrix: NDArray[np.float64], pose: CameraPose) -> None:
    outer = np.column_stack([pose.axes.T, pose.translation_mm])
    file.write_bytes(_tag() + matrix.astype("<f8").tobytes() + outer.astype("<f8").tobytes())


def _sintel_matrix(source: ExportSource) -> NDArray[np.float64]:
    own = source.intrinsics
    (c_x, c_y), f = own.principal_point_px, own.focal_length_px
    return np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1]])


class Spring(FlowOptions, PairOptions, PictureOptions):
    """Scene flow as HDF5, in the layout of the Spring benchmark.

    For frame number n (from 0001, in order of t): ``frame_left/frame_left_0001.png``, ``frame_right/``,
    ``disp1_left/disp1_left_0001.dsp5`` (disparity at t), ``disp2_FW_left/`` and ``disp2_BW_left/`` (disparity of the
    same points at t + 1 and at t - 1, at their pixels of frame t), ``flow_FW_left/flow_FW_left_0001.flo5`` and
    ``flow_BW_left/`` (flow to t + 1 and to t - 1), ``cam_data/intrinsics.txt`` (fx fy cx cy, one line per frame,
    integer pixel centres), ``cam_data/extrinsics.txt`` (world to camera, 16 numbers, mm) and
    ``cam_data/baseline_mm.txt``. .dsp5 contains the dataset ``disparity`` (y, x), .flo5 the dataset ``flow`` (y, x, 2),
    float32, rows from the top down. Disparity is positive, x_left - x_right in px; flow u is positive to the right, v
    downwards. NaN where no surface is visible; points that are occluded in other images have values. There is no
    forward file for the last frame and no backward file for the first. Maps have the resolution of the images (the
    benchmark doubles it). Lost: digits beyond float32. With ``flow: instantaneous``, flow is dx/dt per frame, backward
    its negative, and disp2 is extrapolated by one frame at the present velocity.
    """

    kind: Literal["spring"] = "spring"
    """Name of the format."""
    summary: ClassVar[str] = "scene flow as HDF5, .dsp5 and .flo5, forward and backward (Spring)"
    packages: ClassVar[tuple[str, ...]] = ("h5py",)

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements."""
        yield from super().problems(source)
        finite = ("flow_previous", "displacement_next", "displacement_previous")
        yield from self.motion_problems(source, finite, ("velocity",))

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write all frames."""
        pair, recorded = self.get_pair(source), source.recording["t"].values.tolist()
        for number, t in enumerate(source.frames, start=1):
            for side, s in (("left", pair.left), ("right", pair.right)):
                name = f"frame_{side}"
                write_picture(folder / name / f"{name}_{number:04d}.png", source.image(s, t), self.image_bits)
            left = pair.left
            _write_hdf5(folder, "disp1_left", number, source.disparity(source.depth(left, t), pair))
            if t + 1 in recorded:
                then = source.depth_then(left, t, self.flow)
                _write_hdf5(folder, "disp2_FW_left", number, source.disparity(then, pair))
                _write_hdf5(folder, "flow_FW_left", number, source.flow(left, t, self.flow))
            if t - 1 in recorded:
                then = source.depth_then(left, t, self.flow, "previous")
                _write_hdf5(folder, "disp2_BW_left", number, source.disparity(then, pair))
                _write_hdf5(folder, "flow_BW_left", number, source.flow(left, t, self.flow, "previous"))
        _write_spring_cameras(folder / "cam_data", source, pair.left, pair.baseline_mm)
        return [*self.flow_notes(), *self.pair_notes(source)]


def _write_hdf5(folder: Path, what: str, number: int, values: NDArray[np.float64]) -> None:
    import h5py

    flow = values.ndim > 2
    values = np.where(np.isfinite(values).all(axis=0), values, np.nan) if flow else values
    place = folder / what
    place.mkdir(exist_ok=True)
    with h5py.File(place / f"{what}_{number:04d}.{'flo5' if flow else 'dsp5'}", "w") as file:
        data = np.moveaxis(values, 0, -1) if flow else values
        file.create_dataset(
            "flow" if flow else "disparity", data=data.astype(np.float32), compression="gzip", compression_opts=5
        )


def _write_spring_cameras(place: Path, source: ExportSource, s: int, baseline_mm: float) -> None:
    own = source.intrinsics
    f, (c_x, c_y) = own.focal_length_px, own.principal_point_px
    poses = [compute_pose(source, s, t) for t in source.frames]
    extrinsics = [np.vstack([np.column_stack([pose.axes.T, pose.translation_mm]), [0, 0, 0, 1]]) for pose in poses]
    place.mkdir()
    (place / "intrinsics.txt").write_text(f"{f!r} {f!r} {c_x!r} {c_y!r}\n" * len(poses), encoding="ascii")
    lines = [" ".join(repr(float(value)) for value in matrix.ravel()) for matrix in extrinsics]
    (place / "extrinsics.txt").write_text("".join(f"{line}\n" for line in lines), encoding="ascii")
    (place / "baseline_mm.txt").write_text(f"{baseline_mm!r}\n", encoding="ascii")
