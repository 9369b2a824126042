"""One page that holds everything about an estimate: numbers, figures, definitions and where it comes from."""

from scenetruth.scoring.report.page import write_report

__all__ = ["write_report"]
