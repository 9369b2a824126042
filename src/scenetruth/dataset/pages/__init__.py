"""Pages on recipes and data sets: card, preview, Croissant metadata, and their templates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.dataset.pages.croissant import Publication, describe_column
    from scenetruth.dataset.pages.figures import (
        PlotQuantity,
        collect_quantities,
        draw_contact_sheet,
        draw_histograms,
        draw_pairs,
        select_paired,
        split_quantities,
        to_display_grey,
    )
    from scenetruth.dataset.pages.page_text import (
        describe_criterion,
        describe_distribution,
        describe_splits,
        escape_markdown,
        format_code,
        format_label,
        format_title,
    )
    from scenetruth.dataset.pages.preview_page import PAGE, SIMPLIFIED, render_thumbnail, simplify_scene

__all__ = [
    "PAGE", "SIMPLIFIED", "PlotQuantity", "Publication", "collect_quantities", "describe_column", "describe_criterion",
    "describe_distribution", "describe_splits", "draw_contact_sheet", "draw_histograms", "draw_pairs",
    "escape_markdown", "format_code", "format_label", "format_title", "render_thumbnail", "select_paired",
    "simplify_scene", "split_quantities", "to_display_grey",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "croissant": "Publication describe_column",
        "figures": (
            "PlotQuantity collect_quantities draw_contact_sheet draw_histograms draw_pairs select_paired "
            "split_quantities to_display_grey"
        ),
        "page_text": (
            "describe_criterion describe_distribution describe_splits escape_markdown format_code format_label "
            "format_title"
        ),
        "preview_page": "PAGE SIMPLIFIED render_thumbnail simplify_scene",
    },
)
