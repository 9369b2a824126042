"""The folders that one run of a program has, and what stays of them."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

__all__ = ["Workplace"]


class Workplace:
    """A fresh folder with folders in it: ``recording``, ``output``, ``work``, where the program runs, and ``log.txt``.

    Parameters
    ----------
    name
        What it is called after.
    keep_in
        The folder in which it stays; None for a temporary one that goes.
    """

    def __init__(self, name: str, keep_in: Path | None) -> None:
        if keep_in is not None:
            keep_in.mkdir(parents=True, exist_ok=True)
        self._stays = keep_in is not None
        # The name says nothing of the run that the recording is from.
        self.folder = Path(tempfile.mkdtemp(prefix=f"scenetruth-{name}-", dir=keep_in)).resolve()
        self.recording, self.output, self.work = (self.folder / part for part in ("recording", "output", "work"))
        self.log = self.folder / "log.txt"
        for part in (self.recording, self.output, self.work):
            part.mkdir()

    @property
    def places(self) -> dict[str, Path]:
        """The folders that commands name."""
        return {"recording": self.recording, "output": self.output}

    def clear(self) -> None:
        """Remove all, unless it is to stay."""
        if not self._stays:
            shutil.rmtree(self.folder, ignore_errors=True)

    def clear_to_log(self) -> None:
        """Remove all but the log, unless all is to stay."""
        if not self._stays:
            for part in (self.recording, self.output, self.work):
                shutil.rmtree(part, ignore_errors=True)
