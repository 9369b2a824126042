"""Results that were made elsewhere, and wait in a folder, as a method of estimation."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import xarray as xr
from pydantic import create_model

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.external.exchange.keys import recording_key
from scenetruth.estimators.external.exchange.reading import read_results
from scenetruth.estimators.external.naming import name_problems
from scenetruth.estimators.protocol import Method, MethodSettings, Needs
from scenetruth.progress import Progress

__all__ = ["ResultsFolder", "ResultsFolderSettings"]


class ResultsFolderSettings(MethodSettings):
    """Where results are looked for."""

    folder: str
    """The folder: a sub-folder for each recording, named by its key."""


class ResultsFolder(Method):
    """A folder of results as a method: nothing is computed, everything is looked up.

    ``folder/KEY`` holds the results of one recording, with the files that `read_results` reads; KEY is what
    `recording_key` says of it. So results that were made offline, on another machine or by hand, are compared like all
    others.

    Parameters
    ----------
    folder
        The folder.
    name
        What the method is called.

    Raises
    ------
    EstimateError
        If it cannot be called so.

    See Also
    --------
    scenetruth.estimators.external.recording_key : The name of a recording's sub-folder.
    scenetruth.estimators.external.read_results : The files that it may hold.
    scenetruth.estimators.external.CommandMethod : A program that is run.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> from scenetruth.estimators.external import ResultsFolder, recording_key
    >>> recording = st.make_recording(np.zeros((2, 1, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     place = Path(folder, recording_key(recording))
    ...     place.mkdir()
    ...     np.save(place / "depth.npy", np.full((30, 40), 1000.0))
    ...     found = st.estimate(recording, ResultsFolder(folder, "by_hand"))
    >>> found.attrs["method"], found.disparity.sel(t=0)[15, 20].item()
    ('by_hand', 2.5)
    """

    needs = Needs(mask=True)
    reads_frames = True

    def __init__(self, folder: str | os.PathLike[str], name: str) -> None:
        if problems := name_problems(name):
            raise EstimateError(problems, source="folder of results")
        self.name = name
        self._where = str(Path(folder).absolute())
        fields: dict[str, Any] = {"folder": (str, self._where)}
        self.settings = create_model("ResultsFolderSettings", __base__=ResultsFolderSettings, **fields)

    def __reduce__(self) -> tuple[Any, ...]:
        # Models that are made at run time cannot be found by those who unpickle: workers make their own.
        return ResultsFolder, (self._where, self.name)

    def as_option(self, label: str) -> tuple[str, str]:
        """Return how the command line of a comparison calls it."""
        return "--results", f"{label}={self._where}"

    def listing(self) -> str:
        """Return what lies in the folder: names, sizes and times, which tell when results are changed."""
        lines = []
        for file in sorted(Path(self._where).rglob("*")):
            if file.is_file():
                told = file.stat()
                lines.append(f"{file.relative_to(self._where)} {told.st_size} {told.st_mtime_ns}")
        return "\n".join(lines)

    def requirements(self, recording: xr.Dataset, settings: ResultsFolderSettings) -> list[Problem]:
        """Return whether the folder is missing; what is in it shows when there are images."""
        if Path(settings.folder).is_dir():
            return []
        return [Problem("folder", "there is no such folder of results", settings.folder)]

    def estimate(self, recording: xr.Dataset, settings: ResultsFolderSettings, progress: Progress | None) -> xr.Dataset:
        """Look the results up."""
        place = Path(settings.folder) / recording_key(recording)
        if not place.is_dir():
            message = (
                "there are no results for this recording; write it out with "
                "scenetruth.estimators.external.write_recording(recording, FOLDER), and put into this folder what a "
                "program makes of it"
            )
            raise EstimateError([Problem(str(place), message)])
        return read_results(place, recording)
