"""Scale drawings of a rig seen along Y, as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from scenetruth.design.optimisation.report.side_view_geometry import SideView
from scenetruth.html import COLOURS
from scenetruth.number_format import format_length

__all__ = [
    "SideViewDrawing",
    "Viewport",
    "assign_colours",
    "choose_round_length_mm",
    "describe_side_view",
    "draw_side_views",
]


PaperPoint = tuple[float, float]
"""A position in the drawing: right and down."""


@dataclass(frozen=True)
class Viewport:
    """A viewport of the side view with equal scales along both axes."""

    name: str  # identifier within the page
    z_mm: tuple[float, float]  # displayed range
    x_mm: tuple[float, float]  # displayed range
    scale: float  # units of the drawing per mm
    left: float  # margins for dimensions, in units of the drawing
    right: float
    top: float
    bottom: float
    upright: bool = False  # Z up and X right; otherwise Z right and X down: both are views along Y

    @property
    def sides(self) -> tuple[float, float, float, float]:
        """Left, right, upper and lower end of the viewport in the drawing."""
        z, x = ((each[1] - each[0]) * self.scale for each in (self.z_mm, self.x_mm))
        wide, high = (x, z) if self.upright else (z, x)
        return self.left, self.left + wide, self.top, self.top + high

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the drawing with margins."""
        _, right, _, bottom = self.sides
        return right + self.right, bottom + self.bottom

    def at(self, z_mm: float, x_mm: float, *, ahead: float = 0.0, aside: float = 0.0) -> PaperPoint:
        """Return the position of a point, with offsets along Z and X in units of the drawing."""
        z = (z_mm - self.z_mm[0]) * self.scale + ahead
        x = (x_mm - self.x_mm[0]) * self.scale + aside
        return (self.left + x, self.sides[3] - z) if self.upright else (self.left + z, self.top + x)

    def along(self, z_mm: float) -> float:
        """Return the coordinate of a depth along the direction of Z."""
        return self.at(z_mm, self.x_mm[0])[1 if self.upright else 0]

    def beside(self, x_mm: float) -> float:
        """Return the coordinate of an X along the direction of X."""
        return self.at(self.z_mm[0], x_mm)[0 if self.upright else 1]

    def placed(self, points: Iterable[tuple[float, float]]) -> list[PaperPoint]:
        """Return the positions of points (Z, X)."""
        return [self.at(z, x) for z, x in points]

    def inside(self, z_mm: float) -> bool:
        """Return whether a depth is in the displayed range."""
        return self.z_mm[0] <= z_mm <= self.z_mm[1]


def choose_round_length_mm(most_mm: float) -> float:
    """Return the largest round length (1, 2 or 5 times a power of ten, in mm) that does not exceed a length.

    >>> choose_round_length_mm(137.0), choose_round_length_mm(0.3), choose_round_length_mm(5.0)
    (100.0, 0.2, 5.0)
    """
    power = 10.0 ** math.floor(math.log10(most_mm))
    # Rounding may put a length such as 0.05 on either side of a power of ten.
    return next(factor * power for factor in (5.0, 2.0, 1.0, 0.5) if factor * power <= most_mm * (1 + 1e-9))


_ARROW, _LETTER, _LINE = 6.0, 7.0, 16.0  # length of an arrow head, approximate width of a letter, and line spacing


def svg_line(start: PaperPoint, end: PaperPoint, kind: str) -> str:
    """Return a line of a CSS class."""
    return f'<line class="{kind}" x1="{start[0]:.2f}" y1="{start[1]:.2f}" x2="{end[0]:.2f}" y2="{end[1]:.2f}"/>'


def svg_area(corners: Iterable[PaperPoint], kind: str, *, colour: str = "") -> str:
    """Return a polygon of a CSS class, optionally with a colour."""
    drawn = "L".join(f"{u:.2f},{v:.2f}" for u, v in corners)
    style = f' style="stroke:{colour};fill:{colour}"' if colour else ""
    return f'<path class="{kind}"{style} d="M{drawn}Z"/>'


def svg_text(place: PaperPoint, text: str, anchor: str = "middle") -> str:
    """Return a text, anchored at its start, middle or end."""
    return f'<text x="{place[0]:.2f}" y="{place[1]:.2f}" text-anchor="{anchor}">{escape(text)}</text>'


def svg_horizontal_dimension(
    u0: float, u1: float, v: float, text: str, within: tuple[float, float], *, above: bool = True
) -> str:
    """Return a horizontal dimension with its text above or below."""
    half = _LETTER * len(text) / 2
    middle = max(min((u0 + u1) / 2, within[1] - half), within[0] + half)
    return _arrows((u0, v), (u1, v)) + svg_text((middle, v - 9 if above else v + 18), text)


def svg_vertical_dimension(
    u: float, v0: float, v1: float, lines: Sequence[str], within: tuple[float, float], *, right: bool
) -> str:
    """Return a vertical dimension with its text to the right or left."""
    high = _LINE * (len(lines) - 1)
    first = max(min((v0 + v1 - high) / 2 + 4.5, within[1] - high - 4), within[0] + 12)
    beside, anchor = (u + 9, "start") if right else (u - 9, "end")
    values = [svg_text((beside, first + _LINE * place), text, anchor) for place, text in enumerate(lines)]
    return _arrows((u, v0), (u, v1)) + "".join(values)


def svg_scale_bar(start: PaperPoint, length: float, text: str) -> str:
    """Return a scale bar with its text."""
    u, v = start
    ends = "".join(svg_line((each, v - 5), (each, v + 5), "bar") for each in (u, u + length))
    return svg_line(start, (u + length, v), "bar") + ends + svg_text((u + length + 8, v + 4.5), text, "start")


def _arrows(start: PaperPoint, end: PaperPoint) -> str:
    """Return a line with arrow heads at both ends; the heads of short lines are outside."""
    (u0, v0), (u1, v1) = start, end
    length = max(abs(u1 - u0), abs(v1 - v0))
    if length == 0:
        return ""
    along = ((u1 - u0) / length, (v1 - v0) / length)
    outside = length < 3 * _ARROW
    parts = [svg_line(start, end, "size")]
    for (u, v), sign in ((start, 1.0), (end, -1.0)):
        way = (-sign if outside else sign) * _ARROW
        back = (u + way * along[0], v + way * along[1])
        wide = (-0.4 * _ARROW * along[1], 0.4 * _ARROW * along[0])
        parts.append(
            svg_area([(u, v), (back[0] + wide[0], back[1] + wide[1]), (back[0] - wide[0], back[1] - wide[1])], "head")
        )
        if outside:
            parts.append(svg_line((u, v), (u + 2 * way * along[0], v + 2 * way * along[1]), "size"))
    return "".join(parts)


CAMERA_LENGTH = 16.0
"""Length of a camera symbol in the drawing."""
_LEAST = 2.0  # half of the smallest width of a camera symbol
_OF_OBJECTS = tuple(colour for number, colour in enumerate(COLOURS) if number not in (0, 2, 4))
"""Colours of objects: blue is reserved for the field of view, green for the depth of field."""


def assign_colours(view: SideView) -> list[str]:
    """Return the colour of each outline; a single colour if there are more outlines than colours."""
    count = len(view.outlines)
    return list(_OF_OBJECTS[:count]) if count <= len(_OF_OBJECTS) else [_OF_OBJECTS[0]] * count


def draw_scene(view: SideView, frame: Viewport) -> list[str]:
    """Return the drawing of the fields of view, the depth of field and the objects."""
    last, (x0, x1) = frame.z_mm[1], frame.x_mm
    low, high = min(view.cameras_mm), max(view.cameras_mm)
    drawn = []
    if view.sharp is not None:
        near, far = view.sharp.near_mm, min(view.sharp.far_mm, last)
        drawn.append(svg_area(frame.placed([(near, x0), (far, x0), (far, x1), (near, x1)]), "sharp"))
    field = [(0.0, 0.0), (last, view.left * last), (last, view.right * last)]
    drawn.append(svg_area(frame.placed(field), "field"))
    start = view.common_from_mm
    if start < last:
        begin = high + view.left * start
        common = [(start, begin), (last, high + view.left * last), (last, low + view.right * last)]
        drawn.append(svg_area(frame.placed(common), "common"))
    if view.travel_mm > 0:
        drawn += [
            svg_line(frame.at(0.0, camera), frame.at(last, camera + slope * last), "border")
            for camera in (low, high)
            for slope in (view.left, view.right)
        ]
    drawn.append(svg_line(frame.at(0.0, 0.0), frame.at(last, 0.0), "axis"))
    if view.sharp is not None:
        drawn.append(svg_line(frame.at(view.sharp.focus_mm, x0), frame.at(view.sharp.focus_mm, x1), "focus"))
    for outline, colour in zip(view.outlines, assign_colours(view), strict=True):
        there = zip(outline.near_mm, outline.x_mm, strict=True)
        back = zip(outline.far_mm[::-1], outline.x_mm[::-1], strict=True)
        drawn.append(svg_area(frame.placed([*there, *back]), "outline", colour=colour))
    return drawn


def draw_cameras(view: SideView, frame: Viewport) -> list[str]:
    """Return the camera symbols on the stage; their tips are the projection centres, to scale."""
    if not frame.inside(0.0):
        return []
    # Symbols of adjacent cameras do not overlap if possible.
    apart = frame.scale * view.travel_mm / (len(view.cameras_mm) - 1) if view.travel_mm > 0 else CAMERA_LENGTH
    half = min(max(0.45 * apart, _LEAST), 0.45 * CAMERA_LENGTH)
    first = frame.at(0.0, min(view.cameras_mm), ahead=-CAMERA_LENGTH - 3, aside=-12.0)
    last = frame.at(0.0, max(view.cameras_mm), ahead=-CAMERA_LENGTH - 3, aside=12.0)
    drawn = [svg_line(first, last, "rail")]
    for place, x in enumerate(view.cameras_mm):
        behind = [frame.at(0.0, x, ahead=-CAMERA_LENGTH, aside=sign * half) for sign in (-1, 1)]
        kind = "camera reference" if place == view.reference else "camera"
        drawn.append(svg_area([frame.at(0.0, x), *behind], kind))
    return drawn


_EXTENT, _UPRIGHT_EXTENT, _DETAIL_EXTENT = (860.0, 400.0), (150.0, 560.0), (300.0, 260.0)
"""Largest width and height of the drawings without margins."""
_ENLARGED = 1.6  # smallest magnification of a detail
_MOST_NAMED, _LEAST_APART = 11, 16.0  # largest number of labelled camera positions, and their smallest distance
_BAR = 110.0  # largest length of a scale bar


@dataclass(frozen=True)
class SideViewDrawing:
    """A drawing for ``"wide"``, ``"narrow"`` or ``"all"`` screens, with the font size of the page at ``width`` px."""

    name: str
    title: str
    svg: str
    width: float
    shown: str


def draw_side_views(view: SideView) -> list[SideViewDrawing]:
    """Return the drawings of a rig: landscape and upright overview, and sufficiently enlarged details."""
    whole, upright = _draw_overview(view), _draw_overview(view, upright=True)
    title = "Seen along Y, to scale"
    drawings = [
        _drawing(view, whole, _on_whole(view, whole), title, "wide"),
        _drawing(view, upright, _on_upright(view, upright), title, "narrow"),
    ]
    for frame, on, what in (
        (_draw_stage_detail(view), _on_stage, "Stage"),
        (_draw_object_detail(view), _on_object, "Object"),
    ):
        if frame is not None and frame.scale >= _ENLARGED * whole.scale:
            drawings.append(_drawing(view, frame, on(view, frame), f"{what}, enlarged", "all"))
    return drawings


def describe_side_view(view: SideView) -> str:
    """Return a text description of the drawings."""
    near, middle, far = view.seen_mm
    width, height = view.field_mm(middle)
    count = len(view.cameras_mm)
    values = [
        f"{count} camera positions over {format_length(view.travel_mm)} mm along X"
        if count > 1
        else "one camera position",
        f"objects visible {_between(near, far)}",
        f"field of view {format_length(width)} x {format_length(height)} mm at {format_length(middle)} mm"
        + (
            f", of which all positions see {format_length(view.common_mm(middle))} mm of the width" if count > 1 else ""
        ),
    ]
    if view.rows > 1:
        values.insert(1, f"{view.rows} rows of positions in Y")
    if view.sharp is not None:
        values.append(_sharp_words(view))
    return "; ".join(values) + "."


def _between(near: float, far: float, digits: int = 3) -> str:
    ends = format_length(near, digits), format_length(far, digits)
    return f"from {ends[0]} to {ends[1]} mm" if ends[0] != ends[1] else f"at {ends[0]} mm"


def _sharp_words(view: SideView) -> str:
    assert view.sharp is not None
    limit, near, far = map(format_length, (view.sharp.limit_px, view.sharp.near_mm, view.sharp.far_mm))
    return f"blur under {limit} px from {near} to {far} mm"


def _draw_overview(view: SideView, *, upright: bool = False) -> Viewport:
    _, _, far = view.seen_mm
    last = 1.06 * far
    if view.sharp is not None and view.sharp.far_mm < 1.4 * far:
        last = max(last, 1.03 * view.sharp.far_mm)
    lowest = min(view.cameras_mm) + min(view.left, 0.0) * last
    highest = max(view.cameras_mm) + max(view.right, 0.0) * last
    spare = 0.03 * (highest - lowest)
    x = (lowest - spare, highest + spare)
    if upright:
        scale = min(_UPRIGHT_EXTENT[0] / (x[1] - x[0]), _UPRIGHT_EXTENT[1] / last)
        spare = (_UPRIGHT_EXTENT[0] - scale * (x[1] - x[0])) / 2  # narrow rigs are centred
        return Viewport("upright", (0.0, last), x, scale, 84.0 + spare, 96.0 + spare, 58.0, 96.0, upright=True)
    scale = min(_EXTENT[0] / last, _EXTENT[1] / (x[1] - x[0]))
    return Viewport("whole", (0.0, last), x, scale, left=130.0, right=120.0, top=46.0, bottom=80.0)


def _draw_stage_detail(view: SideView) -> Viewport | None:
    if view.travel_mm == 0:
        return None
    scale = _DETAIL_EXTENT[1] / view.travel_mm
    spare = 26.0 / scale
    x = (min(view.cameras_mm) - spare, max(view.cameras_mm) + spare)
    return Viewport("stage", (0.0, 180.0 / scale), x, scale, left=190.0, right=10.0, top=14.0, bottom=46.0)


def _draw_object_detail(view: SideView) -> Viewport | None:
    near, _, far = view.seen_mm
    width, _ = view.field_mm(far)
    around = max(far - near, 0.35 * width)
    z0, z1 = max(near - 0.6 * around, 0.0), far + 0.6 * around
    if view.sharp is not None:
        # Limits of the depth of field that are close are shown.
        reach = 1.5 * around
        z0 = min(z0, view.sharp.near_mm - 0.1 * around) if view.sharp.near_mm > near - reach else z0
        z1 = max(z1, view.sharp.far_mm + 0.1 * around) if view.sharp.far_mm < far + reach else z1
    x = (view.left * far - 0.04 * width, view.right * far + 0.04 * width)
    scale = min(_DETAIL_EXTENT[0] / (z1 - z0), _DETAIL_EXTENT[1] / (x[1] - x[0]))
    return Viewport("object", (z0, z1), x, scale, left=24.0, right=120.0, top=46.0, bottom=72.0)


def _drawing(view: SideView, frame: Viewport, on: Sequence[str], title: str, shown: str) -> SideViewDrawing:
    width, height = frame.size
    left, right, top, bottom = frame.sides
    clip = f"clip-{frame.name}"
    svg = "".join(
        [
            f'<svg id="drawing-{frame.name}" viewBox="0 0 {width:.1f} {height:.1f}" role="img" ',
            f'aria-label="{escape(f"{title}. {describe_side_view(view)}")}"><defs><clipPath id="{clip}">',
            svg_area([(left, top), (right, top), (right, bottom), (left, bottom)], ""),
            f'</clipPath></defs><g clip-path="url(#{clip})">',
            *draw_scene(view, frame),
            "</g>",
            *on,
            *draw_cameras(view, frame),
            "</svg>",
        ]
    )
    return SideViewDrawing(frame.name, title, svg, width, shown)


def _on_whole(view: SideView, frame: Viewport) -> list[str]:
    left, right, _, bottom = frame.sides
    near, within = view.seen_mm[0], (8.0, frame.size[0] - 8.0)
    drawn = [*_sharp_limits(view, frame), *_field_size(view, frame)]
    drawn += [svg_line((left, frame.beside(0.0)), (left, bottom + 26), "thin")]
    drawn += [svg_line((frame.along(near), bottom - 8), (frame.along(near), bottom + 26), "thin")]
    line = f"{format_length(near)} mm to the nearest visible point"
    drawn.append(svg_horizontal_dimension(left, frame.along(near), bottom + 21, line, within))
    if view.travel_mm > 0:
        v0, v1 = (frame.beside(each(view.cameras_mm)) for each in (min, max))
        drawn += [svg_line((left - 42, v), (left - CAMERA_LENGTH - 4, v), "thin") for v in (v0, v1)]
        left_lines = [f"{format_length(view.travel_mm)} mm", f"{len(view.cameras_mm)} positions"]
        drawn.append(svg_vertical_dimension(left - 38, v0, v1, left_lines, (0, frame.size[1]), right=False))
    drawn.append(_bar(frame, (left, bottom + 60)))
    return [*drawn, *_directions((right - 40, bottom + 44), "Z", "X")]


def _on_upright(view: SideView, frame: Viewport) -> list[str]:
    left, right, top, bottom = frame.sides
    near, middle, _ = view.seen_mm
    width, height = frame.size
    within = (4.0, width - 4.0)
    u0, u1 = (frame.beside(slope * middle) for slope in (view.left, view.right))
    drawn = [svg_line((u, frame.along(middle)), (u, top - 8), "thin") for u in (u0, u1)]
    line = f"{format_length(view.field_mm(middle)[0])} mm wide at {format_length(middle)} mm"
    if view.travel_mm > 0:
        drawn.append(svg_text((width / 2, top - 30), f"{line},"))
        line = f"{format_length(view.common_mm(middle))} mm of it seen by all positions"
    drawn.append(svg_horizontal_dimension(u0, u1, top - 4, line, within))
    if view.travel_mm > 0:
        v = bottom + CAMERA_LENGTH + 16
        ends = [frame.beside(each(view.cameras_mm)) for each in (min, max)]
        drawn += [svg_line((u, bottom + CAMERA_LENGTH + 5), (u, v + 4), "thin") for u in ends]
        line = f"{len(view.cameras_mm)} positions over {format_length(view.travel_mm)} mm"
        drawn.append(svg_horizontal_dimension(ends[0], ends[1], v, line, within, above=False))
    at_left = 66.0
    drawn += [svg_line((frame.beside(0.0), bottom), (at_left - 4, bottom), "thin")]
    drawn += [svg_line((left + 8, frame.along(near)), (at_left - 4, frame.along(near)), "thin")]
    left_lines = [f"{format_length(near)} mm", "to the", "nearest", "point"]
    drawn.append(svg_vertical_dimension(at_left, frame.along(near), bottom, left_lines, (0, height), right=False))
    if view.sharp is not None and view.sharp.near_mm < frame.z_mm[1]:
        at_right = width - 92.0
        v0, v1 = (frame.along(min(max(z, 0.0), frame.z_mm[1])) for z in (view.sharp.far_mm, view.sharp.near_mm))
        drawn += [svg_line((right - 8, v), (at_right + 4, v), "thin") for v in (v0, v1)]
        limits = view.sharp.near_mm, view.sharp.far_mm
        right_lines = [
            "blur under",
            f"{format_length(view.sharp.limit_px)} px from",
            f"{format_length(limits[0])} to",
            f"{format_length(limits[1])} mm",
        ]
        drawn.append(svg_vertical_dimension(at_right, v0, v1, right_lines, (0, height), right=True))
    drawn.append(_bar(frame, (16.0, height - 14)))
    return [*drawn, *_directions((width - 60, height - 14), "X", "Z", up=True)]


def _on_stage(view: SideView, frame: Viewport) -> list[str]:
    left, _, _, bottom = frame.sides
    apart = frame.scale * view.travel_mm / (len(view.cameras_mm) - 1)
    every = max(math.ceil(len(view.cameras_mm) / _MOST_NAMED), math.ceil(_LEAST_APART / apart))
    drawn = []
    for place, x in enumerate(view.cameras_mm):
        s = place - view.reference
        if s % every == 0:
            line = f"s = {s}: X = {format_length(x)} mm".replace("-", "−")
            drawn.append(svg_text((left - CAMERA_LENGTH - 10, frame.beside(x) + 4.5), line, "end"))
    return [*drawn, _bar(frame, (left, bottom + 24))]


def _on_object(view: SideView, frame: Viewport) -> list[str]:
    left, _, _, bottom = frame.sides
    near, _, far = view.seen_mm
    drawn = [*_sharp_limits(view, frame), *_field_size(view, frame)]
    drawn += [svg_line((frame.along(z), bottom - 8), (frame.along(z), bottom + 20), "thin") for z in (near, far)]
    deep = f"{format_length(far - near)} mm deep, " if far - near > 1e-6 * far else ""
    line = f"{deep}visible {_between(near, far, 4)}"
    drawn.append(
        svg_horizontal_dimension(
            frame.along(near), frame.along(far), bottom + 15, line, (6, frame.size[0] - 6), above=False
        )
    )
    return [*drawn, _bar(frame, (left, bottom + 58))]


def _sharp_limits(view: SideView, frame: Viewport) -> list[str]:
    """Return the dimension of the depth of field, above the viewport."""
    if view.sharp is None:
        return []
    top, (first, last) = frame.sides[2], frame.z_mm
    near, far = view.sharp.near_mm, view.sharp.far_mm
    if near >= last or far <= first:
        return []
    drawn = [
        svg_line((frame.along(z), top - 14), (frame.along(z), top + 8), "thin") for z in (near, far) if frame.inside(z)
    ]
    ends = (frame.along(max(near, first)), frame.along(min(far, last)))
    return [*drawn, svg_horizontal_dimension(*ends, top - 10, _sharp_words(view), (8, frame.size[0] - 8))]


def _field_size(view: SideView, frame: Viewport) -> list[str]:
    """Return the dimension of the reference camera's field of view at the median depth, on the right."""
    z = view.seen_mm[1]
    beside = frame.sides[1] + 12
    v0, v1 = (frame.beside(slope * z) for slope in (view.left, view.right))
    lines = [f"{format_length(view.field_mm(z)[0])} mm wide", f"at {format_length(z)} mm"]
    if view.travel_mm > 0:
        lines += [f"{format_length(view.common_mm(z))} mm seen", "by all positions"]
    thin = [svg_line((frame.along(z), v), (beside + 5, v), "thin") for v in (v0, v1)]
    return [*thin, svg_vertical_dimension(beside, v0, v1, lines, (0, frame.size[1]), right=True)]


def _bar(frame: Viewport, start: PaperPoint) -> str:
    long_mm = choose_round_length_mm(_BAR / frame.scale)
    return svg_scale_bar(start, frame.scale * long_mm, f"{format_length(long_mm)} mm")


def _directions(place: PaperPoint, right: str, other: str, *, up: bool = False) -> list[str]:
    """Return the arrows of the axes: one to the right, the other down or up."""
    u, v = place
    way = -1 if up else 1
    return [
        svg_line(place, (u + 18, v), "size"),
        svg_line(place, (u, v + 18 * way), "size"),
        svg_area([(u + 24, v), (u + 17, v - 3), (u + 17, v + 3)], "head"),
        svg_area([(u, v + 24 * way), (u - 3, v + 17 * way), (u + 3, v + 17 * way)], "head"),
        svg_text((u + 28, v + 4.5), right, "start"),
        svg_text((u + 7, v + 24 * way + 2), other, "start"),
    ]
