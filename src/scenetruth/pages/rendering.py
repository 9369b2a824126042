"""Puts pages together: files of HTML that need no network, in one style."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from scenetruth.pages.plotly_script import plotly_script
from scenetruth.pages.tables import table_of

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["environment_of", "in_script", "page_of"]


def environment_of(package: str, *, autoescape: bool = True, **options: Any) -> Environment:
    """Return what reads templates: those of a package, and those that all pages share.

    Parameters
    ----------
    package
        The package whose folder ``templates`` has the templates.
    autoescape
        Whether what is told is text, of which nothing acts as HTML.
    **options
        Further options of `jinja2.Environment`.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in (package, "scenetruth.pages")]),
        autoescape=autoescape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **options,
    )


def page_of(package: str, template: str, charts: Any, **told: Any) -> str:
    """Return a page.

    Parameters
    ----------
    package
        The package whose folder ``templates`` has the template, which extends ``page_with_charts.html.j2``.
    template
        Name of the template.
    charts
        Charts as plain values, which the page's script finds as ``charts``.
    told
        What the template tells.
    """
    return (
        environment_of(package)
        .get_template(template)
        .render(
            **told,
            table_of=table_of,
            plotly=plotly_script(),
            charts=in_script(charts),
        )
    )


def in_script(values: Any) -> str:
    r"""Return plain values as they may stand in a page's script, which nothing in them ends.

    Examples
    --------
    >>> print(in_script({"title": "</script>"}))
    {"title": "\u003c/script>"}
    """
    return json.dumps(values, ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")
