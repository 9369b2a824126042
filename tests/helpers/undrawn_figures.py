"""Figures without their drawing, for tests of what is written, resumed or replaced around them."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

__all__ = ["leave_undrawn", "undrawn_figures"]


@pytest.fixture
def undrawn_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are composed with all their parts, but a blank picture stands for them: drawing takes most of a run."""
    leave_undrawn(monkeypatch)


def leave_undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let blank pictures stand for figures until ``monkeypatch`` is undone, as in a fixture that tests share."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    def save(figure: Figure, path: str | Path | StringIO, metadata: Any = None, **options: Any) -> None:
        if isinstance(path, StringIO):
            path.write("<svg/>")
            return
        if Path(path).suffix == ".pdf":
            Path(path).write_bytes(b"%PDF-1.4\n")
            return
        texts = PngInfo()
        for name, text in (metadata or {}).items():
            texts.add_text(name, text)
        Image.new("L", (8, 8)).save(path, "png", pnginfo=texts)

    monkeypatch.setattr(Figure, "savefig", save)
    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", lambda engine, figure: None)
