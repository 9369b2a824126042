"""Captures of a laboratory: calibration boards and simulated captures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.board_artwork import (
        BoardArtwork,
        BoardKind,
        BoardPrint,
        default_board,
        draw_board,
        draw_dots,
        read_board_print,
    )
    from scenetruth.capture.board_rendering import (
        BoardLight,
        BoardRenderer,
        InkRenderer,
        PlacedBoard,
        open_board_renderer,
        project_points,
    )
    from scenetruth.capture.simulated_capture import simulate_capture
    from scenetruth.capture.simulated_rig import BoardPose, CaptureSimulation

__all__ = [
    "BoardArtwork", "BoardKind", "BoardLight", "BoardPose", "BoardPrint", "BoardRenderer", "CaptureSimulation",
    "InkRenderer", "PlacedBoard", "default_board", "draw_board", "draw_dots", "open_board_renderer",
    "project_points", "read_board_print", "simulate_capture",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "board_artwork": "BoardArtwork BoardKind BoardPrint default_board draw_board draw_dots read_board_print",
        "board_rendering": ("BoardLight BoardRenderer InkRenderer PlacedBoard open_board_renderer project_points"),
        "simulated_capture": "simulate_capture",
        "simulated_rig": "BoardPose CaptureSimulation",
    },
)
