"""Pages at true scale: what is in the files, read back without the code that wrote them."""

from __future__ import annotations

import base64
import io
import json
import re
import zlib
from pathlib import Path
from xml.etree import ElementTree

import imageio.v3 as imageio
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as some
from PIL import Image
from scipy.spatial import cKDTree

import scenetruth as st
from scenetruth.design.patterns import InkDots, Pattern, export_pattern, generate_pattern, lay_out_pages
from scenetruth.errors import ArgumentError
from tests.helpers.pattern_rigs import plain_rig

SVG = "{http://www.w3.org/2000/svg}"
POINTS_PER_MM = 72 / 25.4


@pytest.fixture(scope="module")
def dots() -> Pattern:
    return generate_pattern(plain_rig(), size_mm=(70.0, 50.0), dot_mm=1.5, seed=3)


@pytest.fixture(scope="module")
def written(dots: Pattern, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pattern")
    export_pattern(dots, folder)
    return folder


def content_of(pdf: bytes) -> str:
    """All drawing commands of a PDF file's pages."""
    parts = []
    for found in re.finditer(rb"<<[^<>]*?/FlateDecode[^<>]*?>>\s*stream\r?\n", pdf):
        try:
            parts.append(zlib.decompressobj().decompress(pdf[found.end() :]).decode("latin-1"))
        except zlib.error:
            continue
    return "\n".join(part for part in parts if re.search(r"\b(Do|re|l)\b", part))


def test_svg_is_in_mm(dots: Pattern, written: Path) -> None:
    root = ElementTree.parse(written / "pattern.svg").getroot()
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == ("210mm", "297mm", "0 0 210 297")
    pattern = next(group for group in root.iter(f"{SVG}g") if group.get("id") == "pattern")
    # Moved, and neither stretched nor turned.
    assert re.fullmatch(r"translate\([\d.]+ [\d.]+\)", pattern.get("transform", ""))
    circles = np.array([[float(c.get(k, "")) for k in ("cx", "cy", "r")] for c in root.iter(f"{SVG}circle")])
    marks = dots.marks((0, 0, 70, 50))
    assert isinstance(marks, InkDots)
    np.testing.assert_allclose(circles[:, :2], marks.centres_mm, atol=5e-5)
    np.testing.assert_allclose(circles[:, 2], 0.75, atol=5e-5)
    # What these circles cover, point by point, is what is told to be printed.
    x, y = np.meshgrid(np.arange(0.05, 70, 0.1), np.arange(0.05, 50, 0.1))
    covered = np.zeros(x.shape, dtype=bool)
    for cx, cy, r in circles:
        near = (slice(*np.searchsorted(y[:, 0], [cy - r, cy + r])), slice(*np.searchsorted(x[0], [cx - r, cx + r])))
        covered[near] |= (x[near] - cx) ** 2 + (y[near] - cy) ** 2 <= r * r
    assert covered.mean() == pytest.approx(0.5, abs=0.005)
    ink = dots.drawing.ink((0, 0, 70, 50), covered.shape)
    # Rims, 4 x 0.5 / D per area, run through texels of 0.1 mm that are half of one and half of the other, 1/4 off.
    assert np.abs(ink - covered).mean() == pytest.approx(4 * 0.5 / 1.5 * 0.1 / 4, rel=0.1)


def test_rulers_are_100_mm_long(written: Path) -> None:
    root = ElementTree.parse(written / "pattern.svg").getroot()
    lines = np.array([[float(e.get(k, "")) for k in ("x1", "y1", "x2", "y2")] for e in root.iter(f"{SVG}line")])
    steps = lines[:, 2:] - lines[:, :2]
    for along in (0, 1):
        (ruler,) = lines[np.abs(steps[:, along]) > 50]
        assert abs(ruler[along + 2] - ruler[along]) == pytest.approx(100)
        # Ticks stand on it, every mm.
        on = np.isclose(lines[:, 1 - along], ruler[1 - along]) & (steps[:, along] == 0)
        np.testing.assert_allclose(np.diff(np.sort(lines[on][:, along])), 1.0, atol=1e-4)
        assert on.sum() == 101
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert texts.count("100 mm") == 2
    told = " ".join(str(text) for text in texts)
    for part in ("seed 3", "dots of 1.500 mm (7.50 px)", "2000 px at 400 mm", "Print at 100 %", "Page 1 of 1."):
        assert part in told


def test_pdf_is_in_points(dots: Pattern, written: Path) -> None:
    pdf = (written / "pattern.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf)
    assert len(boxes) == 1
    np.testing.assert_allclose(
        [float(side) for side in boxes[0]], [210 * POINTS_PER_MM, 297 * POINTS_PER_MM], atol=1e-3
    )
    content = content_of(pdf)
    number = r"(-?[\d.]+)"
    lines = re.findall(rf"{number} {number} m\s+{number} {number} l\s+S", content)
    ends = np.array(lines, dtype=float).reshape(-1, 2, 2) / POINTS_PER_MM
    steps = np.abs(ends[:, 1] - ends[:, 0])
    for along in (0, 1):
        (ruler,) = steps[steps[:, along] > 50]
        assert ruler[along] == pytest.approx(100, abs=1e-3)
        assert ruler[1 - along] == pytest.approx(0, abs=1e-3)
    # The tile is cut off at its borders, 24 mm from the left and 15 mm from above.
    (clip,) = re.findall(rf"{number} {number} {number} {number} re W n 0 g", content)
    expected = np.array([24, 297 - 15 - 50, 70, 50]) * POINTS_PER_MM
    np.testing.assert_allclose(np.array(clip, dtype=float), expected, atol=1e-3)
    # Dots are one outline that is moved from centre to centre; those wholly outside may be left out.
    moves = np.array(re.findall(rf"1 0 0 1 {number} {number} cm /\w+ Do", content), dtype=float)
    found = np.cumsum(moves, axis=0) / POINTS_PER_MM * (1, -1) + (-24, 297 - 15)
    marks = dots.marks((0, 0, 70, 50))
    assert isinstance(marks, InkDots)
    centres = marks.centres_mm
    inside = ((centres > -0.75) & (centres < (70.75, 50.75))).all(axis=1)
    known = cKDTree(found)
    assert known.query(centres[inside])[0].max() < 1e-3
    assert inside.sum() <= len(found) <= len(centres)
    # The outline is as wide as the dots.
    (outline,) = re.findall(rb"/Subtype /Form\s*/BBox \[ ([-\d.]+) ([-\d.]+) ([-\d.]+) ([-\d.]+) \]", pdf)
    np.testing.assert_allclose(np.array(outline, dtype=float) / POINTS_PER_MM, [-0.75, -0.75, 0.75, 0.75], atol=1e-4)


def test_files_are_the_same_every_time(dots: Pattern, written: Path, tmp_path: Path) -> None:
    files = export_pattern(dots, tmp_path)
    assert {file.name for file in files} == {file.name for file in written.iterdir()}
    for file in files:
        assert file.read_bytes() == (written / file.name).read_bytes(), file.name


def test_the_image_and_the_lines_make_a_scene(dots: Pattern, written: Path) -> None:
    image = imageio.imread(written / "pattern.png")
    # Four texels per px of 0.2 mm.
    assert image.shape == (1000, 1400)
    assert image.mean() / 255 == pytest.approx(0.45, abs=0.005)
    plain = yaml.safe_load((written / "scene_lines.yaml").read_text())
    plain |= {"camera": {"width": 40, "height": 30, "focal_length_px": 2000}}
    plain |= {"stage": {"positions": 2, "baseline_mm": 2}, "frames": {"count": 1}}
    (written / "scene.yaml").write_text(yaml.safe_dump(plain))
    recording, truth = st.simulate(st.load_scene(written / "scene.yaml", overrides=["render.backend=raycast"]))
    (written / "scene.yaml").unlink()
    assert float(truth["depth"].mean()) == pytest.approx(400)
    # The middle of the pattern is in the middle of the image.
    seen = recording["image"].sel(s=0, t=0).values
    shown = dots.radiance((31.0, 22.0, 8.0, 6.0), (30, 40))
    assert np.abs(seen - shown).mean() < 0.02
    told = json.loads((written / "pattern.json").read_text())
    assert told["pattern"]["dot_mm"] == 1.5
    assert told["rig"]["focal_length_px"] == 2000


def test_noise_is_printed_as_outlines_and_shades_as_a_picture(tmp_path: Path) -> None:
    noise = generate_pattern(plain_rig(), "noise", size_mm=(60.0, 50.0), wavelength_mm=(4.0, 12.0))
    export_pattern(noise, tmp_path)
    root = ElementTree.parse(tmp_path / "pattern.svg").getroot()
    (path,) = root.iter(f"{SVG}path")
    total = 0.0
    for piece in path.get("d", "").split("z")[:-1]:
        numbers = np.array(re.findall(r"-?[\d.]+(?:e-?\d+)?", piece), dtype=float).reshape(-1, 2)
        x, y = np.cumsum(numbers, axis=0).T
        total += 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    assert abs(total) / 3000 == pytest.approx(noise.drawing.ink((0, 0, 60, 50), (500, 600)).mean(), abs=0.01)
    grey = generate_pattern(plain_rig(), "grey_noise", size_mm=(60.0, 50.0), wavelength_mm=(4.0, 12.0))
    export_pattern(grey, tmp_path)
    root = ElementTree.parse(tmp_path / "pattern.svg").getroot()
    (image,) = root.iter(f"{SVG}image")
    assert [image.get(key) for key in ("x", "y", "width", "height")] == ["0", "0", "60", "50"]
    data = image.get("{http://www.w3.org/1999/xlink}href", "").partition("base64,")[2]
    assert Image.open(io.BytesIO(base64.b64decode(data))).size == (120, 100)
    # Of 16 bits, so that shades are not rounded.
    assert imageio.imread(tmp_path / "pattern.png").dtype == np.uint16


@settings(max_examples=40)
@given(
    width=some.floats(20, 900),
    height=some.floats(20, 900),
    page=some.sampled_from(["A4", "a3", "A5", "letter", "250x180"]),
    margin=some.floats(0, 15),
)
def test_tiles_cover_a_pattern_once(width: float, height: float, page: str, margin: float) -> None:
    pattern = generate_pattern(plain_rig(), size_mm=(width, height), dot_mm=2.4, coverage=0.01)
    pages = lay_out_pages(pattern, page, margin)
    boxes = np.array([each.tile_mm for each in pages])
    assert (boxes[:, 2] * boxes[:, 3]).sum() == pytest.approx(width * height)
    assert (boxes[:, :2] + boxes[:, 2:]).max(axis=0) == pytest.approx([width, height])
    assert len({tuple(corner) for corner in boxes[:, :2].tolist()}) == len(pages)
    for number, each in enumerate(pages, start=1):
        left, top, wide, high = each.place_mm
        assert (wide, high) == each.tile_mm[2:]
        # Nothing is nearer to the paper's edge than the printer can print; letters reach 4 mm beyond what they name.
        for line in each.lines:
            assert min(line.x0, line.x1) >= margin - 1e-9
            assert max(line.x0, line.x1) <= each.size_mm[0] - margin + 1e-9
            assert margin - 1e-9 <= min(line.y0, line.y1)
            assert max(line.y0, line.y1) <= each.size_mm[1] - margin + 1e-9
        assert top >= margin
        assert left + wide <= each.size_mm[0] - margin + 1e-9
        assert max(text.y for text in each.texts) <= each.size_mm[1] - margin
        assert f"Page {number} of {len(pages)}" in each.texts[-1].content


def test_paper_is_laid_across_where_that_takes_fewer_pages() -> None:
    pattern = generate_pattern(plain_rig(), size_mm=(240.0, 120.0), dot_mm=2.4)
    (page,) = lay_out_pages(pattern, "A4")
    assert page.size_mm == (297.0, 210.0)


def test_paper_that_does_not_do_is_told(dots: Pattern) -> None:
    with pytest.raises(ArgumentError, match=r"(?s)2 problems.*page: must be one of A5.*margin_mm"):
        lay_out_pages(dots, "B7", -1)
    with pytest.raises(ArgumentError, match="leaves less than 20 mm"):
        lay_out_pages(dots, "60x60")
    huge = generate_pattern(plain_rig(), size_mm=(5000.0, 5000.0), dot_mm=20)
    with pytest.raises(ArgumentError, match=r"takes [\d,]+ pages, more than 400"):
        lay_out_pages(huge, "A5")
