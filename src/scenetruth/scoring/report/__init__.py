"""One page that holds everything about an estimate: numbers, figures, definitions and where it comes from."""

from scenetruth.scoring.report.page import is_made_of, write_report

__all__ = ["is_made_of", "write_report"]
