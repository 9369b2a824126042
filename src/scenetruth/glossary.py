"""Definitions of terms in HTML pages: the glossary of the documentation is their only source."""

from __future__ import annotations

import html
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

__all__ = ["Definition", "define_terms", "glossary_file", "read_glossary"]


@dataclass(frozen=True)
class Definition:
    """A term of the glossary: its name, its definition, and its symbol and unit, if any."""

    term: str
    text: str
    unit: str = ""

    @property
    def key(self) -> str:
        """The identifier of the definition in a page."""
        return re.sub(r"\W+", "-", self.term.casefold()).strip("-")


def glossary_file() -> Path | None:
    """Return the glossary: inside an installed package, or in ``docs/`` of a checkout."""
    from importlib.resources import files

    package = Path(str(files("scenetruth")))
    found = (package / "shipped" / "glossary.md", package.parents[1] / "docs" / "reference" / "glossary.md")
    return next((file for file in found if file.is_file()), None)


_EVERYDAY = {
    *("all", "band", "capture", "card", "channel", "factor", "level", "option", "settings", "step", "store", "tint"),
    *("valid", "invalid", "visit", "contribution"),
}
"""Names of the glossary that sentences also use in another sense; they are not marked."""
_SPELLINGS = {
    "median |e|": "median absolute error",
    "median abs error": "median absolute error",
    "95 % |e|": "95th percentile",
    "p95 abs error": "95th percentile",
    "rms of z": "normalised error",
    "rms z": "normalised error",
    "within 2 std": "coverage",
    "stated std": "standard uncertainty",
    "stated standard deviation": "standard uncertainty",
    "noise std": "precision",
    "velocity endpoint": "endpoint error",
    "inlier rate": "bad-pixel rate",
    "cut-off period": "spatial resolution",
    "cutoff period": "spatial resolution",
    "period at 10 % loss": "spatial resolution",
    "nonoccluded": "non-occluded",
    "scene flow outliers": "outlier rate",
    "relative margin": "constraint",
}
"""Other spellings in pages, and the names under which the glossary defines them."""
_ROW = re.compile(r"^\| (?P<names>[^|]+) \| (?P<text>[^|]+) \| (?P<unit>[^|]+) \|", re.MULTILINE)


@cache
def read_glossary() -> dict[str, Definition]:
    """Return the definitions by spelling, in small letters; empty if no glossary is installed.

    >>> found = read_glossary()
    >>> found["rmse"].text, found["z-score"] is found["rms of z"]
    ('Root mean square error; contains bias and scatter.', True)
    """
    file = glossary_file()
    if file is None:
        return {}
    found: dict[str, Definition] = {}
    for row in _ROW.finditer(file.read_text(encoding="utf-8")):
        names = [name.strip().casefold() for name in re.split(r" / |, | \(|\)", row["names"]) if name.strip()]
        if names[0] in ("term", ":") or set(row["names"]) <= set("-:"):
            continue
        unit = row["unit"].strip()
        text = row["text"].strip().replace("`", "")
        unit = "" if unit in ("–", "1") else unit.replace("`", "")
        several, parts = row["names"].strip().split(", "), text.removesuffix(".").split("; ")
        if len(several) == len(parts) > 1:
            # Several terms with a definition each.
            each = [
                Definition(name, f"{part[0].upper()}{part[1:]}.") for name, part in zip(several, parts, strict=True)
            ]
        else:
            each = [Definition(row["names"].strip(), text, unit)] * len(names)
        found |= {name: one for name, one in zip(names, each, strict=True) if name not in _EVERYDAY}
    return found | {name: found[of] for name, of in _SPELLINGS.items() if of in found}


@cache
def _pattern() -> re.Pattern[str]:
    names = sorted(read_glossary(), key=len, reverse=True)
    # Identifiers spell spaces as underscores.
    spelled = "|".join(re.escape(name).replace(r"\ ", r"[\s_ ]") for name in names)
    return re.compile(rf"(?<![\w.\-/])(?:{spelled})s?(?![\w\-/]|\.\w)|(?P<quantity>{_QUANTITY})", re.IGNORECASE)


_QUANTITY = (
    r"(?<![\w.])[-−+±]?[0-9][0-9.,\u202f]*(?: × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?[ \u00a0]"
    r"(?:%(?:/h)?|°|1/[a-z]+|(?:mm|µm|nm|m|px|DN|s|ms|µs|min|h|GB|MB|kB|GiB|MiB|rad|mrad|µrad|deg)(?:²|³)?(?:/[a-z]+²?)?)(?![\w/])"
)
"""A number with its unit, between which no line breaks."""


def _look_up(spelled: str) -> Definition:
    found, name = read_glossary(), re.sub(r"[\s_]+", " ", html.unescape(spelled)).casefold()
    return found[name] if name in found else found[name.removesuffix("s")]


_WHOLE = ("script", "style", "pre", "code", "svg", "title", "select", "a", "h1", "noscript", "button", "textarea")
"""Elements whose text is not marked."""
_FIXED = ("summary", "label", "h2", "h3", "legend", "option", "output", "td")
"""Elements whose terms have a definition under the pointer, but are no stop of the keyboard."""
_PIECES = re.compile(
    r"(?P<whole><!--.*?-->"
    + "".join(rf"|<{name}\b[^>]*>.*?</{name}>" for name in _WHOLE)
    + r")|(?P<tag><[^>]*>)|(?P<text>[^<]+)",
    re.DOTALL,
)
_HEADING = re.compile(r'<button type="button">(?P<text>[^<]*)</button>')
_TAG = re.compile(r"</?(?P<name>[a-z0-9]+)")


def define_terms(page: str) -> str:
    """Return a page whose terms have their definitions: under the pointer, and at the first use by the keyboard.

    >>> page = define_terms("<body><p>The RMSE is 2 mm.</p></body>")
    >>> 'data-term="rmse" tabindex="0" aria-describedby="term-rmse">RMSE</span>' in page
    True
    >>> '<p id="term-rmse"><b>RMSE</b>: Root mean square error' in page
    True
    """
    if not read_glossary() or "</body>" not in page:
        return page
    head, opened, body = page.partition("<body")
    marked = _Marking()
    text = "".join(map(marked.piece, _PIECES.finditer(opened + body)))
    return head + text.replace("</body>", f"{marked.definitions()}</body>", 1)


class _Marking:
    """Marks the terms of one page, piece by piece."""

    def __init__(self) -> None:
        self.used: dict[str, Definition] = {}
        self._near: set[str] = set()
        self._inside: list[str] = []

    def piece(self, found: re.Match[str]) -> str:
        if found["text"] is not None:
            return _pattern().sub(self._mark, found["text"]) if found["text"].strip() else found["text"]
        if found["tag"] is not None:
            self._follow(found["tag"])
            return found["tag"]
        heading = _HEADING.fullmatch(found["whole"]) if "th" in self._inside else None
        return found["whole"] if heading is None else self._heading(heading["text"])

    def _follow(self, tag: str) -> None:
        name = _TAG.match(tag)
        if name is None:
            return
        if name["name"] == "section":
            # Each section has its own first use.
            self._near.clear()
        if name["name"] in (*_FIXED, "th"):
            if not tag.startswith("</"):
                self._inside.append(name["name"])
            elif name["name"] in self._inside:
                self._inside.remove(name["name"])

    def _mark(self, found: re.Match[str]) -> str:
        if found["quantity"] is not None:
            whole = "td" in self._inside or "th" in self._inside
            return found[0] if whole else f'<span class="nowrap">{found[0]}</span>'
        one = _look_up(found[0])
        self.used[one.key] = one
        stop = ""
        if one.key not in self._near and not any(name in _FIXED for name in self._inside):
            self._near.add(one.key)
            stop = f' tabindex="0" aria-describedby="term-{one.key}"'
        return f'<span class="term" data-term="{one.key}"{stop}>{found[0]}</span>'

    def _heading(self, text: str) -> str:
        """Return the button that sorts a column, with the definition of the first term of its text."""
        found = next((one for one in _pattern().finditer(text) if one["quantity"] is None), None)
        if found is None:
            return f'<button type="button">{text}</button>'
        one = _look_up(found[0])
        self.used[one.key] = one
        return f'<button type="button" data-term="{one.key}" aria-describedby="term-{one.key}">{text}</button>'

    def definitions(self) -> str:
        rows = []
        for key, one in sorted(self.used.items()):
            unit = f" [{html.escape(one.unit)}]" if one.unit else ""
            rows.append(f'<p id="term-{key}"><b>{html.escape(one.term)}</b>: {html.escape(one.text)}{unit}</p>')
        return "\n".join(['<div id="definitions" hidden>', *rows, "</div>\n"]) if rows else ""
