"""The report of an estimate: one HTML page with numbers, figures, definitions and provenance."""

from scenetruth.scoring.report.hotspot_pictures import (
    HotspotPicture,
    draw_hotspot,
    draw_hotspot_map,
    show_errors,
    stretch_grey,
)
from scenetruth.scoring.report.map_packing import (
    LEVELS,
    RELATIVE_ROUNDING,
    PackedMap,
    pack_map,
    pack_viewer_images,
    unpack_map,
)
from scenetruth.scoring.report.map_summaries import describe_maps, describe_parts
from scenetruth.scoring.report.report_content import (
    build_score_content,
    describe_invalidity,
    describe_noise,
    state_result,
    summarise_estimate,
    summarise_score,
)
from scenetruth.scoring.report.score_report import matches_fingerprint, write_report
from scenetruth.scoring.report.setting_rows import describe_settings, name_setting
from scenetruth.scoring.report.surface_rows import describe_surfaces
from scenetruth.scoring.report.viewer import Viewer, build_viewer

__all__ = [
    "LEVELS", "RELATIVE_ROUNDING", "HotspotPicture", "PackedMap", "Viewer", "build_score_content", "build_viewer",
    "describe_invalidity", "describe_maps", "describe_noise", "describe_parts", "describe_settings",
    "describe_surfaces", "draw_hotspot", "draw_hotspot_map", "matches_fingerprint", "name_setting", "pack_map",
    "pack_viewer_images", "show_errors", "state_result", "stretch_grey", "summarise_estimate", "summarise_score",
    "unpack_map", "write_report",
]  # fmt: skip
