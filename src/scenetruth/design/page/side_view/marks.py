"""Lines, areas, words and dimensions of a drawing, as elements of SVG."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from scenetruth.design.page.side_view.frame import Place

__all__ = ["across", "area", "down", "line", "scale_bar", "words"]

_ARROW, _LETTER, _LINE = 6.0, 7.0, 16.0
"""Length of an arrow's head, about the width of a letter, and the distance of two lines of words."""


def line(start: Place, end: Place, kind: str) -> str:
    """Return a line of a class."""
    return f'<line class="{kind}" x1="{start[0]:.2f}" y1="{start[1]:.2f}" x2="{end[0]:.2f}" y2="{end[1]:.2f}"/>'


def area(corners: Iterable[Place], kind: str, *, colour: str = "") -> str:
    """Return an area of a class, or of a colour, with its border."""
    drawn = "L".join(f"{u:.2f},{v:.2f}" for u, v in corners)
    style = f' style="stroke:{colour};fill:{colour}"' if colour else ""
    return f'<path class="{kind}"{style} d="M{drawn}Z"/>'


def words(place: Place, text: str, anchor: str = "middle") -> str:
    """Return words, anchored at their start, middle or end."""
    return f'<text x="{place[0]:.2f}" y="{place[1]:.2f}" text-anchor="{anchor}">{escape(text)}</text>'


def across(u0: float, u1: float, v: float, text: str, within: tuple[float, float], *, above: bool = True) -> str:
    """Return a dimension from left to right, with its words above or below.

    Parameters
    ----------
    u0, u1, v
        Where it is.
    text
        What it says.
    within
        Between what its words must stay.
    above
        Whether they stand above the line.
    """
    half = _LETTER * len(text) / 2
    middle = max(min((u0 + u1) / 2, within[1] - half), within[0] + half)
    return _arrows((u0, v), (u1, v)) + words((middle, v - 9 if above else v + 18), text)


def down(u: float, v0: float, v1: float, lines: Sequence[str], within: tuple[float, float], *, right: bool) -> str:
    """Return a dimension from top to bottom, with words beside it.

    Parameters
    ----------
    u, v0, v1
        Where it is.
    lines
        What it says, line by line.
    within
        Between what its words must stay.
    right
        Whether they stand on its right.
    """
    high = _LINE * (len(lines) - 1)
    first = max(min((v0 + v1 - high) / 2 + 4.5, within[1] - high - 4), within[0] + 12)
    beside, anchor = (u + 9, "start") if right else (u - 9, "end")
    told = [words((beside, first + _LINE * place), text, anchor) for place, text in enumerate(lines)]
    return _arrows((u, v0), (u, v1)) + "".join(told)


def scale_bar(start: Place, length: float, text: str) -> str:
    """Return a bar to the right that is as long as its words say."""
    u, v = start
    ends = "".join(line((each, v - 5), (each, v + 5), "bar") for each in (u, u + length))
    return line(start, (u + length, v), "bar") + ends + words((u + length + 8, v + 4.5), text, "start")


def _arrows(start: Place, end: Place) -> str:
    """Return a line with a head at both ends; they point from outside where there is no room between."""
    (u0, v0), (u1, v1) = start, end
    length = max(abs(u1 - u0), abs(v1 - v0))
    if length == 0:
        return ""
    along = ((u1 - u0) / length, (v1 - v0) / length)
    outside = length < 3 * _ARROW
    parts = [line(start, end, "size")]
    for (u, v), sign in ((start, 1.0), (end, -1.0)):
        way = (-sign if outside else sign) * _ARROW
        back = (u + way * along[0], v + way * along[1])
        wide = (-0.4 * _ARROW * along[1], 0.4 * _ARROW * along[0])
        parts.append(
            area([(u, v), (back[0] + wide[0], back[1] + wide[1]), (back[0] - wide[0], back[1] - wide[1])], "head")
        )
        if outside:
            parts.append(line((u, v), (u + 2 * way * along[0], v + 2 * way * along[1]), "size"))
    return "".join(parts)
