"""The report of an estimate: one HTML page with numbers, figures, definitions and provenance."""

from scenetruth.scoring.report.score_report import matches_fingerprint, write_report

__all__ = ["matches_fingerprint", "write_report"]
