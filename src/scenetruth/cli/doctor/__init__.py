"""What works on this machine and what does not, with remedies: ``scenetruth doctor``."""

from scenetruth.cli.doctor.examination import examine
from scenetruth.cli.doctor.finding import Finding, is_fit
from scenetruth.cli.doctor.printing import as_json, print_findings

__all__ = ["Finding", "as_json", "examine", "is_fit", "print_findings"]
