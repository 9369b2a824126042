"""Draws a rig seen along Y, to scale: the whole, the stage enlarged, and the object enlarged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from scenetruth.design.page.side_view.frame import Frame, Place, round_length_mm
from scenetruth.design.page.side_view.marks import across, area, down, line, scale_bar, words
from scenetruth.design.page.side_view.scenery import CAMERA, cameras_on, scenery_in
from scenetruth.design.page.side_view.view import SideView
from scenetruth.design.page.words import length

__all__ = ["Drawing", "drawings_of", "words_of"]

_ROOM, _UPRIGHT_ROOM, _DETAIL_ROOM = (860.0, 400.0), (150.0, 560.0), (300.0, 260.0)
"""Most width and height of what is drawn to scale."""
_ENLARGED = 1.6
"""A detail that is not enlarged by so much tells nothing new."""
_MOST_NAMED, _LEAST_APART = 11, 16.0
"""Camera positions that have their names beside them, and how far apart these must be."""
_BAR = 110.0
"""A scale bar is no longer on paper."""


@dataclass(frozen=True)
class Drawing:
    """A drawing.

    Parameters
    ----------
    name
        Its name within the page.
    title
        What it shows.
    svg
        The drawing, as an element of HTML.
    width
        Its width in CSS pixels at which words have the size of a page's.
    shown
        On which screens: ``"wide"``, ``"narrow"`` or ``"all"``.
    """

    name: str
    title: str
    svg: str
    width: float
    shown: str


def drawings_of(view: SideView) -> list[Drawing]:
    """Return the drawings of a rig: all of it, lying and upright, and details where they are much larger.

    Parameters
    ----------
    view
        The rig.
    """
    whole, upright = _whole(view), _whole(view, upright=True)
    title = "Seen along Y, to scale"
    drawings = [
        _drawing(view, whole, _on_whole(view, whole), title, "wide"),
        _drawing(view, upright, _on_upright(view, upright), title, "narrow"),
    ]
    for frame, on, what in ((_at_stage(view), _on_stage, "The stage"), (_at_object(view), _on_object, "At the object")):
        if frame is not None and frame.scale >= _ENLARGED * whole.scale:
            drawings.append(_drawing(view, frame, on(view, frame), f"{what}, enlarged", "all"))
    return drawings


def words_of(view: SideView) -> str:
    """Say in words what the drawings show."""
    near, middle, far = view.seen_mm
    width, height = view.field_mm(middle)
    count = len(view.cameras_mm)
    told = [
        f"{count} camera positions over {length(view.travel_mm)} mm along X" if count > 1 else "one camera position",
        f"objects seen {_between(near, far)}",
        f"field of view {length(width)} x {length(height)} mm at {length(middle)} mm"
        + (f", of which all positions see {length(view.common_mm(middle))} mm of the width" if count > 1 else ""),
    ]
    if view.rows > 1:
        told.insert(1, f"{view.rows} such rows in Y")
    if view.sharp is not None:
        told.append(_sharp_words(view))
    return "; ".join(told) + "."


def _between(near: float, far: float, digits: int = 3) -> str:
    ends = length(near, digits), length(far, digits)
    return f"from {ends[0]} to {ends[1]} mm" if ends[0] != ends[1] else f"at {ends[0]} mm"


def _sharp_words(view: SideView) -> str:
    assert view.sharp is not None
    limits = view.sharp.near_mm, view.sharp.far_mm
    return f"blur under {length(view.sharp.limit_px)} px from {length(limits[0])} to {length(limits[1])} mm"


def _whole(view: SideView, *, upright: bool = False) -> Frame:
    _, _, far = view.seen_mm
    last = 1.06 * far
    if view.sharp is not None and view.sharp.far_mm < 1.4 * far:
        last = max(last, 1.03 * view.sharp.far_mm)
    lowest = min(view.cameras_mm) + min(view.left, 0.0) * last
    highest = max(view.cameras_mm) + max(view.right, 0.0) * last
    spare = 0.03 * (highest - lowest)
    x = (lowest - spare, highest + spare)
    if upright:
        scale = min(_UPRIGHT_ROOM[0] / (x[1] - x[0]), _UPRIGHT_ROOM[1] / last)
        # Narrow rigs stand in the middle.
        spare = (_UPRIGHT_ROOM[0] - scale * (x[1] - x[0])) / 2
        return Frame("upright", (0.0, last), x, scale, 84.0 + spare, 96.0 + spare, 58.0, 96.0, upright=True)
    scale = min(_ROOM[0] / last, _ROOM[1] / (x[1] - x[0]))
    return Frame("whole", (0.0, last), x, scale, left=130.0, right=120.0, top=46.0, bottom=80.0)


def _at_stage(view: SideView) -> Frame | None:
    if view.travel_mm == 0:
        return None
    scale = _DETAIL_ROOM[1] / view.travel_mm
    spare = 26.0 / scale
    x = (min(view.cameras_mm) - spare, max(view.cameras_mm) + spare)
    return Frame("stage", (0.0, 180.0 / scale), x, scale, left=190.0, right=10.0, top=14.0, bottom=46.0)


def _at_object(view: SideView) -> Frame | None:
    near, _, far = view.seen_mm
    width, _ = view.field_mm(far)
    around = max(far - near, 0.35 * width)
    z0, z1 = max(near - 0.6 * around, 0.0), far + 0.6 * around
    if view.sharp is not None:
        # Limits of sharpness that are not far are shown.
        reach = 1.5 * around
        z0 = min(z0, view.sharp.near_mm - 0.1 * around) if view.sharp.near_mm > near - reach else z0
        z1 = max(z1, view.sharp.far_mm + 0.1 * around) if view.sharp.far_mm < far + reach else z1
    x = (view.left * far - 0.04 * width, view.right * far + 0.04 * width)
    scale = min(_DETAIL_ROOM[0] / (z1 - z0), _DETAIL_ROOM[1] / (x[1] - x[0]))
    return Frame("object", (z0, z1), x, scale, left=24.0, right=120.0, top=46.0, bottom=72.0)


def _drawing(view: SideView, frame: Frame, on: Sequence[str], title: str, shown: str) -> Drawing:
    width, height = frame.size
    left, right, top, bottom = frame.sides
    clip = f"clip-{frame.name}"
    svg = "".join(
        [
            f'<svg id="drawing-{frame.name}" viewBox="0 0 {width:.1f} {height:.1f}" role="img" ',
            f'aria-label="{escape(f"{title}. {words_of(view)}")}"><defs><clipPath id="{clip}">',
            area([(left, top), (right, top), (right, bottom), (left, bottom)], ""),
            f'</clipPath></defs><g clip-path="url(#{clip})">',
            *scenery_in(view, frame),
            "</g>",
            *on,
            *cameras_on(view, frame),
            "</svg>",
        ]
    )
    return Drawing(frame.name, title, svg, width, shown)


def _on_whole(view: SideView, frame: Frame) -> list[str]:
    left, right, _, bottom = frame.sides
    near, within = view.seen_mm[0], (8.0, frame.size[0] - 8.0)
    drawn = [*_sharp_limits(view, frame), *_field_size(view, frame)]
    drawn += [line((left, frame.beside(0.0)), (left, bottom + 26), "thin")]
    drawn += [line((frame.along(near), bottom - 8), (frame.along(near), bottom + 26), "thin")]
    told = f"{length(near)} mm to the nearest point that is seen"
    drawn.append(across(left, frame.along(near), bottom + 21, told, within))
    if view.travel_mm > 0:
        v0, v1 = (frame.beside(each(view.cameras_mm)) for each in (min, max))
        drawn += [line((left - 42, v), (left - CAMERA - 4, v), "thin") for v in (v0, v1)]
        told_at_left = [f"{length(view.travel_mm)} mm", f"{len(view.cameras_mm)} positions"]
        drawn.append(down(left - 38, v0, v1, told_at_left, (0, frame.size[1]), right=False))
    drawn.append(_bar(frame, (left, bottom + 60)))
    return [*drawn, *_directions((right - 40, bottom + 44), "Z", "X")]


def _on_upright(view: SideView, frame: Frame) -> list[str]:
    left, right, top, bottom = frame.sides
    near, middle, _ = view.seen_mm
    width, height = frame.size
    within = (4.0, width - 4.0)
    u0, u1 = (frame.beside(slope * middle) for slope in (view.left, view.right))
    drawn = [line((u, frame.along(middle)), (u, top - 8), "thin") for u in (u0, u1)]
    told = f"{length(view.field_mm(middle)[0])} mm wide at {length(middle)} mm"
    if view.travel_mm > 0:
        drawn.append(words((width / 2, top - 30), f"{told},"))
        told = f"{length(view.common_mm(middle))} mm of it seen by all positions"
    drawn.append(across(u0, u1, top - 4, told, within))
    if view.travel_mm > 0:
        v = bottom + CAMERA + 16
        ends = [frame.beside(each(view.cameras_mm)) for each in (min, max)]
        drawn += [line((u, bottom + CAMERA + 5), (u, v + 4), "thin") for u in ends]
        told = f"{len(view.cameras_mm)} positions over {length(view.travel_mm)} mm"
        drawn.append(across(ends[0], ends[1], v, told, within, above=False))
    at_left = 66.0
    drawn += [line((frame.beside(0.0), bottom), (at_left - 4, bottom), "thin")]
    drawn += [line((left + 8, frame.along(near)), (at_left - 4, frame.along(near)), "thin")]
    told_at_left = [f"{length(near)} mm", "to the", "nearest", "point"]
    drawn.append(down(at_left, frame.along(near), bottom, told_at_left, (0, height), right=False))
    if view.sharp is not None and view.sharp.near_mm < frame.z_mm[1]:
        at_right = width - 92.0
        v0, v1 = (frame.along(min(max(z, 0.0), frame.z_mm[1])) for z in (view.sharp.far_mm, view.sharp.near_mm))
        drawn += [line((right - 8, v), (at_right + 4, v), "thin") for v in (v0, v1)]
        limits = view.sharp.near_mm, view.sharp.far_mm
        told_at_right = [
            "blur under",
            f"{length(view.sharp.limit_px)} px from",
            f"{length(limits[0])} to",
            f"{length(limits[1])} mm",
        ]
        drawn.append(down(at_right, v0, v1, told_at_right, (0, height), right=True))
    drawn.append(_bar(frame, (16.0, height - 14)))
    return [*drawn, *_directions((width - 60, height - 14), "X", "Z", up=True)]


def _on_stage(view: SideView, frame: Frame) -> list[str]:
    left, _, _, bottom = frame.sides
    apart = frame.scale * view.travel_mm / (len(view.cameras_mm) - 1)
    every = max(math.ceil(len(view.cameras_mm) / _MOST_NAMED), math.ceil(_LEAST_APART / apart))
    drawn = []
    for place, x in enumerate(view.cameras_mm):
        s = place - view.reference
        if s % every == 0:
            told = f"s = {s}: X = {length(x)} mm".replace("-", "−")
            drawn.append(words((left - CAMERA - 10, frame.beside(x) + 4.5), told, "end"))
    return [*drawn, _bar(frame, (left, bottom + 24))]


def _on_object(view: SideView, frame: Frame) -> list[str]:
    left, _, _, bottom = frame.sides
    near, _, far = view.seen_mm
    drawn = [*_sharp_limits(view, frame), *_field_size(view, frame)]
    drawn += [line((frame.along(z), bottom - 8), (frame.along(z), bottom + 20), "thin") for z in (near, far)]
    deep = f"{length(far - near)} mm deep, " if far - near > 1e-6 * far else ""
    told = f"{deep}seen {_between(near, far, 4)}"
    drawn.append(across(frame.along(near), frame.along(far), bottom + 15, told, (6, frame.size[0] - 6), above=False))
    return [*drawn, _bar(frame, (left, bottom + 58))]


def _sharp_limits(view: SideView, frame: Frame) -> list[str]:
    """Draw between which depths it is sharp, above."""
    if view.sharp is None:
        return []
    top, (first, last) = frame.sides[2], frame.z_mm
    near, far = view.sharp.near_mm, view.sharp.far_mm
    if near >= last or far <= first:
        return []
    drawn = [
        line((frame.along(z), top - 14), (frame.along(z), top + 8), "thin") for z in (near, far) if frame.inside(z)
    ]
    ends = (frame.along(max(near, first)), frame.along(min(far, last)))
    return [*drawn, across(*ends, top - 10, _sharp_words(view), (8, frame.size[0] - 8))]


def _field_size(view: SideView, frame: Frame) -> list[str]:
    """Draw how wide the field of the reference camera is where it counts, on the right."""
    z = view.seen_mm[1]
    beside = frame.sides[1] + 12
    v0, v1 = (frame.beside(slope * z) for slope in (view.left, view.right))
    lines = [f"{length(view.field_mm(z)[0])} mm wide", f"at {length(z)} mm"]
    if view.travel_mm > 0:
        lines += [f"{length(view.common_mm(z))} mm seen", "by all positions"]
    thin = [line((frame.along(z), v), (beside + 5, v), "thin") for v in (v0, v1)]
    return [*thin, down(beside, v0, v1, lines, (0, frame.size[1]), right=True)]


def _bar(frame: Frame, start: Place) -> str:
    long_mm = round_length_mm(_BAR / frame.scale)
    return scale_bar(start, frame.scale * long_mm, f"{length(long_mm)} mm")


def _directions(place: Place, right: str, other: str, *, up: bool = False) -> list[str]:
    """Draw which axis goes to the right, and which one down or up."""
    u, v = place
    way = -1 if up else 1
    return [
        line(place, (u + 18, v), "size"),
        line(place, (u, v + 18 * way), "size"),
        area([(u + 24, v), (u + 17, v - 3), (u + 17, v + 3)], "head"),
        area([(u, v + 24 * way), (u - 3, v + 17 * way), (u + 3, v + 17 * way)], "head"),
        words((u + 28, v + 4.5), right, "start"),
        words((u + 7, v + 24 * way + 2), other, "start"),
    ]
