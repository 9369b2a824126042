"""Remove the plotly bundle from a page, because the pages of the site share one bundle.

Run ``python docs/_make/slim_page.py PAGE OUTPUT``. The page then loads ``plotly.min.js`` from its own directory, where
the build of the site writes it.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

__all__ = ["slim"]

_BUNDLE = re.compile(r"<script>\s*/\*\*\s*\* plotly\.js v[^<]*?.*?</script>", re.DOTALL)
_SHARED = '<script src="plotly.min.js"></script>'


def slim(page: str) -> str:
    """Return a page that loads plotly from its own directory.

    Parameters
    ----------
    page
        HTML that contains the bundle.

    Raises
    ------
    ValueError
        If it does not contain exactly one bundle.
    """
    found, count = _BUNDLE.subn(lambda _: _SHARED, page)
    if count != 1:
        raise ValueError(f"page: has {count} plotly bundles; expected one")
    return found


if __name__ == "__main__":
    given, output = sys.argv[1:]
    Path(output).write_text(slim(Path(given).read_text(encoding="utf-8")), encoding="utf-8")
