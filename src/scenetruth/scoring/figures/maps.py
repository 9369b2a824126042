"""The figures of depth, disparity and optical flow as maps."""

from __future__ import annotations

from pathlib import Path

from scenetruth.scoring.figures._common import FigureInfo
from scenetruth.scoring.figures._comparison import draw_comparison
from scenetruth.scoring.figures._views import Views

__all__ = ["draw_depth", "draw_disparity", "draw_flow"]


def draw_depth(views: Views, folder: Path) -> FigureInfo:
    """Draw the estimated depth, and if there is a truth that and the difference of the two."""
    caption = draw_comparison(views, ("depth",), folder / "depth.png")
    return FigureInfo("depth.png", _title(views, "Depth"), f"{caption} A larger depth is farther from the camera.")


def draw_disparity(views: Views, folder: Path) -> FigureInfo:
    """Draw the estimated disparity, and if there is a truth that and the difference of the two."""
    caption = draw_comparison(views, ("disparity",), folder / "disparity.png")
    return FigureInfo(
        "disparity.png", _title(views, "Disparity"), f"{caption} A larger disparity is nearer to the camera."
    )


def draw_flow(views: Views, folder: Path) -> FigureInfo:
    """Draw both components of the estimated optical flow, and if there is a truth that and the differences."""
    caption = draw_comparison(views, ("flow_x", "flow_y"), folder / "flow.png", signed=True)
    return FigureInfo(
        "flow.png",
        _title(views, "Optical flow"),
        f"{caption} Red is a motion to the right (x) or downwards (y), blue to the left or upwards.",
    )


def _title(views: Views, name: str) -> str:
    return f"{name}: estimate{', truth and error' if views.truth else ''}, t = {views.frame}"
