"""Images as float TIFF: ``images/s+0_t+0.tiff`` for every camera and frame.

Float32 with 1 for full scale, rows from the top down; colours have their channels last. Digital numbers of up to 16
bits follow exactly: round(value x full scale). Lost: everything but the images.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from scenetruth.export.base import ExportFormat
from scenetruth.export.source import Source
from scenetruth.storage import write_images

__all__ = ["Tiff"]


class Tiff(ExportFormat):
    """Images as float TIFF."""

    kind: Literal["tiff"] = "tiff"
    """Name of the format."""
    summary: ClassVar[str] = "images as float32 TIFF"

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write every image."""
        write_images(source.recording, folder / "images", "tiff")
        return []
