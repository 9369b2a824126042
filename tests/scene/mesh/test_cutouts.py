"""Surfaces that the opacity of a picture cuts out, against the opacity interpolated between texels."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import scenetruth as st
from scenetruth.errors import BackendUnavailableError
from scenetruth.scene.mesh import TriangleMesh, load_mesh_file
from tests.helpers.mesh_files import area_of

Floats = NDArray[np.float64]
SIDE = 40


def opacity(kind: str) -> NDArray[np.uint8]:
    """Return a disc with a hole, a diagonal, or noise, as opacity of 8 bits."""
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    if kind == "ring":
        away = np.hypot(x - 1.3, y + 0.7)
        values = 0.5 + np.minimum(14.2 - away, away - 6.1) / 6
    elif kind == "diagonal":
        values = 0.5 + (0.7 * x + 0.4 * y + 0.37) / 60
    else:
        spectrum = np.fft.fft2(np.random.default_rng(3).normal(size=(SIDE, SIDE)))
        low = np.exp(-((np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE))) / 0.12) ** 2))
        smooth = np.fft.ifft2(spectrum * low).real
        values = 0.5 + 0.2 * smooth / smooth.std()
    return np.asarray(np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8))


def sheet(folder: Path, alpha: NDArray[np.uint8], cells: int = 1, bend: float = 0.0, **material: Any) -> Path:
    """Write an OBJ of a square of side ``SIDE`` divided into cells, whose texels are unit squares."""
    Image.fromarray(np.dstack([np.full_like(alpha, 200)] * 3 + [alpha])).save(folder / "card.png")
    (folder / "card.mtl").write_text("newmtl card\nmap_Kd card.png\n")
    steps = np.linspace(0, 1, cells + 1)
    lines = ["mtllib card.mtl"]
    for v in steps:
        for u in steps:
            lines += [f"v {SIDE * u:.17g} {SIDE * (1 - v):.17g} {bend * u * u:.17g}", f"vt {u:.17g} {v:.17g}"]
    lines.append("usemtl card")
    for row in range(cells):
        for column in range(cells):
            a = row * (cells + 1) + column + 1
            b, c, d = a + 1, a + cells + 2, a + cells + 1
            lines.append(f"f {a}/{a} {b}/{b} {c}/{c} {d}/{d}")
    (folder / "card.obj").write_text("\n".join(lines))
    return folder / "card.obj"


def interpolated(alpha: NDArray[np.uint8], x: Floats, y: Floats) -> Floats:
    """Return the opacity at points of the square with y downwards; its border continues by repetition."""
    padded = np.pad(alpha / 255.0, 1, mode="wrap")
    x, y = x + 0.5, y + 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - column, y - row
    top = (1 - u) * padded[row, column] + u * padded[row, column + 1]
    below = (1 - u) * padded[row + 1, column] + u * padded[row + 1, column + 1]
    return np.asarray((1 - v) * top + v * below)


def boundary(mesh: TriangleMesh) -> Floats:
    """Return both ends of the edges of a single triangle, shape (n, 2, 3)."""
    places = np.unique(mesh.vertices_mm, axis=0, return_inverse=True)[1].reshape(-1)[mesh.faces]
    sides = np.stack([places, np.roll(places, -1, axis=1)], axis=-1).reshape(-1, 2)
    corners = np.stack([mesh.vertices_mm[mesh.faces], mesh.vertices_mm[np.roll(mesh.faces, -1, axis=1)]], axis=2)
    _, index, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(corners.reshape(-1, 2, 3)[index[count == 1]])


@pytest.mark.parametrize("kind", ["ring", "diagonal", "noise"])
@pytest.mark.parametrize("cells", [1, 7])
def test_the_outline_is_the_contour_of_the_interpolated_opacity(tmp_path: Path, kind: str, cells: int) -> None:
    alpha = opacity(kind)
    mesh = load_mesh_file(sheet(tmp_path, alpha, cells))
    # By sampling, whose error falls with the number of samples along the outline.
    fine = (np.arange(SIDE * 32) + 0.5) / 32
    x, y = np.meshgrid(fine, fine)
    share = float((interpolated(alpha, x, y) >= 0.5).mean())
    assert area_of(mesh) == pytest.approx(share * SIDE**2, rel=1e-3)
    ends = boundary(mesh)
    inside = ((ends > 1e-6) & (ends < SIDE - 1e-6))[..., :2].all(axis=(1, 2))
    points = np.concatenate([ends[inside][:, 0], ends[inside].mean(axis=1)])
    assert len(points) > 20
    off = np.abs(interpolated(alpha, points[:, 0], points[:, 1]) - 0.5)
    x, y = points[:, 0], points[:, 1]
    step = 1e-4
    slope = np.hypot(
        interpolated(alpha, x + step, y) - interpolated(alpha, x - step, y),
        interpolated(alpha, x, y + step) - interpolated(alpha, x, y - step),
    ) / (2 * step)  # fmt: skip
    # In texels; near saddles, opacity hardly changes.
    steep = slope > 0.02
    assert (off / np.maximum(slope, 1e-9))[steep].max() < 0.01
    assert off.max() < 0.002


def test_pieces_of_adjacent_triangles_share_their_vertices(tmp_path: Path) -> None:
    # Edges of single triangles are the outline, of the same length however the sheet is divided.
    lengths = []
    for cells in (1, 3, 8):
        mesh = load_mesh_file(sheet(tmp_path, opacity("ring"), cells))
        ends = boundary(mesh)
        lengths.append(float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()))
        assert any("1 components" in note for note in mesh.file_notes)
    np.testing.assert_allclose(lengths[1:], lengths[0], rtol=2e-4)
    # Circles of radii 14.2 and 6.1, whose opacity is rounded to 8 bits.
    assert lengths[0] == pytest.approx(2 * np.pi * 20.3, rel=2e-3)


def test_bent_sheets_are_cut_where_they_are(tmp_path: Path) -> None:
    mesh = load_mesh_file(sheet(tmp_path, opacity("diagonal"), 8, bend=10.0))
    # Within a cell, z is linear along x.
    steps = np.linspace(0, SIDE, 9)
    expected = np.interp(mesh.vertices_mm[:, 0], steps, 10 * (steps / SIDE) ** 2)
    np.testing.assert_allclose(mesh.vertices_mm[:, 2], expected, atol=1e-9)
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv * SIDE, mesh.vertices_mm[mesh.faces][..., :2], atol=1e-9)


def test_transparent_and_opaque_pictures(tmp_path: Path) -> None:
    alpha = np.full((4, 4), 255, dtype=np.uint8)
    assert area_of(load_mesh_file(sheet(tmp_path, alpha))) == pytest.approx(SIDE**2)
    assert len(load_mesh_file(sheet(tmp_path, alpha // 2 + 1)).faces) == 2
    with pytest.raises(Exception, match="no surface left"):
        load_mesh_file(sheet(tmp_path, alpha // 4))


def test_gltf_cuts_in_mode_mask_at_its_limit(tmp_path: Path) -> None:
    from tests.helpers.mesh_files import data_uri, gltf, read

    alpha = np.broadcast_to(np.rint(np.linspace(0, 255, 11)).astype(np.uint8), (4, 11)).copy()
    Image.fromarray(np.dstack([np.full_like(alpha, 200)] * 3 + [alpha])).save(tmp_path / "card.png")
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    points = np.column_stack([uv * (11, 4), np.zeros(4)]).astype(np.float32)
    arrays: dict[str, Any] = {"points": points, "index": np.array([0, 1, 2, 0, 2, 3], dtype=np.uint8), "uv": uv}
    primitive = {"attributes": {"POSITION": "@points", "TEXCOORD_0": "@uv"}, "indices": "@index", "material": 0}
    clamp = {"wrapS": 33071, "wrapT": 33071}
    for cutoff, factor in ((0.5, 1.0), (0.3, 1.0), (0.25, 0.5)):
        base = {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, factor]}
        material = {"alphaMode": "MASK", "alphaCutoff": cutoff, "pbrMetallicRoughness": base}
        text = gltf(arrays, primitive, materials=[material], textures=[{"source": 0, "sampler": 0}], samplers=[clamp],
                    images=[{"uri": data_uri((tmp_path / "card.png").read_bytes())}])  # fmt: skip
        mesh = read(tmp_path / "card.gltf", text)
        # Opacity times the factor reaches the limit at this distance from the centre of the first texel.
        reached = np.interp(cutoff / factor, alpha[0] / 255, np.arange(11))
        assert mesh.vertices_mm[:, 0].min() == pytest.approx(0.5 + reached, abs=1e-6)
        assert area_of(mesh) == pytest.approx(4 * (11 - 0.5 - reached), rel=1e-6)
    document = json.loads(text)
    document["materials"][0]["alphaMode"] = "OPAQUE"
    assert area_of(read(tmp_path / "card.gltf", json.dumps(document))) == pytest.approx(44)


@pytest.mark.parametrize("kind", ["ring", "noise"])
def test_ids_depth_and_images_follow_the_contour(tmp_path: Path, kind: str) -> None:
    """Every pixel centre is projected onto the plane of the card, where its opacity is interpolated between texels."""
    alpha = opacity(kind)
    width, height, focal, unit_mm = 140, 110, 220.0, 0.5
    a, b = np.deg2rad([20.0, 25.0])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    axes = about_y @ about_x
    corner = np.array([0.7, -0.4, 60.0]) - axes @ (unit_mm * SIDE / 2 * np.array([1, 1, 0]))
    turns = [{"axis": [1, 0, 0], "angle_deg": 20}, {"axis": [0, 1, 0], "angle_deg": 25}]
    card = {
        "name": "card",
        "mesh": {"kind": "file", "file": str(sheet(tmp_path, alpha)), "unit_mm": unit_mm},
        "pose": {"position_mm": corner.tolist(), "rotations": turns},
        "texture": {"kind": "embedded"},
    }
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 90]}}
    plain: dict[str, Any] = {
        "camera": {"width": width, "height": height, "focal_length_px": focal},
        "stage": {"positions": 3, "baseline_mm": 3},
        "frames": {"count": 3},
        "objects": [card, {**wall, "texture": {"kind": "uniform", "radiance": 0.25}}],
    }
    recording, truth = st.simulate({**plain, "render": {"backend": "raycast", "supersampling": 4}})
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(x - (width - 1) / 2) / focal, (y - (height - 1) / 2) / focal, np.ones_like(x)], axis=-1)
    depth = (corner @ axes[:, 2]) / (rays @ axes[:, 2])
    place = ((rays * depth[..., None] - corner) @ axes)[..., :2] / unit_mm
    inside = ((place > 0) & (place < SIDE)).all(axis=-1)
    shown = np.zeros((height, width))
    shown[inside] = interpolated(alpha, *place[inside].T)
    clear = np.abs(shown - 0.5) > 1e-9
    is_card = shown > 0.5
    assert 500 < is_card.sum() < inside.sum() - 500
    found = truth.sel(t=0)
    np.testing.assert_array_equal((found["object_id"].values == 0)[clear], is_card[clear])
    np.testing.assert_allclose(found["depth"].values[clear], np.where(is_card, depth, 90.0)[clear], rtol=1e-12)
    try:
        other, _ = st.simulate({**plain, "render": {"backend": "pyrender", "platform": "osmesa"}})
    except BackendUnavailableError:
        pytest.skip("images of pyrender: OSMesa is not installed")
    one, two = (each["image"].values / each.attrs["full_scale"] for each in (recording, other))
    # Both take the mean of a few samples in a pixel: those at the contour differ by less than one of them.
    assert np.abs(one - two).mean() < 5e-4
    assert np.abs(one - two).max() < 0.2
