"""External programs as methods: input folder, execution, and results."""

from scenetruth.estimators.external.command import CommandMethod
from scenetruth.estimators.external.recording_writer import recording_key, write_recording
from scenetruth.estimators.external.results_folder import ResultsFolder, read_results

__all__ = ["CommandMethod", "ResultsFolder", "read_results", "recording_key", "write_recording"]
