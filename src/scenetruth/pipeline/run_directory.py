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
    """Files of one method in a run directory; ``figures`` is the directory of the figures of the report."""

    estimate: Path
    score_json: Path
    score_csv: Path
    report: Path
    figures: Path

    @property
    def after_estimate(self) -> tuple[Path, ...]:
        """Files derived from the estimate."""
        return self.score_json, self.score_csv, self.report, self.figures


class RunDirectory:
    """Directory of a run, with the names of its files.

    Files of the method of the scene have plain names (``estimate.zarr``, ``score.json``, ...); names of files of other
    methods include the method (``estimate.opencv_flow.zarr``).

    Parameters
    ----------
    path
        The directory; it need not exist.
    own_method
        The method with plain names; default: the method of the scene in the directory, or the default method if
        there is no scene.

    See Also
    --------
    run_scene : Write the results of a scene to the directory.
    verify : Verify its contents.
    export : Export its contents.

    Examples
    --------
    >>> run = RunDirectory("outputs/cube", "structure_tensor")
    >>> run.recording.name, run.paths("structure_tensor").report.name, run.paths("opencv_flow").report.name
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
        """File with the arguments of an interrupted run; it exists until the last stage is complete."""
        return self.path / UNFINISHED

    @property
    def recording(self) -> Path:
        """The recording."""
        return self._store(RECORDING)

    @property
    def truth(self) -> Path:
        """The truth; recordings of real images have none."""
        return self._store(TRUTH)

    @property
    def images(self) -> Path:
        """The image files."""
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

    def paths(self, method: str) -> MethodPaths:
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
        """Return the methods with estimates, the method with plain names first.

        Raises
        ------
        StoreError
            If there is no estimate.
        """
        methods = []
        for store in sorted(self.stores("estimate*")):
            try:
                attrs = json.loads(open_store_files(store).read("zarr.json"))["attributes"]
                methods.append(str(attrs.get("method", self.own_method)))
            except (OSError, ValueError, KeyError, TypeError):
                # A damaged store is reported when it is loaded.
                infix = store.name.removeprefix("estimate").removesuffix(".zip").removesuffix(".zarr").lstrip(".")
                methods.append(infix or self.own_method)
        if not methods:
            raise StoreError(
                self.paths(self.own_method).estimate, "no such store; compute it with `scenetruth estimate`"
            )
        return sorted(set(methods), key=lambda name: (name != self.own_method, name))

    def check_recording(self) -> Path:
        """Return the path of the recording; a StoreError says what is missing."""
        if not self.path.is_dir():
            raise StoreError(self.path, "no such directory; give the directory of a run (`scenetruth run`)")
        if not self.recording.exists():
            remedy = "give the directory of a run (`scenetruth run`), which contains it"
            raise StoreError(self.recording, f"no such store; {remedy}")
        return self.recording

    def check_estimate(self, method: str) -> Path:
        """Return the path of the estimate of a method; a StoreError lists the estimates of the run."""
        estimate = self.paths(method).estimate
        if not estimate.exists():
            found = self.estimated() if self.stores("estimate*") else []
            listed = f"the run has estimates of {', '.join(found)}" if found else "the run has no estimate"
            raise StoreError(estimate, f"no such store: {listed}; compute one with `scenetruth estimate`")
        return estimate

    def stores(self, pattern: str) -> list[Path]:
        """Return the stores with matching names, zip files or directories."""
        return [path for zipped in (False, True) for path in self.path.glob(store_name(pattern, zipped=zipped))]

    def _store(self, stem: str) -> Path:
        """Return the path of a store; stores are zip files if the recording is."""
        zipped = (self.path / store_name(RECORDING, zipped=True)).exists()
        return self.path / store_name(stem, zipped=zipped)

    def _scene_of_recording(self) -> Any:
        try:
            attrs = json.loads(open_store_files(self.recording).read("zarr.json"))["attributes"]
            return json.loads(attrs["scene"])
        except (OSError, ValueError, KeyError, TypeError):
            return None


UNFINISHED = ".unfinished"
"""Hidden file with which a repeated command resumes the run."""
_METHOD = r"(\.[\w-]+)?"
_CLAIMS: tuple[tuple[re.Pattern[str], Claim], ...] = (
    (re.compile(rf"{re.escape(SCENE)}|score{_METHOD}\.(json|csv)|report{_METHOD}\.html"), claim_file),
    (re.compile(re.escape(UNFINISHED)), claim_file),
    (re.compile(rf"({RECORDING}|{TRUTH}|estimate{_METHOD})\.zarr(\.zip)?"), claim_store),
    (re.compile(rf"figures{_METHOD}"), claim_pictures),
    (re.compile("images"), lambda path: claim_pictures(path, is_image_name)),
)


def claim_entry(path: Path) -> OwnershipResult | None:
    """Claim an entry of a run directory; None if scenetruth gives no such name."""
    for names, claim in _CLAIMS:
        if names.fullmatch(path.name):
            return claim(path)
    return None


def claim_run(path: Path) -> OwnershipResult:
    """Claim a run directory; entries with other names are foreign and kept."""
    if not path.is_dir():
        return OwnershipResult("is a file, and not a run directory")
    if not is_store(RunDirectory(path).recording):
        return OwnershipResult("is a directory that scenetruth did not write")
    claims = {entry.name: claim_entry(entry) for entry in path.iterdir()}
    spoilt = [name for name, claimed in claims.items() if claimed is not None and claimed.refusal]
    if spoilt:
        return OwnershipResult(describe_foreign_files(spoilt))
    return OwnershipResult(foreign=tuple(sorted(name for name, claimed in claims.items() if claimed is None)))
