"""Meshes whose vertices are given at some times."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import zarr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.mesh import make_sheet
from scenetruth.scene.scene_report import check_scene
from scenetruth.scene.taylor import Jet
from scenetruth.scene.vertex_animation import AnimatedConfiguration
from tests.helpers.animated_scene import scene_with

Array = NDArray[np.float64]
SHEET = make_sheet((40, 30), 5)


def write_obj(file: Path, vertices: Array, faces: NDArray[np.int32] = SHEET.faces) -> Path:
    lines = ["v " + " ".join(repr(float(x)) for x in vertex) for vertex in vertices]
    lines += ["f " + " ".join(str(index + 1) for index in face) for face in faces]
    file.write_text("\n".join(lines) + "\n")
    return file


def world_of(folder: Path, states: Array, rest: Array = SHEET.vertices_mm, **entry: Any) -> BuiltScene:
    np.save(folder / "states.npy", states)
    mesh = {"kind": "file", "file": str(write_obj(folder / "mesh.obj", rest))}
    nodal = {"kind": "nodal", "file": str(folder / "states.npy"), "quantity": "positions", **entry}
    return build_scene(scene_with(mesh, nodal, frames=1))


def wave(points: Array, t: Any) -> Array:
    """A bending wave that travels while the sheet grows and turns."""
    x, y, z = points.T
    grow = np.exp(0.02 * t)
    x, y, z = x * grow, y * grow, z + 1.5 * np.sin(0.2 * x - 0.5 * t)
    angle = 0.03 * t
    return np.column_stack([x * np.cos(angle) - z * np.sin(angle), y, x * np.sin(angle) + z * np.cos(angle)])


def sampled(motion: Callable[[Array, Any], Array], times: Array, points: Array = SHEET.vertices_mm) -> Array:
    return np.stack([motion(points, t) for t in times])


@pytest.mark.parametrize("t", [-4.7, -1.3, 0.0, 0.26, 4.0, 4.9])
def test_velocity_is_the_central_difference_of_the_positions(tmp_path: Path, t: float) -> None:
    start = world_of(tmp_path, sampled(wave, np.arange(-4.0, 5))).bodies[0].start
    jets = start.at(Jet.variable(np.array([t]), 0, 1))
    step = np.longdouble(2) ** -20
    for field in range(3):
        behind, here, ahead = (start.at(np.array([t], np.longdouble) + k * step)[field] for k in (-1, 0, 1))
        assert here.dtype == np.longdouble
        velocity = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(jets[field].value, here.astype(float), rtol=1e-14, atol=1e-14)
        # Cubics: the difference errs by step² times the third derivative / 6.
        assert np.abs(jets[field].first(0) - velocity).max() <= 1e-8 * np.abs(velocity).max()
        # A second difference needs a longer step. It is exact for cubics; at a state, where the third derivative jumps,
        # it errs by step times the jump / 6.
        wide = np.longdouble(2) ** -10
        behind, ahead = (start.at(np.array([t], np.longdouble) + k * wide)[field] for k in (-1, 1))
        acceleration = (ahead - 2 * here + behind) / wide**2
        assert np.abs(jets[field].second(0, 0) - acceleration).max() <= (1e-9 if t != 0 else 1e-3)


def test_splines_go_through_the_states_and_converge_at_fourth_order(tmp_path: Path) -> None:
    exact = (wave(SHEET.vertices_mm, np.float64(1e-6)) - wave(SHEET.vertices_mm, np.float64(-1e-6))) / 2e-6
    found = []
    for per_frame in (1, 2, 4):
        times = np.linspace(-4, 4, 8 * per_frame + 1)
        world = world_of(tmp_path, sampled(wave, times), times_frames=times.tolist())
        body = world.bodies[0]
        np.testing.assert_allclose(
            body.at(times[3]).positions_mm, wave(SHEET.vertices_mm, times[3]) + (0, 0, 660), rtol=1e-14
        )
        between = 0.5 / per_frame
        position = body.at(between).positions_mm - wave(SHEET.vertices_mm, between) - (0, 0, 660)
        found.append([np.abs(body.at(0.0).velocities - exact).max(), np.abs(position).max()])
    orders = np.log2(np.array(found[:-1]) / found[1:])
    assert (orders > 3.6).all(), (found, orders)


def test_two_and_three_states_give_lines_and_parabolas(tmp_path: Path) -> None:
    points = SHEET.vertices_mm
    line = world_of(tmp_path, np.stack([points, points + (1, 2, 3)]), times_frames=[0, 2])
    moved = line.at(0.5)
    np.testing.assert_allclose(moved.velocities, np.broadcast_to([0.5, 1, 1.5], points.shape), rtol=1e-13)
    np.testing.assert_allclose(moved.accelerations, 0, atol=1e-13)
    parabola = world_of(tmp_path, np.stack([points + (0, 0, t * t) for t in (-1.0, 0.0, 1.0)])).at(0.7)
    np.testing.assert_allclose(parabola.velocities[:, 2], 1.4, rtol=1e-12)
    np.testing.assert_allclose(parabola.accelerations[:, 2], 2, rtol=1e-12)


def rolled(points: Array, t: Any) -> Array:
    """Uneven growth in the flat, then rolled without stretching onto a cylinder of 30 mm."""
    x, y = points[:, 0] * (1 + 0.01 * t * (1 + points[:, 0] / 100)), points[:, 1] + 0.2 * t * np.sin(points[:, 1] / 6)
    return np.column_stack([30 * np.sin(x / 30), y, -30 * np.cos(x / 30)])


def growth(points: Array, t: float) -> Array:
    """The relative rate of the area in closed form: d/dt log (dx'/dx dy'/dy)."""
    along, across = 0.01 * (1 + points[:, 0] / 50), 0.2 / 6 * np.cos(points[:, 1] / 6)
    rate: Array = along / (1 + along * t) + across / (1 + across * t)
    return rate


def growth_errors(resolution_mm: float, t: float) -> tuple[Array, Array]:
    """Return errors of the growth rate at the vertices, and against the areas of pairs of triangles."""
    flat = make_sheet((40, 30), resolution_mm)
    times = np.linspace(-2, 2, 17)
    rest = rolled(flat.vertices_mm, 0.0)
    start = AnimatedConfiguration(times, sampled(rolled, times, flat.vertices_mm), flat.faces, rest, 60.0)
    from scenetruth.scene.surface_tensor_kernels import surface_tensors

    jets = start.surface(Jet.variable(np.array([t]), 0, 3))
    tensors = surface_tensors(*(field.coefficients for field in jets))
    at_points = tensors[:, 3:6].sum(axis=1) - growth(flat.vertices_mm[start.osculation.vertices], t)

    def areas(when: float) -> Array:
        x, y, z = start.at(np.array([when]))
        corners = np.column_stack([x, y, z])[flat.faces]
        twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        # The two triangles of a cell: one alone tells the rate at the middles of its legs, not at its own middle.
        return np.asarray(twice[0::2] + twice[1::2])

    rate = (np.log(areas(t + 1e-4)) - np.log(areas(t - 1e-4))) / 2e-4
    corners = tensors[:, 3:6].sum(axis=1)[start.corners].mean(axis=1)
    return at_points, (corners[0::2] + corners[1::2]) / 2 - rate


def test_growth_rate_converges_to_the_closed_form_at_second_order() -> None:
    found = []
    for resolution in (4.0, 2.0, 1.0):
        at_points, at_cells = growth_errors(resolution, 0.3)
        found.append([np.sqrt(np.mean(at_points**2)), np.abs(at_points).max(), np.sqrt(np.mean(at_cells**2))])
    orders = np.log2(found[0] / np.array(found[-1])) / 2
    assert (orders > 1.75).all(), (found, orders)
    # 0.04 per frame at most.
    assert found[-1][1] < 1e-3


def test_turning_and_uniform_growth_are_told_apart(tmp_path: Path) -> None:
    times = np.linspace(-4, 4, 33)
    axis = np.array([0.6, 0.0, 0.8])

    def motion(points: Array, t: Any) -> Array:
        angle = np.float64(0.02 * t)
        turned = (
            points * np.cos(angle)
            + np.cross(axis, points) * np.sin(angle)
            + np.outer(points @ axis, axis) * (1 - np.cos(angle))
        )
        return np.asarray(turned * np.exp(0.01 * t))

    world = world_of(tmp_path, sampled(motion, times), times_frames=times.tolist())
    tensors = world.surface_at(0.37)
    # The spline errs by about (0.25 * 0.022)^3 * 0.02 / 24.
    np.testing.assert_allclose(tensors[:, 9:12], np.broadcast_to(0.02 * axis, (len(tensors), 3)), atol=1e-9)
    np.testing.assert_allclose(tensors[:, 3:6].sum(axis=1), 0.02, atol=1e-9)


@pytest.mark.parametrize("form", ["npy", "npz", "npz with key", "zarr", "zarr group"])
def test_arrays_of_every_form_give_the_same(tmp_path: Path, form: str) -> None:
    moves = (sampled(wave, np.arange(-1.0, 2)) - SHEET.vertices_mm) / 1000
    entry: dict[str, Any] = {"kind": "nodal", "file": f"moves.{form[:4].strip()}", "unit_mm": 1000}
    file = tmp_path / entry["file"]
    if form == "npy":
        np.save(file, moves)
    elif form.startswith("npz"):
        others = {"other": moves * 0} if "key" in form else {}
        np.savez(file, u=moves, **others)  # type: ignore[arg-type]
    elif form == "zarr":
        zarr.save_array(str(file), moves)
    else:
        zarr.open_group(str(file), mode="w").create_array("u", data=moves)
    if " " in form:
        entry["key"] = "u"
    write_obj(tmp_path / "mesh.obj", SHEET.vertices_mm)
    scene = scene_with({"kind": "file", "file": "mesh.obj"}, entry, frames=3)
    (tmp_path / "scene.yaml").write_text(json.dumps(scene.to_dict()))
    # Relative paths count from the scene file.
    body = build_scene(st.load_scene(tmp_path / "scene.yaml")).bodies[0]
    np.testing.assert_allclose(body.at(1).positions_mm, wave(SHEET.vertices_mm, 1) + (0, 0, 660), rtol=1e-12)


def test_other_deformations_and_motions_come_after(tmp_path: Path) -> None:
    states = sampled(wave, np.arange(-4.0, 5))
    np.save(tmp_path / "states.npy", states)
    mesh = {"kind": "file", "file": str(write_obj(tmp_path / "mesh.obj", SHEET.vertices_mm))}
    nodal = {"kind": "nodal", "file": str(tmp_path / "states.npy"), "quantity": "positions"}
    hinge = {"kind": "hinge", "axis": [0, 0, 1], "angle_deg": {"kind": "linear", "start": 90, "rate_per_frame": 0}}
    found = build_scene(scene_with(mesh, nodal, hinge)).at(2).vertices_mm - (0, 0, 660)
    np.testing.assert_allclose(found, states[6][:, [1, 0, 2]] * (-1, 1, 1), atol=1e-12)
    with pytest.raises(st.SceneError, match="'nodal' defines the vertex positions of a mesh file") as caught:
        scene_with(mesh, hinge, nodal)
    assert caught.value.problems[0].path == "objects.0.deformation"
    with pytest.raises(st.SceneError, match="for a mesh with `kind` 'file'"):
        scene_with({"kind": "plane", "size_mm": [9, 9]}, nodal)


def test_nodes_of_an_obj_file_are_its_lines_also_at_seams(tmp_path: Path) -> None:
    # A node without a face comes first, and the middle edge is a seam of the texture.
    (tmp_path / "mesh.obj").write_text(
        "v 9 9 9\nv -20 -20 0\nv 20 -20 0\nv 20 20 0\nv -20 20 0\nvt 0 1\nvt 1 1\nvt 1 0\nvt 0 0\nvt .3 .4\n"
        "f 2/1 5/4 4/3\nf 2/5 4/3 3/2\n"
    )
    moves = np.zeros((3, 5, 3))
    moves[:, :, 2] = [[0.0], [1.0], [2.0]] * np.array([100, 1, 2, 3, 4])
    np.save(tmp_path / "moves.npy", moves)
    nodal = {"kind": "nodal", "file": str(tmp_path / "moves.npy")}
    body = build_scene(scene_with({"kind": "file", "file": str(tmp_path / "mesh.obj")}, nodal, frames=3)).bodies[0]
    rest, moved = body.at(-1).positions_mm, body.at(0).positions_mm
    expected = {(-20.0, -20.0): 1, (20.0, -20.0): 2, (20.0, 20.0): 3, (-20.0, 20.0): 4}
    assert [expected[(x, y)] for x, y, _ in rest] == pytest.approx((moved - rest)[:, 2])
    assert len(rest) == 4
    # Nodes at the same place are distinguished by their order.
    text = (tmp_path / "mesh.obj").read_text().replace("v 9 9 9", "v 20 20 0")
    (tmp_path / "mesh.obj").write_text(text)
    body = build_scene(scene_with({"kind": "file", "file": str(tmp_path / "mesh.obj")}, nodal, frames=3)).bodies[0]
    np.testing.assert_array_equal(body.at(0).positions_mm, moved)


@pytest.mark.parametrize("kind", ["nodal", "meshes"])
def test_nodes_that_no_face_uses_are_in_arrays_and_files_and_nowhere_else(tmp_path: Path, kind: str) -> None:
    states = sampled(wave, np.arange(-1.0, 2))
    # The first node and the last are of no face, and lie where no number is, or behind the camera.
    padded = np.pad(states, ((0, 0), (1, 1), (0, 0)), constant_values=-9e3)
    files = [str(tmp_path / f"{index}.ply") for index in range(3)]
    for file, vertices in zip(files, padded, strict=True):
        trimesh.Trimesh(vertices, SHEET.faces + 1, process=False).export(file)
    padded[1, 0] = np.nan
    np.save(tmp_path / "states.npy", padded)
    nodal = {"kind": "nodal", "file": str(tmp_path / "states.npy"), "quantity": "positions"}
    entry = nodal if kind == "nodal" else {"kind": "meshes", "files": files}
    scene = scene_with({"kind": "file", "file": files[1]}, entry, frames=3)
    body = build_scene(scene).bodies[0]
    for t in (-1, 0, 1):
        # PLY files hold float32.
        np.testing.assert_allclose(body.at(t).positions_mm, states[t + 1] + (0, 0, 660), rtol=1e-6)
    check_scene(scene, build_scene(scene))


def mutated(states: Array, index: tuple[int, ...], value: float) -> Array:
    changed = states.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize(
    ("change", "entry", "path", "message"),
    [
        (lambda s: s[:, :-1], {}, "file", r"shape \(frames, 63, 3\), for the 63 nodes of mesh.obj .*\(9, 62, 3\)"),
        (lambda s: s[..., :2], {}, "file", r"shape \(frames, 63, 3\).*\(9, 63, 2\)"),
        (lambda s: s[0], {}, "file", r"shape \(frames, 63, 3\).*\(63, 3\)"),
        (lambda s: s.astype(complex), {}, "file", "must hold numbers.*complex128"),
        (
            lambda s: mutated(s, (3, 7, 1), np.nan),
            {},
            "file",
            "has 1 positions that are not finite, the first at state 3, vertex 7",
        ),
        (lambda s: mutated(s, (2, 4), np.inf), {}, "file", "not finite, the first at state 2, vertex 4"),
        (lambda s: mutated(s, (5,), 1.0), {}, "file", "face . has zero area at state 5"),
        (lambda s: s[:1], {}, "file", "at two or more times"),
        (lambda s: s[:3], {}, "times_frames", "cover the frames of the recording, t = -4 to 4 .*t = -1 to 1"),
        (lambda s: s, {"times_frames": [0, 1, 2]}, "times_frames", "one time for each of the 9 states .*3"),
        (lambda s: s, {"key": "u", "file": "moves.npz"}, "key", "must be the name of an array in the file: a, b"),
        (lambda s: s, {"file": "moves.npz"}, "key", "must be the name of an array in the file: a, b"),
        (lambda s: s, {"file": "nothing.npy"}, "file", "no such file"),
        (lambda s: s, {"file": "mesh.obj"}, "file", "cannot be read as an array"),
        (lambda s: s, {"file": "objects.npy"}, "file", "cannot be read as an array: .*Python objects"),
    ],
)
def test_arrays_that_do_not_fit(
    tmp_path: Path, change: Callable[[Array], Array], entry: dict[str, Any], path: str, message: str
) -> None:
    np.save(tmp_path / "states.npy", change(sampled(wave, np.arange(-4.0, 5))))
    np.savez(tmp_path / "moves.npz", a=np.zeros(3), b=np.zeros(3))
    np.save(tmp_path / "objects.npy", np.array([None, {}]), allow_pickle=True)
    write_obj(tmp_path / "mesh.obj", SHEET.vertices_mm)
    nodal = {"kind": "nodal", "file": "states.npy", "quantity": "positions", **entry}
    with pytest.raises(st.SceneError, match=message) as caught:
        build_scene(scene_with({"kind": "file", "file": "mesh.obj"}, nodal), tmp_path)
    assert [problem.path for problem in caught.value.problems] == [f"objects.0.deformation.0.{path}"]


@pytest.mark.parametrize("times", [[0, 2, 1], [0, 0, 1], [1]])
def test_times_out_of_order(times: list[float]) -> None:
    with pytest.raises(st.SceneError, match=r"increasing|at least two") as caught:
        scene_with({"kind": "file", "file": "m.obj"}, {"kind": "nodal", "file": "a.npy", "times_frames": times})
    assert caught.value.problems[0].path == "objects.0.deformation.0.times_frames"


def test_series_of_mesh_files(tmp_path: Path) -> None:
    files = [
        str(write_obj(tmp_path / f"{index}.obj", wave(SHEET.vertices_mm, float(t)) / 10))
        for index, t in enumerate((-1, 0, 1))
    ]
    mesh = {"kind": "file", "file": files[1], "unit_mm": 10}
    entry = {"kind": "meshes", "files": files, "unit_mm": 10}
    body = build_scene(scene_with(mesh, entry, frames=3)).bodies[0]
    for t in (-1, 0, 1):
        np.testing.assert_allclose(body.at(t).positions_mm, wave(SHEET.vertices_mm, t) + (0, 0, 660), rtol=1e-12)
    write_obj(tmp_path / "2.obj", SHEET.vertices_mm, SHEET.faces[::-1])
    with pytest.raises(st.SceneError, match="topology cannot change") as caught:
        build_scene(scene_with(mesh, entry, frames=3))
    assert caught.value.problems[0].path == "objects.0.deformation.0.files.2"
    with pytest.raises(st.SceneError, match="no such mesh file") as caught:
        build_scene(scene_with(mesh, {**entry, "files": [*files[:2], "gone.obj"]}, frames=3))
    assert caught.value.problems[0].path == "objects.0.deformation.0.files.2"
