"""Programs of any language as methods: what they are given, how they are run, and how their results are read."""

from scenetruth.estimators.external.command import CommandMethod
from scenetruth.estimators.external.exchange import read_results, recording_key, write_recording
from scenetruth.estimators.external.results_folder import ResultsFolder

__all__ = ["CommandMethod", "ResultsFolder", "read_results", "recording_key", "write_recording"]
