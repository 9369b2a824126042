"""Plug-ins that are installed for a test: modules and their entry points on the search path."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

PACKAGES = Path(__file__).parents[1] / "plugins"


def offer(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    package: str,
    points: dict[str, str],
    code: str = "",
    version: str = "1",
) -> None:
    """Install a distribution with some entry points, as pip would write it down, and its module of the same name."""
    information = folder / f"{package}-{version}.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
    lines = [f"{name} = {value}" for name, value in points.items()]
    (information / "entry_points.txt").write_text("\n".join(["[scenetruth.estimators]", *lines]) + "\n")
    if code:
        (folder / f"{package}.py").write_text(code)
    monkeypatch.syspath_prepend(folder)


def offer_package(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install one of the packages under ``tests/plugins``."""
    project = tomllib.loads((PACKAGES / name / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]["scenetruth.estimators"]
    offer(folder, monkeypatch, project["name"], points, version=project["version"])
    monkeypatch.syspath_prepend(PACKAGES / name)
