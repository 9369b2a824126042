"""A pattern into a folder: pages to print, an image for scenes, and the lines that use it."""

from __future__ import annotations

import json
import math
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.design.pattern.make import Pattern
from scenetruth.design.pattern.printing.layout import pages_of
from scenetruth.design.pattern.printing.pdf import write_pdf
from scenetruth.design.pattern.printing.svg import svg_of

__all__ = ["IMAGE", "PDF", "SCENE_LINES", "SIGN", "scene_lines", "write_image", "write_pattern"]

SIGN, PDF, IMAGE, SCENE_LINES = "pattern.json", "pattern.pdf", "pattern.png", "scene_lines.yaml"
"""Names of the files, but for those of the pages in SVG."""

# Texels of the image: per px of the rig, and at most.
_PER_PX, _MOST_TEXELS = 4, 64_000_000


def write_pattern(pattern: Pattern, folder: str | Path, *, page: str = "A4", margin_mm: float = 10.0) -> list[Path]:
    """Write a pattern into a folder that exists.

    Parameters
    ----------
    pattern
        The pattern.
    folder
        The folder.
    page, margin_mm
        Paper, as of `scenetruth.design.pattern.printing.layout.pages_of`.

    Returns
    -------
    list of pathlib.Path
        ``pattern.pdf`` with all pages, ``pattern.svg`` or one SVG file for each page, ``pattern.png``, the pattern as
        an image texture, ``scene_lines.yaml``, what to write into a scene file, and ``pattern.json``, what it is made
        from.

    Raises
    ------
    PatternError
        If the paper is unknown, or too small.

    See Also
    --------
    scenetruth.design.pattern.make_pattern : The pattern.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.design.pattern import make_pattern, rig_of, write_pattern
    >>> pattern = make_pattern(rig_of(focal_length_px=2500, distance_mm=500), size_mm=(10, 10), seed=1)
    >>> with TemporaryDirectory() as folder:
    ...     files = write_pattern(pattern, folder, page="A5")
    ...     print(*(file.name for file in files))
    ...     print(Path(folder, "scene_lines.yaml").read_text(), end="")
    pattern.pdf pattern.svg pattern.png scene_lines.yaml pattern.json
    # dots of 0.800 mm (4.00 px), 50 % covered, centres at least 1 diameters apart; seed 1
    objects:
      - name: pattern
        mesh: {kind: plane, size_mm: [10, 10]}
        pose: {position_mm: [0, 0, 500]}
        texture: {kind: image, file: pattern.png, encoding: linear}
    """
    pages = pages_of(pattern, page, margin_mm)
    place = Path(folder)
    files = [place / PDF]
    write_pdf(files[0], pattern, pages)
    digits = len(str(len(pages)))
    for number, each in enumerate(pages, start=1):
        name = "pattern.svg" if len(pages) == 1 else f"pattern_{number:0{digits}}.svg"
        files.append(place / name)
        files[-1].write_text(svg_of(pattern, each), encoding="utf-8")
    write_image(place / IMAGE, pattern)
    (place / SCENE_LINES).write_text(scene_lines(pattern), encoding="utf-8")
    told = {
        "scenetruth": version("scenetruth"),
        "pattern": pattern.to_plain(),
        "rig": pattern.rig.model_dump(mode="json"),
        "page": page,
        "pages": len(pages),
    }
    (place / SIGN).write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return [*files, place / IMAGE, place / SCENE_LINES, place / SIGN]


def scene_lines(pattern: Pattern, file: str = IMAGE) -> str:
    """Return what a scene file needs to show the pattern on a plane.

    Parameters
    ----------
    pattern
        The pattern.
    file
        Its image, as `write_pattern` writes it.
    """
    width, height = pattern.size_mm
    return (
        f"# {pattern.told}; seed {pattern.seed}\n"
        "objects:\n"
        "  - name: pattern\n"
        f"    mesh: {{kind: plane, size_mm: [{width:g}, {height:g}]}}\n"
        f"    pose: {{position_mm: [0, 0, {pattern.rig.distance_mm:.6g}]}}\n"
        f"    texture: {{kind: image, file: {file}, encoding: linear}}\n"
    )


def write_image(file: Path, pattern: Pattern) -> None:
    """Write a pattern as an image texture: linear reflectance, four texels per px of the rig.

    Parameters
    ----------
    file
        PNG file, of 8 bits, or 16 for shades of grey.
    pattern
        The pattern.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    width, height = pattern.size_mm
    pitch = max(pattern.rig.mm_per_px / _PER_PX, math.sqrt(width * height / _MOST_TEXELS))
    shape = (max(round(height / pitch), 2), max(round(width / pitch), 2))
    reflectance = pattern.radiance((0.0, 0.0, width, height), shape)
    told = PngInfo()
    told.add_text("Software", "scenetruth")
    told.add_text("Description", f"linear reflectance; {pattern.told}; seed {pattern.seed}")
    options: dict[str, Any] = {"pnginfo": told, "dpi": (shape[1] / width * 25.4, shape[0] / height * 25.4)}
    if pattern.model.kind == "grey_noise":
        Image.fromarray(np.round(65535 * reflectance).astype(np.uint16)).save(file, **options)
    else:
        Image.fromarray(np.round(255 * reflectance).astype(np.uint8)).save(file, **options)
