"""Surface points as PLY, binary little endian, one file for each camera and frame.

``s+0_t+0.ply`` has one vertex for every pixel that sees a surface: ``x y z`` in float64, mm, in the world, which is
the frame of the reference camera where it is planned to stand (X right, Y down, Z forward), ``red green blue`` (the
image's grey or colours, full scale 255), ``column row`` of the pixel, and where the data set has them ``nx ny nz``
(unit normal, towards the camera), ``velocity_x velocity_y velocity_z`` (instantaneous, mm per frame), ``growth_rate``
(relative rate of area, per frame) and ``object_id``. Vectors are along the world's axes; normals, velocities and
growth are float32. Points of a camera with real poses are where they were in fact. Viewers that expect Y upwards show
them upside down. Pixels without a surface or a depth have no vertex; unknown velocities are NaN. A velocity is no
displacement to the next frame. Lost: what is not a map of points (who sees them), digits of vectors beyond float32.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.export.base import ExportFormat
from scenetruth.export.geometry import point_problems, points_in_world, pose_of
from scenetruth.export.raster import image_name
from scenetruth.export.source import Source

__all__ = ["Ply"]


class Ply(ExportFormat):
    """Surface points as PLY."""

    kind: Literal["ply"] = "ply"
    """Name of the format."""
    coordinates: Literal["float64", "float32"] = "float64"
    """Type of x, y and z; float32 moves points by up to 6e-8 of their distance."""
    summary: ClassVar[str] = "surface points with colour, normal, velocity, growth as .ply"
    packages: ClassVar[tuple[str, ...]] = ("plyfile",)

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing."""
        yield from point_problems(source)

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write one file for each image that has maps."""
        from plyfile import PlyData, PlyElement

        comments = ["made by scenetruth", "mm; X right, Y down, Z forward", "velocity in mm per frame, instantaneous"]
        count = 0
        for s in source.views:
            for t in source.frames:
                vertices = self._vertices(source, s, t)
                count += len(vertices)
                data = PlyData([PlyElement.describe(vertices, "vertex")], text=False, byte_order="<", comments=comments)
                data.write(str(folder / f"{image_name(s, t)}.ply"))
        return [f"{count} points"]

    def _vertices(self, source: Source, s: int, t: int) -> NDArray[Any]:
        points = points_in_world(source, s, t)
        rows, columns = np.nonzero(np.isfinite(points).all(axis=0))
        image = source.image(s, t)[rows, columns]
        colours = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8).reshape(len(rows), -1)
        # Grey has one channel, and three colours that are alike.
        colours = colours if colours.shape[1] == 3 else np.repeat(colours[:, :1], 3, axis=1)
        fields: dict[str, NDArray[Any]] = {
            name: points[axis, rows, columns].astype(self.coordinates) for axis, name in enumerate("xyz")
        }
        axes = pose_of(source, s, t).axes
        for map_name, names in (
            ("normal", ("nx", "ny", "nz")),
            ("velocity", ("velocity_x", "velocity_y", "velocity_z")),
        ):
            if map_name in source.maps:
                turned = axes @ source.map(map_name, s, t)[:, rows, columns]
                fields |= dict(zip(names, turned.astype(np.float32), strict=True))
        fields |= dict(zip(("red", "green", "blue"), colours.T, strict=True))
        if "growth_rate" in source.maps:
            fields["growth_rate"] = source.map("growth_rate", s, t)[rows, columns].astype(np.float32)
        if "object_id" in source.maps:
            fields["object_id"] = source.raw("object_id", s, t)[rows, columns].astype(np.int32)
        fields |= {"column": columns.astype(np.int32), "row": rows.astype(np.int32)}
        vertices = np.empty(len(rows), dtype=[(name, values.dtype) for name, values in fields.items()])
        for name, values in fields.items():
            vertices[name] = values
        return vertices
