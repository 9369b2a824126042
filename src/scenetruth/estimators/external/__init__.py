"""External programs as methods: input folder, execution, and results."""

from scenetruth.estimators.external.command import CommandMethod
from scenetruth.estimators.external.recording_writer import recording_key, write_recording
from scenetruth.estimators.external.results_folder import ResultsFolder, read_results
from scenetruth.estimators.external.subprocess_limits import can_list_processes, last_lines, run_program

__all__ = [
    "CommandMethod", "ResultsFolder", "can_list_processes", "last_lines", "read_results", "recording_key",
    "run_program", "write_recording",
]  # fmt: skip
