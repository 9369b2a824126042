"""Which packages are installed: those that are needed, and those of each extra, with what it brings."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import metadata
from typing import TYPE_CHECKING

from scenetruth.cli.doctor.finding import Finding

if TYPE_CHECKING:
    from packaging.requirements import Requirement

__all__ = ["EXTRAS", "look_at_extras", "look_at_packages", "versions"]

EXTRAS = {
    "opengl": "images by OpenGL (backend pyrender)",
    "opencv": "the methods opencv_stereo, opencv_flow and opencv_scene_flow",
    "formats": "export to KITTI, Spring, OpenEXR and PLY",
    "design": "search and sensitivity of `scenetruth design optimise`",
    "cluster": "data sets made by the workers of a Dask cluster",
    "browser": "tests of pages in a browser",
}
"""Extras, and what each brings."""


def look_at_packages() -> list[Finding]:
    """Return whether all packages are there that nothing works without, and each that is not."""
    needed = _requirements("")
    if not needed:
        told = "nothing is known of what it needs, as it is not installed: it is run from its sources"
        return [Finding("packages", "needed", "missing", told, "pip install . or make setup")]
    wrong = [(one, problem) for one in needed if (problem := _problem_of(one))]
    found = [
        Finding("packages", one.name, "broken", problem, f"pip install '{one.name}{one.specifier}'", needed=True)
        for one, problem in wrong
    ]
    told = f"{len(needed) - len(wrong)} of {len(needed)} are there"
    return [Finding("packages", "needed", "broken" if wrong else "ok", told, needed=True), *found]


def look_at_extras() -> list[Finding]:
    """Return which extras are there, with versions and what each brings."""
    found = []
    for extra, brings in EXTRAS.items():
        wanted = _requirements(extra)
        problems = [problem for one in wanted if (problem := _problem_of(one))]
        there = [f"{one.name} {version}" for one in wanted if (version := _version(one.name))]
        missing = bool(problems) or not wanted
        told = f"{brings}: {', '.join([*problems, *([] if problems else there)])}"
        remedy = f"pip install 'scenetruth[{extra}]'" if missing else ""
        found.append(Finding("extras", extra, "missing" if missing else "ok", told, remedy))
    return found


def versions() -> dict[str, str]:
    """Return the versions of all packages that are there, of those that scenetruth or an extra of it needs."""
    names = {one.name for extra in ("", *EXTRAS) for one in _requirements(extra)} | {"llvmlite", "scenetruth"}
    return {name: version for name in sorted(names, key=str.lower) if (version := _version(name))}


def _requirements(extra: str) -> list[Requirement]:
    """Return what an extra needs beyond what is needed anyway; that of no name is what is needed anyway."""
    from packaging.requirements import Requirement

    try:
        lines = metadata.requires("scenetruth") or []
    except metadata.PackageNotFoundError:
        return []
    return [one for one in map(Requirement, lines) if extra in _extras_of(one)]


def _extras_of(requirement: Requirement) -> Iterator[str]:
    """Yield the extras that a requirement belongs to; the empty name if to none."""
    marker = requirement.marker
    for extra in ("", *EXTRAS):
        if (marker is None or marker.evaluate({"extra": extra})) and (not extra or "extra" in str(marker)):
            yield extra


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _problem_of(requirement: Requirement) -> str:
    """Return what is wrong with a package; empty if nothing."""
    version = _version(requirement.name)
    if not version:
        return f"{requirement.name} is not installed"
    if not requirement.specifier.contains(version, prereleases=True):
        return f"{requirement.name} {version} is there, and {requirement.specifier} is needed"
    return ""
