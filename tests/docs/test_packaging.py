"""Metadata of packages follow pyproject.toml: conda recipe, oldest versions, citation, deposit at Zenodo."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.helpers.releases import ROOT, releases

PACKAGING = ROOT / "packaging"
CONDA_NAMES = {"matplotlib": "matplotlib-base", "mapbox-earcut": "mapbox_earcut"}
"""Packages that conda-forge has under another name."""


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found


def bounds(lines: list[str], sign: str = ">=") -> dict[str, str]:
    """Return the versions behind the names of requirements."""
    parts = [re.fullmatch(rf"([\w.-]+) ?{sign}([\w.]+)", line) for line in lines]
    assert None not in parts, lines
    return {part.group(1).lower(): part.group(2) for part in parts if part is not None}


@pytest.fixture(scope="module")
def recipe() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((PACKAGING / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    return found


def test_the_conda_recipe_has_the_same_dependencies(project: dict[str, Any], recipe: dict[str, Any]) -> None:
    listed = [line for line in recipe["requirements"]["run"] if not line.startswith(("python ", "__"))]
    own = {CONDA_NAMES.get(name, name): bound for name, bound in bounds(project["dependencies"]).items()}
    assert bounds(listed) == own


def test_the_conda_recipe_tells_the_same_of_the_package(project: dict[str, Any], recipe: dict[str, Any]) -> None:
    assert recipe["context"]["version"] == releases()[0][0]
    assert f">={recipe['context']['python_min']}" == project["requires-python"]
    assert recipe["about"]["summary"] == project["description"]
    assert recipe["about"]["license"] == project["license"]
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {entry}" for name, entry in project["scripts"].items()
    ]
    for name in (each for test in recipe["tests"] if "python" in test for each in test["python"]["imports"]):
        place = ROOT / "src" / Path(*name.split("."))
        assert place.is_dir() or place.with_suffix(".py").is_file(), name


def test_extras_of_the_conda_recipe_have_the_same_bounds(project: dict[str, Any], recipe: dict[str, Any]) -> None:
    own = {line for lines in project["optional-dependencies"].values() for line in lines if ">=" in line}
    constraints = bounds(recipe["requirements"]["run_constraints"])
    assert constraints
    assert constraints.items() <= bounds(sorted(own)).items()


def test_the_oldest_versions_are_those_that_are_allowed(project: dict[str, Any]) -> None:
    lines = (PACKAGING / "oldest.txt").read_text(encoding="utf-8").splitlines()
    pinned = bounds([line for line in lines if not line.startswith("#")], "==")
    assert pinned == bounds(project["dependencies"])


def test_the_citation_is_of_the_latest_release(project: dict[str, Any]) -> None:
    told = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (told["version"], str(told["date-released"])) == releases()[0]
    assert (told["title"], told["license"]) == (project["name"], project["license"])
    assert [each["name"] for each in told["authors"]] == [each["name"] for each in project["authors"]]


def test_the_bibliography_entry_of_the_site_has_the_latest_release() -> None:
    entry = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").partition("@software{scenetruth")[2]
    found = re.findall(r"version = \{(.*)\},\n *year += \{(.*)\}", entry)[0]
    version, date = releases()[0]
    assert found == (version, date[:4])


def test_metadata_of_zenodo_agree_with_citation_and_project(project: dict[str, Any]) -> None:
    deposit = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (deposit["title"], deposit["description"]) == (citation["title"], project["description"])
    assert deposit["license"] == citation["license"] == project["license"]
    assert deposit["creators"] == [{"name": each["name"]} for each in citation["authors"]]
    assert deposit["keywords"] == citation["keywords"]
    assert (deposit["upload_type"], deposit["access_right"]) == ("software", "open")
    # Version and date are those of the release that is deposited.
    assert not {"version", "publication_date", "doi"} & set(deposit)


def test_the_conda_recipe_builds_with_the_same_packages(recipe: dict[str, Any]) -> None:
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    host = [line for line in recipe["requirements"]["host"] if not line.startswith(("python ", "pip"))]
    assert bounds(host) == bounds(needed)


def test_the_wheel_holds_all_files_of_the_package() -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    package = ROOT / "src" / "scenetruth"
    named = {path for pattern in told["package-data"]["scenetruth"] for path in package.glob(pattern)}
    others = {path for path in package.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc")}
    # What numba has compiled lies in the cache's folder, or here.
    others = {path for path in others if "__pycache__" not in path.parts}
    assert others == named
    # Not whatever else git tracks.
    assert told["include-package-data"] is False


def test_the_image_has_a_supported_python_and_extras_and_commands_of_the_package(project: dict[str, Any]) -> None:
    text = (PACKAGING / "Dockerfile").read_text(encoding="utf-8")
    images = re.findall(r"^FROM python:(3\.\d+)-", text, re.MULTILINE)
    # The wheel is made by the version that installs it.
    assert len(images) == 2
    assert {f"Programming Language :: Python :: {image}" for image in images} <= set(project["classifiers"])
    extras = re.findall(r"\.whl\)\[(.*)\]", text)[0].split(",")
    assert set(extras) <= set(project["optional-dependencies"])
    commands = re.findall(r'^(?:RUN|ENTRYPOINT) (?:\[")?(scenetruth)\b', text, re.MULTILINE)
    assert set(commands) == set(project["scripts"])


def test_the_image_is_made_of_all_that_git_tracks_and_ends_as_a_user() -> None:
    text = (PACKAGING / "Dockerfile").read_text(encoding="utf-8")
    assert re.findall(r"^COPY (.*) \S+$", text, re.MULTILINE) == ["."]
    left_out = set((PACKAGING / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()[1:])
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    # A pattern of Docker counts from the top, one of git anywhere.
    anywhere = {"__pycache__", "*.egg-info"}
    wanted = {line.removesuffix("/") for line in ignored}
    assert left_out == {f"**/{line}" if line in anywhere else line for line in wanted}
    assert re.findall(r"^USER (.*)$", text, re.MULTILINE)[-1] not in ("0", "root")
    assert 'ENTRYPOINT ["scenetruth"]' in text
