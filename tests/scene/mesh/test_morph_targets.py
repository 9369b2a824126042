"""Morph targets of glTF files, written here byte by byte."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import make_sheet
from tests.helpers.animated_scene import scene_with

Array = NDArray[np.float64]
SHEET = make_sheet((32, 24), 8)
TIMES = np.array([0.0, 0.5, 1.25, 2.0])
WEIGHTS = np.array([[0.0, 1.0], [0.5, 0.75], [1.0, -0.25], [0.25, 0.5]])
TURN = Rotation.from_euler("xyz", [20, -30, 40], degrees=True)


def targets() -> Array:
    x, y, _ = SHEET.vertices_mm.T
    zero = np.zeros_like(x)
    # Numbers that float32 holds exactly.
    return np.stack([np.column_stack([zero, zero, x * x / 64]), np.column_stack([y / 8, zero, zero])])


class Glb:
    """A glTF file in the making."""

    def __init__(self) -> None:
        self.binary = b""
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}

    def view(self, values: NDArray[Any]) -> int:
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes})
        self.binary += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values: NDArray[Any], kind: str, component: int = 5126, **more: Any) -> int:
        dtype = {5126: "<f4", 5125: "<u4", 5122: "<i2"}[component]
        entry: dict[str, Any] = {"bufferView": self.view(values.astype(dtype))}
        entry |= {"componentType": component, "count": len(values)}
        entry |= {"type": kind, "min": values.min(axis=0).ravel().tolist(), "max": values.max(axis=0).ravel().tolist()}
        self.tree["accessors"].append(entry | more)
        return len(self.tree["accessors"]) - 1

    def sparse(self, values: Array) -> int:
        rows = np.flatnonzero(np.abs(values).max(axis=1))
        indices = {"bufferView": self.view(rows.astype("<u4")), "componentType": 5125}
        entry = {
            "count": len(rows),
            "indices": indices,
            "values": {"bufferView": self.view(values[rows].astype("<f4"))},
        }
        self.tree["accessors"].append({"componentType": 5126, "count": len(values), "type": "VEC3", "sparse": entry})
        return len(self.tree["accessors"]) - 1

    def write(self, file: Path) -> Path:
        if file.suffix == ".gltf":
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
            self.tree["buffers"] = [{"byteLength": len(self.binary), "uri": uri}]
            file.write_text(json.dumps(self.tree))
            return file
        self.tree["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self.binary)
        file.write_bytes(
            struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
            + text
            + struct.pack("<II", len(self.binary), 0x004E4942)
            + self.binary
        )
        return file


def sheet_glb(interpolation: str = "LINEAR", sparse: bool = False, normalized: bool = False) -> Glb:
    glb = Glb()
    position = glb.accessor(SHEET.vertices_mm, "VEC3")
    indices = glb.accessor(SHEET.faces.ravel(), "SCALAR", 5125)
    moves = [glb.sparse(move) if sparse else glb.accessor(move, "VEC3") for move in targets()]
    weights = WEIGHTS
    if interpolation == "CUBICSPLINE":
        weights = np.stack([WEIGHTS * 0 + 7, WEIGHTS, WEIGHTS * 0 - 9], axis=1)
    output = glb.accessor(weights.reshape(-1), "SCALAR")
    if normalized:
        steps = np.rint(WEIGHTS * 32767).reshape(-1)
        output = glb.accessor(steps, "SCALAR", 5122, normalized=True)
    glb.tree |= {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"children": [1], "translation": [1, 2, 3]},
            {"mesh": 0, "rotation": TURN.as_quat().tolist(), "scale": [2, 1, 0.5]},
        ],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": position},
                        "indices": indices,
                        "targets": [{"POSITION": move} for move in moves],
                    }
                ]
            }
        ],
        "animations": [
            {
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "weights"}}],
                "samplers": [
                    {"input": glb.accessor(TIMES, "SCALAR"), "output": output, "interpolation": interpolation}
                ],
            }
        ],
    }
    return glb


def expected(t: float) -> Array:
    """Positions at t, with keyframes that begin at the first of five frames, 0.5 s apart."""
    weights = CubicSpline(TIMES / 0.5 - 2, WEIGHTS)(t)
    points = SHEET.vertices_mm + np.tensordot(weights, targets(), axes=1)
    return np.asarray(10 * (TURN.apply(points * (2, 1, 0.5)) + (1, 2, 3)) + (0, 0, 660))


@pytest.mark.parametrize(
    ("form", "changes", "tolerance"),
    [
        ("glb", {}, 1e-4),
        ("gltf", {}, 1e-4),
        ("glb", {"interpolation": "CUBICSPLINE"}, 1e-4),
        ("glb", {"sparse": True}, 1e-4),
        # Weights in steps of 1 / 32767, times 40 mm.
        ("glb", {"normalized": True}, 2e-3),
    ],
)
def test_morph_targets_follow_the_spline_through_their_keyframes(
    tmp_path: Path, form: str, changes: dict[str, Any], tolerance: float
) -> None:
    file = sheet_glb(**changes).write(tmp_path / f"mesh.{form}")
    mesh = {"kind": "file", "file": str(file), "unit_mm": 10}
    body = build_scene(scene_with(mesh, {"kind": "morph"}, frames=5)).bodies[0]
    for t in (-2.0, -1.0, 0.3, 2.0):
        # Coordinates of 300 mm in the file's float32.
        np.testing.assert_allclose(body.at(t).positions_mm, expected(t), atol=tolerance)
        velocity = (expected(t + 1e-4) - expected(t - 1e-4)) / 2e-4
        np.testing.assert_allclose(body.at(t).velocities, velocity, atol=3 * tolerance)


def test_the_file_can_begin_at_any_frame(tmp_path: Path) -> None:
    mesh = {"kind": "file", "file": str(sheet_glb().write(tmp_path / "mesh.glb")), "unit_mm": 10}
    body = build_scene(scene_with(mesh, {"kind": "morph", "start_frame": -3.5}, frames=1)).bodies[0]
    np.testing.assert_allclose(body.at(-1.2).positions_mm, expected(0.3), atol=1e-4)
    with pytest.raises(st.SceneError, match="must cover the frames") as caught:
        build_scene(scene_with(mesh, {"kind": "morph"}, frames=9))
    assert caught.value.problems[0].path == "objects.0.deformation.0.start_frame"


def broken(name: str) -> Glb:
    glb = sheet_glb("STEP" if name == "step" else "LINEAR")
    tree = glb.tree
    primitive = tree["meshes"][0]["primitives"][0]
    if name == "no targets":
        del primitive["targets"]
    elif name == "short target":
        primitive["targets"][1]["POSITION"] = glb.accessor(targets()[1][:7], "VEC3")
    elif name == "no animation":
        del tree["animations"]
    elif name == "rotation":
        tree["animations"][0]["channels"].append({"sampler": 0, "target": {"node": 1, "path": "rotation"}})
    elif name == "few weights":
        tree["animations"][0]["samplers"][0]["output"] = glb.accessor(np.ones(7), "SCALAR")
    elif name == "times":
        tree["animations"][0]["samplers"][0]["input"] = glb.accessor(TIMES[[0, 2, 1, 3]], "SCALAR")
    elif name == "two meshes":
        tree["nodes"].append({"mesh": 0})
        tree["scenes"][0]["nodes"].append(2)
    return glb


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("step", r"its weights are discontinuous \(STEP\)"),
        ("no targets", "the mesh has no morph targets"),
        ("short target", "morph target 1 has 7 displacements for 20 vertices"),
        ("no animation", "no animation of morph-target weights"),
        ("rotation", "also animates rotation"),
        ("few weights", "has 7 weights for 4 keyframes of 2 targets"),
        ("times", "its keyframes are not increasing"),
        ("two meshes", "exactly one mesh; it has 2"),
    ],
)
def test_files_that_cannot_be_morphed(tmp_path: Path, name: str, message: str) -> None:
    file = broken(name).write(tmp_path / "mesh.glb")
    with pytest.raises(st.SceneError, match=message) as caught:
        build_scene(scene_with({"kind": "file", "file": str(file)}, {"kind": "morph"}, frames=3))
    assert caught.value.problems[0].path == "objects.0.deformation.0.kind"


def test_other_mesh_files_have_no_morph_targets(tmp_path: Path) -> None:
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 0 9 0\nv 9 0 0\nf 1 2 3\n")
    with pytest.raises(st.SceneError, match=r"requires a mesh file with morph targets: \.glb or \.gltf"):
        build_scene(scene_with({"kind": "file", "file": str(tmp_path / "mesh.obj")}, {"kind": "morph"}, frames=3))
