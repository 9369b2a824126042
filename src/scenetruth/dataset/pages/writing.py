"""Pages from templates: HTML in which every word is escaped, Markdown in which every word is escaped."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from scenetruth.errors import visible
from scenetruth.pages.rendering import environment_of
from scenetruth.scoring._format import format_count, format_number

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["Verbatim", "code", "escape_markdown", "render_html", "render_markdown", "size_words"]

_SPECIAL = re.compile(r"([\\`*_{}\[\]#!|~$])")
_AT_BEGIN = re.compile(r"^([-+=]|[0-9]+(?=[.)]))")


class Verbatim(str):
    """Markdown that stays as it is."""

    __slots__ = ()


def render_html(template: str, **content: Any) -> str:
    """Return a page.

    Parameters
    ----------
    template
        Name of a template of this room.
    **content
        What it shows; texts may hold anything.
    """
    environment = _environment(autoescape=True)
    return environment.get_template(template).render(content)


def render_markdown(template: str, **content: Any) -> str:
    """Return a text in Markdown.

    Parameters
    ----------
    template
        Name of a template of this room.
    **content
        What it shows; texts may hold anything.
    """
    environment = _environment(autoescape=False, finalize=_finalized)
    environment.filters |= {"code": code, "verbatim": Verbatim}
    return environment.get_template(template).render(content)


def _environment(**options: Any) -> Environment:
    environment = environment_of("scenetruth.dataset.pages", keep_trailing_newline=True, **options)
    environment.filters |= {"number": format_number, "count": format_count, "size": size_words}
    return environment


def escape_markdown(text: str) -> str:
    r"""Return a text on one line in which nothing acts as Markdown or HTML.

    Examples
    --------
    >>> print(escape_markdown("*bold* <b>\nnext"))
    \*bold\* &lt;b&gt; next
    >>> print(escape_markdown("1. first"), escape_markdown("- 2"), escape_markdown("1.5 mm"))
    1\. first \- 2 1\.5 mm
    """
    plain = visible(" ".join(text.split()), lines=False)
    plain = plain.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    begun = _AT_BEGIN.match(plain)
    # A number and a point at the beginning of a line would make it part of a list.
    head = "" if begun is None else (f"{begun[1]}\\" if begun[1].isdecimal() else f"\\{begun[1]}")
    return head + _SPECIAL.sub(r"\\\1", plain[0 if begun is None else begun.end() :])


def code(text: Any) -> Verbatim:
    """Return a text as code on one line, whatever it holds.

    Examples
    --------
    >>> print(code("a`b"))
    ``a`b``
    """
    plain = visible(" ".join(str(text).split()), lines=False).replace("|", "\\|")
    longest = max((len(run) for run in re.findall("`+", plain)), default=0)
    fence = "`" * (longest + 1)
    space = " " if plain.startswith("`") or plain.endswith("`") else ""
    return Verbatim(f"{fence}{space}{plain}{space}{fence}") if plain else Verbatim("–")


def size_words(count: float) -> str:
    """Return a number of bytes as people read it.

    Examples
    --------
    >>> size_words(999), size_words(1_234_567)
    ('999 B', '1.23 MB')
    """
    for size, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= size:
            return f"{format_number(count / size)} {unit}"
    return f"{int(count)} B"


def _finalized(value: Any) -> Any:
    return value if isinstance(value, Verbatim) or not isinstance(value, str) else escape_markdown(value)
