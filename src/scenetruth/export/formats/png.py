"""Images as 16-bit PNG: ``images/s+0_t+0.png`` for every camera and frame.

65535 is full scale, rows run from the top down. Digital numbers of up to 16 bits follow exactly: round(value / 65535
x full scale). Lost: everything but the images, values beyond full scale, of linear images steps below 1.5e-5.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal

from scenetruth.errors import Problem
from scenetruth.export.base import ExportFormat
from scenetruth.export.source import Source
from scenetruth.storage import write_images

__all__ = ["Png"]


class Png(ExportFormat):
    """Images as 16-bit PNG."""

    kind: Literal["png"] = "png"
    """Name of the format."""
    summary: ClassVar[str] = "images as 16-bit PNG"

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what keeps images from being written."""
        if source.has_colours:
            yield Problem("image", "has colours, and PNG files of 16 bits are written of grey images; take tiff")

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write every image."""
        write_images(source.recording, folder / "images", "png")
        return []
