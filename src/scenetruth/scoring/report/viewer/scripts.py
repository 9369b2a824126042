"""The scripts of the page: the viewer's own, and plotly's, which is packed until a surface is drawn."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from scenetruth.pages.plotly_script import plotly_script

__all__ = ["json_for_script", "packed_plotly", "viewer_script"]

_PARTS = ("unpack", "layers", "panels", "profile", "surface", "page")
"""What the viewer's script is put together from, in this order."""


@cache
def viewer_script() -> str:
    """Return the viewer's script, one function in strict mode."""
    folder = files("scenetruth.scoring.report") / "templates"
    text = "\n".join((folder / f"viewer_{part}.js").read_text(encoding="utf-8") for part in _PARTS)
    return f'(() => {{\n"use strict";\n{text}\n}})();\n'


@cache
def packed_plotly() -> str:
    """Return plotly's script as zlib packs it, in base 64: less than half of it."""
    return base64.b64encode(zlib.compress(plotly_script().encode("utf-8"), 6)).decode("ascii")


def json_for_script(values: Mapping[str, Any]) -> str:
    """Return plain values as JSON that may stand within a script: nothing in it can end one."""
    return json.dumps(values, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
