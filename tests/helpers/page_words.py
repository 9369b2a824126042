"""Pages without what the definitions of terms add to them."""

from __future__ import annotations

import re

__all__ = ["without_definitions"]

_MARK = re.compile(r'<span class="(?:term|nowrap)"[^>]*>([^<]*)</span>')
_HEADING = re.compile(r'(<button type="button") data-term="[^"]*" aria-describedby="[^"]*">')
_LIST = re.compile(r'<div id="definitions" hidden>.*?</div>\n', re.DOTALL)


def without_definitions(page: str) -> str:
    """Return a page as it was before its terms and quantities were marked."""
    return _MARK.sub(r"\1", _HEADING.sub(r"\1>", _LIST.sub("", page)))
