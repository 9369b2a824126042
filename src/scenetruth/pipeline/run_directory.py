"""The run directory: paths of all files, for one method or several."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from scenetruth.errors import StoreError
from scenetruth.estimators.registry import DEFAULT_METHOD
from scenetruth.output import Claim, OwnershipResult, claim_file, claim_pictures, describe_foreign_files
from scenetruth.storage import (
    RECORDING,
    SCENE,
    TRUTH,
    claim_store,
    is_image_name,
    is_store,
    open_store_files,
    store_name,
)

__all__ = ["MethodPaths", "RunDirectory", "claim_entry", "claim_run"]


@dataclass(frozen=True)
class MethodPaths:
    """What one method leaves in the folder of a run.

    ``estimate``: Store of the estimate.
    ``score_json``, ``score_csv``: Its score.
    ``report``, ``figures``: The page, and the folder of its pictures.
    """

    estimate: Path
    score_json: Path
    score_csv: Path
    report: Path
    figures: Path

    @property
    def after_estimate(self) -> tuple[Path, ...]:
        """What is made from the estimate."""
        return self.score_json, self.score_csv, self.report, self.figures


class RunDirectory:
    """The folder of a run; owns the name of every file in it.

    What belongs to the method that the scene names has plain names (``estimate.zarr``, ``score.json``, ...); what
    belongs to another method has the method's name in it (``estimate.opencv_flow.zarr``).

    Parameters
    ----------
    path
        The folder; it need not exist.
    own_method
        The method with the plain names; if not given, what the scene in the folder says, or the paper's method where
        there is no scene.

    See Also
    --------
    run_scene : Fills the folder.
    verify : Checks what is in it.
    export : Writes it in formats of others.

    Examples
    --------
    >>> run = RunDirectory("outputs/cube", "structure_tensor")
    >>> run.recording.name, run.of("structure_tensor").report.name, run.of("opencv_flow").report.name
    ('recording.zarr', 'report.html', 'report.opencv_flow.html')
    """

    def __init__(self, path: str | Path, own_method: str | None = None) -> None:
        self.path = Path(path)
        self._own_method = own_method

    def __repr__(self) -> str:
        return f"RunDirectory({str(self.path)!r}, {self._own_method!r})"

    @property
    def scene(self) -> Path:
        """The scene with all defaults and overrides."""
        return self.path / SCENE

    @property
    def unfinished(self) -> Path:
        """What a run was asked for whose last stages are not done; none once they are."""
        return self.path / UNFINISHED

    @property
    def recording(self) -> Path:
        """The recording."""
        return self._store(RECORDING)

    @property
    def truth(self) -> Path:
        """The truth; real images have none."""
        return self._store(TRUTH)

    @property
    def images(self) -> Path:
        """The images as files."""
        return self.path / "images"

    @cached_property
    def own_method(self) -> str:
        """The method whose files have plain names."""
        if self._own_method is not None:
            return self._own_method
        scene = self._scene_of_recording()
        estimate = scene.get("estimate") if isinstance(scene, Mapping) else None
        named = estimate.get("method") if isinstance(estimate, Mapping) else None
        return named if isinstance(named, str) else DEFAULT_METHOD

    def of(self, method: str) -> MethodPaths:
        """Return the files of a method."""
        # A plain function is named module:function.
        infix = "" if method == self.own_method else "." + re.sub(r"[^\w-]", "-", method)
        return MethodPaths(
            estimate=self._store(f"estimate{infix}"),
            score_json=self.path / f"score{infix}.json",
            score_csv=self.path / f"score{infix}.csv",
            report=self.path / f"report{infix}.html",
            figures=self.path / f"figures{infix}",
        )

    def estimated(self) -> list[str]:
        """Return the methods whose estimates are in the folder, the one with plain names first.

        Raises
        ------
        StoreError
            If there is none.
        """
        methods = []
        for store in sorted(self.stores("estimate*")):
            try:
                attrs = json.loads(open_store_files(store).read("zarr.json"))["attributes"]
                methods.append(str(attrs.get("method", self.own_method)))
            except (OSError, ValueError, KeyError, TypeError):
                # A damaged store is told of by whoever loads it.
                infix = store.name.removeprefix("estimate").removesuffix(".zip").removesuffix(".zarr").lstrip(".")
                methods.append(infix or self.own_method)
        if not methods:
            raise StoreError(self.of(self.own_method).estimate, "no such store; make it with `scenetruth estimate`")
        return sorted(set(methods), key=lambda name: (name != self.own_method, name))

    def stores(self, pattern: str) -> list[Path]:
        """Return the stores in the folder whose names match, zip files or folders."""
        return [path for zipped in (False, True) for path in self.path.glob(store_name(pattern, zipped=zipped))]

    def _store(self, stem: str) -> Path:
        """Return the path of a store: all in a folder are zip files if the recording is."""
        zipped = (self.path / store_name(RECORDING, zipped=True)).exists()
        return self.path / store_name(stem, zipped=zipped)

    def _scene_of_recording(self) -> Any:
        try:
            attrs = json.loads(open_store_files(self.recording).read("zarr.json"))["attributes"]
            return json.loads(attrs["scene"])
        except (OSError, ValueError, KeyError, TypeError):
            return None


UNFINISHED = ".unfinished"
"""Hidden: it is for the same command to go on."""
_METHOD = r"(\.[\w-]+)?"
_CLAIMS: tuple[tuple[re.Pattern[str], Claim], ...] = (
    (re.compile(rf"{re.escape(SCENE)}|score{_METHOD}\.(json|csv)|report{_METHOD}\.html"), claim_file),
    (re.compile(re.escape(UNFINISHED)), claim_file),
    (re.compile(rf"({RECORDING}|{TRUTH}|estimate{_METHOD})\.zarr(\.zip)?"), claim_store),
    (re.compile(rf"figures{_METHOD}"), claim_pictures),
    (re.compile("images"), lambda path: claim_pictures(path, is_image_name)),
)


def claim_entry(path: Path) -> OwnershipResult | None:
    """Claim what has a name of ours in the folder of a run; None if the name is none of ours."""
    for names, claim in _CLAIMS:
        if names.fullmatch(path.name):
            return claim(path)
    return None


def claim_run(path: Path) -> OwnershipResult:
    """Claim the folder of a run; what has other names in it is foreign and stays."""
    if not path.is_dir():
        return OwnershipResult("is a file, and not the folder of a run")
    if not is_store(RunDirectory(path).recording):
        return OwnershipResult("is a folder that scenetruth did not write")
    claims = {entry.name: claim_entry(entry) for entry in path.iterdir()}
    spoilt = [name for name, claimed in claims.items() if claimed is not None and claimed.refusal]
    if spoilt:
        return OwnershipResult(describe_foreign_files(spoilt))
    return OwnershipResult(foreign=tuple(sorted(name for name, claimed in claims.items() if claimed is None)))
