"""What may lie beside the page, with the words under which it is linked."""

from __future__ import annotations

from pathlib import Path

__all__ = ["links_in"]

_BESIDE = (
    ("budget/index.html", "Error budget of the recommended rig"),
    ("pattern/pattern.pdf", "Pattern to print, at true scale"),
    ("pattern/pattern.svg", "The pattern as SVG"),
    ("recommended/report.html", "Report of one simulation of the recommended rig"),
    ("sweep/index.html", "Sweep around the recommended rig"),
)


def links_in(folder: str | Path) -> list[tuple[str, str]]:
    """Return addresses and words of what there is beside the page.

    Parameters
    ----------
    folder
        Where the page lies.
    """
    return [(name, words) for name, words in _BESIDE if (Path(folder) / name).is_file()]
