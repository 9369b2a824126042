"""Export of recordings, truths and estimates: one class per file format."""

from scenetruth.exporters.export_source import CameraPair, ExportSource, FlowKind
from scenetruth.exporters.export_writer import (
    ExportResult,
    checked_source,
    choose_format,
    export_data,
    export_formats,
    write_export,
)
from scenetruth.exporters.format_base import ExportFormat, FlowOptions, PairOptions, PictureOptions, load_formats

__all__ = [
    "CameraPair", "ExportFormat", "ExportResult", "ExportSource", "FlowKind", "FlowOptions", "PairOptions",
    "PictureOptions", "checked_source", "choose_format", "export_data", "export_formats", "load_formats",
    "write_export",
]  # fmt: skip
