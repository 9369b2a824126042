"""Recordings, truths and estimates in the formats of others: one module for each, in `export.formats`."""

from scenetruth.export.base import ExportFormat, FlowOptions, PairOptions, PictureOptions, known_formats
from scenetruth.export.source import FlowKind, Pair, Source
from scenetruth.export.writing import (
    Exported,
    checked_source,
    choose_format,
    export_data,
    export_formats,
    write_export,
)

__all__ = [
    "ExportFormat",
    "Exported",
    "FlowKind",
    "FlowOptions",
    "Pair",
    "PairOptions",
    "PictureOptions",
    "Source",
    "checked_source",
    "choose_format",
    "export_data",
    "export_formats",
    "known_formats",
    "write_export",
]
