"""What is drawn to scale in every piece of the side view: cameras, fields of view, depth of field, objects."""

from __future__ import annotations

from scenetruth.design.page.side_view.frame import Frame
from scenetruth.design.page.side_view.marks import area, line
from scenetruth.design.page.side_view.view import SideView
from scenetruth.pages.charts import COLOURS

__all__ = ["CAMERA", "cameras_on", "colours_of", "scenery_in"]

CAMERA = 16.0
"""Length of the sign of a camera on paper."""
_LEAST = 2.0
"""Half of its least width."""
_OF_OBJECTS = tuple(colour for number, colour in enumerate(COLOURS) if number not in (0, 2, 4))
"""Blue is the field of view, green the depth of field."""


def colours_of(view: SideView) -> list[str]:
    """Return the colour of each outline: one for all of them if they are too many to be told apart."""
    count = len(view.outlines)
    return list(_OF_OBJECTS[:count]) if count <= len(_OF_OBJECTS) else [_OF_OBJECTS[0]] * count


def scenery_in(view: SideView, frame: Frame) -> list[str]:
    """Return what lies before the cameras."""
    last, (x0, x1) = frame.z_mm[1], frame.x_mm
    low, high = min(view.cameras_mm), max(view.cameras_mm)
    drawn = []
    if view.sharp is not None:
        near, far = view.sharp.near_mm, min(view.sharp.far_mm, last)
        drawn.append(area(frame.placed([(near, x0), (far, x0), (far, x1), (near, x1)]), "sharp"))
    field = [(0.0, 0.0), (last, view.left * last), (last, view.right * last)]
    drawn.append(area(frame.placed(field), "field"))
    start = view.common_from_mm
    if start < last:
        begin = high + view.left * start
        common = [(start, begin), (last, high + view.left * last), (last, low + view.right * last)]
        drawn.append(area(frame.placed(common), "common"))
    if view.travel_mm > 0:
        drawn += [
            line(frame.at(0.0, camera), frame.at(last, camera + slope * last), "border")
            for camera in (low, high)
            for slope in (view.left, view.right)
        ]
    drawn.append(line(frame.at(0.0, 0.0), frame.at(last, 0.0), "axis"))
    if view.sharp is not None:
        drawn.append(line(frame.at(view.sharp.focus_mm, x0), frame.at(view.sharp.focus_mm, x1), "focus"))
    for outline, colour in zip(view.outlines, colours_of(view), strict=True):
        there = zip(outline.near_mm, outline.x_mm, strict=True)
        back = zip(outline.far_mm[::-1], outline.x_mm[::-1], strict=True)
        drawn.append(area(frame.placed([*there, *back]), "outline", colour=colour))
    return drawn


def cameras_on(view: SideView, frame: Frame) -> list[str]:
    """Return signs of the cameras on their stage; the tip of each, its projection centre, is to scale."""
    if not frame.inside(0.0):
        return []
    # Neighbours do not hide each other, if there is room.
    apart = frame.scale * view.travel_mm / (len(view.cameras_mm) - 1) if view.travel_mm > 0 else CAMERA
    half = min(max(0.45 * apart, _LEAST), 0.45 * CAMERA)
    first = frame.at(0.0, min(view.cameras_mm), ahead=-CAMERA - 3, aside=-12.0)
    last = frame.at(0.0, max(view.cameras_mm), ahead=-CAMERA - 3, aside=12.0)
    drawn = [line(first, last, "rail")]
    for place, x in enumerate(view.cameras_mm):
        behind = [frame.at(0.0, x, ahead=-CAMERA, aside=sign * half) for sign in (-1, 1)]
        kind = "camera reference" if place == view.reference else "camera"
        drawn.append(area([frame.at(0.0, x), *behind], kind))
    return drawn
