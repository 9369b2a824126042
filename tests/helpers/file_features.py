"""Features of mesh files and pictures: small files with the values that they define, and what is read from them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scenetruth.errors import SceneError
from scenetruth.scene.mesh import TriangleMesh, load_mesh_file
from scenetruth.scene.texture import Picture
from tests.helpers.mesh_files import area_of

__all__ = ["FileFeature", "Outcome", "try_feature"]

Shade = tuple[tuple[float, float], float]


@dataclass(frozen=True)
class FileFeature:
    """A file with one feature, and its values by hand, or the reason of its rejection.

    ``form``: Format, such as OBJ. ``name``: The feature. ``files``: Contents by name, the mesh file first.
    ``occurs``: Files of public test collections with this feature.
    ``area``: Area in squares of the unit of the file. ``polygons``: Their number.
    ``shades``: Radiances at places (x, y) of a surface seen along z.
    ``rejected``: Part of the message of the error; None for a file that is read.
    ``of_colours``: Whether only the colours are rejected, and the shape is read.
    ``note``: Part of a note on what is not used.
    """

    form: str
    name: str
    files: Mapping[str, str | bytes]
    occurs: str = ""
    area: float | None = None
    polygons: int | None = None
    shades: tuple[Shade, ...] = ()
    rejected: str | None = None
    of_colours: bool = False
    note: str = ""

    @property
    def label(self) -> str:
        """Format and name."""
        return f"{self.form}: {self.name}"


@dataclass
class Outcome:
    """What was read: figures, the reason of a rejection, and differences from the values of the feature."""

    figures: str = ""
    reason: str = ""
    wrong: list[str] = field(default_factory=list)


def try_feature(feature: FileFeature) -> Outcome:
    """Write the files of a feature, read them, and compare what was read with its values."""
    with tempfile.TemporaryDirectory(prefix="scenetruth-") as scratch:
        folder = Path(scratch)
        for name, content in feature.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        first = folder / next(iter(feature.files))
        found = Outcome()
        try:
            mesh = load_mesh_file(first)
        except SceneError as error:
            found.reason = error.problems[0].message
            if feature.rejected is None or feature.of_colours or feature.rejected not in found.reason:
                found.wrong.append(f"rejected: {found.reason}")
            return found
        _compare_shape(feature, mesh, found)
        try:
            shades = [_shade(mesh, place) for place, _ in feature.shades]
            if feature.of_colours and mesh.appearance is not None:
                mesh.appearance.lay(None)
        except (ValueError, SceneError) as error:
            found.reason = str(error)
            if not feature.of_colours or feature.rejected is None or feature.rejected not in found.reason:
                found.wrong.append(f"colours rejected: {found.reason}")
            return found
        if feature.rejected is not None:
            found.wrong.append("read, not rejected")
        for (place, expected), shade in zip(feature.shades, shades, strict=True):
            if not abs(shade - expected) < 2e-6:
                found.wrong.append(f"radiance {shade:.6f} at {place}, not {expected:.6f}")
        if shades:
            found.figures += f", radiance {', '.join(f'{shade:.4g}' for shade in shades)}"
        return found


def _compare_shape(feature: FileFeature, mesh: TriangleMesh, found: Outcome) -> None:
    area, polygons = area_of(mesh), int(mesh.file_notes[0].split()[0].replace(",", ""))
    found.figures = f"area {area:.6g}, {polygons} polygon{'' if polygons == 1 else 's'}"
    if feature.area is not None and not abs(area - feature.area) <= 1e-6 * max(feature.area, 1e-30):
        found.wrong.append(f"area {area:.9g}, not {feature.area:.9g}")
    if feature.polygons is not None and polygons != feature.polygons:
        found.wrong.append(f"{polygons} polygons, not {feature.polygons}")
    if feature.note and not any(feature.note in line for line in mesh.file_notes):
        found.wrong.append(f"no note of: {feature.note}")


def _shade(mesh: TriangleMesh, place: tuple[float, float]) -> float:
    """Return the radiance at a place of the surface, by barycentric coordinates in its triangle."""
    assert mesh.appearance is not None
    corners = mesh.vertices_mm[mesh.faces][:, :, :2]
    for face, (a, b, c) in enumerate(corners):
        system = np.array([[*a, 1.0], [*b, 1.0], [*c, 1.0]]).T
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        weights = np.linalg.solve(system, [*place, 1.0])
        if weights.min() >= -1e-9:
            if mesh.appearance.has_pictures:
                laid = mesh.appearance.lay(None)
                return float(Picture(laid.values, laid.tiled).radiance((weights @ laid.uv[face])[None])[0])
            return float(weights @ mesh.appearance.radiances(None)[face])
    msg = f"no surface at {place}"
    raise ValueError(msg)
