"""Takes plotly's bundle out of a page: the site's pages share one. ``python docs/_make/slim_page.py PAGE OUTPUT``.

The page then loads ``plotly.min.js`` from beside it, which the build of the site puts there.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

__all__ = ["slim"]

_BUNDLE = re.compile(r"<script>\s*/\*\*\s*\* plotly\.js v[^<]*?.*?</script>", re.DOTALL)
_SHARED = '<script src="plotly.min.js"></script>'


def slim(page: str) -> str:
    """Return a page that loads plotly from beside it.

    Parameters
    ----------
    page
        HTML with the bundle in it.

    Raises
    ------
    ValueError
        If it has no bundle in it, or several.
    """
    found, count = _BUNDLE.subn(lambda _: _SHARED, page)
    if count != 1:
        raise ValueError(f"the page has {count} bundles of plotly; expected one")
    return found


if __name__ == "__main__":
    given, output = sys.argv[1:]
    Path(output).write_text(slim(Path(given).read_text(encoding="utf-8")), encoding="utf-8")
