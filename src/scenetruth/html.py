"""Self-contained HTML pages: templates, sortable tables, charts and the script of plotly."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from scenetruth.glossary import define_terms

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = [
    "COLOURS",
    "Chart",
    "HtmlCell",
    "HtmlTable",
    "make_table",
    "plotly_script",
    "render_page",
    "script_json",
    "sort_key",
    "template_environment",
]


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7F3C8D", "#6B6B00")
"""Colours distinguishable with colour blindness (M. Okabe and K. Ito, 2008), and two more."""


@dataclass(frozen=True)
class Chart:
    """A chart: its name within the page, text alternative, and traces and layout of plotly."""

    name: str
    alt: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]

    @property
    def title(self) -> str:
        """The title, which the page shows above the chart."""
        return str(self.layout.get("title", {}).get("text", "")).partition("<br>")[0]

    @property
    def subtitle(self) -> str:
        """The line below the title; empty if there is none."""
        return re.sub("<[^>]*>", "", str(self.layout.get("title", {}).get("text", "")).partition("<br>")[2])


_MOST_STACKED_COLUMNS, _MOST_STACKED_CELLS = 12, 200
"""Larger tables would be too long as cards."""
_SINGLE_COLUMNS = 4
"""Number of columns up to which cards have one value a line."""
_NONE = "–"
_NUMBER = re.compile(r"[-+]?(∞|\d+(\.\d*)?([eE][-+]?\d+)?)(?!\w)")


@dataclass(frozen=True)
class HtmlCell:
    """A cell of a table; ``key`` is its number for sorting, None to sort by text.

    ``address``, ``saved_as``: Address of a file for download, and its file name; empty if there is none.
    """

    text: str
    key: float | None = None
    address: str = ""
    saved_as: str = ""

    @property
    def sorts_by(self) -> str:
        """The sort key as JavaScript; empty if there is none."""
        if self.key is None or math.isnan(self.key):
            return ""
        return repr(float(self.key)).replace("inf", "Infinity")


@dataclass(frozen=True)
class HtmlTable:
    """A table; ``marked`` is the index of the highlighted row, ``foot`` has rows that stay at the bottom."""

    name: str
    caption: str
    columns: Sequence[str]
    lines: Sequence[Sequence[HtmlCell]]
    marked: int | None = None
    foot: Sequence[Sequence[HtmlCell]] = ()

    @property
    def stacking(self) -> str:
        """Classes of a table whose rows are cards on narrow screens; empty for tables that scroll there."""
        if len(self.columns) > _MOST_STACKED_COLUMNS or len(self.lines) * len(self.columns) > _MOST_STACKED_CELLS:
            return ""
        return "stack pairs" if len(self.columns) > _SINGLE_COLUMNS else "stack"

    @property
    def numeric(self) -> list[bool]:
        """Whether each column contains only numbers, or dashes for missing values."""
        columns = [[line[place] for line in self.lines] for place in range(len(self.columns))]
        return [
            any(cell.key is not None for cell in cells) or (bool(cells) and all(cell.text == _NONE for cell in cells))
            for cells in columns
        ]


def make_table(name: str, caption: str, columns: Sequence[str], lines: Iterable[Iterable[Any]]) -> HtmlTable:
    """Return a table of texts; texts that begin with a number are sorted by it."""
    cells = [[HtmlCell(str(text), sort_key(str(text))) for text in line] for line in lines]
    return HtmlTable(name, caption, columns, cells)


def sort_key(text: str) -> float | None:
    """Return the number at the beginning of a text; None if there is none.

    >>> [sort_key(text) for text in ("0.5", "-3 px", "1e-3 to 2", "−2", "∞", "leaf", "–", "3d")]
    [0.5, -3.0, 0.001, -2.0, inf, None, None, None]
    """
    found = _NUMBER.match(text.strip().replace("\N{MINUS SIGN}", "-"))
    return None if found is None else float(found[0].replace("∞", "inf"))


# The default of plotly includes a button that uploads the chart.
_SETTINGS = '{responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: ""}'


def plotly_script() -> str:
    """Return plotly's script, configured for self-contained pages: no button uploads data.

    >>> plotly_script().rstrip().endswith('showSendToCloud: false, plotlyServerURL: ""});')
    True
    """
    from importlib.resources import files

    # The build copies it from plotly (setup.py).
    script = files("scenetruth").joinpath("templates", "plotly.min.js").read_text(encoding="utf-8")
    return f"{script}\nPlotly.setPlotConfig({_SETTINGS});\n"


def template_environment(package: str, *, autoescape: bool = True, **options: Any) -> Environment:
    """Return the template environment of a package, including the shared templates."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in (package, "scenetruth")]),
        autoescape=autoescape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **options,
    )


def render_page(package: str, template: str, charts: Any, **values: Any) -> str:
    """Return a rendered page."""
    page = template_environment(package).get_template(template)
    text = page.render(**values, table_of=make_table, plotly=plotly_script(), charts=script_json(charts))
    return define_terms(text)


def script_json(values: Any) -> str:
    r"""Return plain values as JSON that is safe within a script element.

    >>> print(script_json({"title": "</script>"}))
    {"title": "\u003c/script>"}
    """
    return json.dumps(values, ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")
