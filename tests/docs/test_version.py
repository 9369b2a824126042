"""The version is that of the tag, whatever way the sources came."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.version import Version
from setuptools_scm import get_version

from tests.helpers.releases import releases, unreleased

ROOT = Path(__file__).parents[2]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools_scm"]
NEXT = SETTINGS["fallback_version"].removesuffix(".dev0")
AT = re.escape(NEXT)

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="needs git")


def git(folder: Path, *words: str) -> bytes:
    who = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main")
    return subprocess.run(["git", *who, *words], cwd=folder, capture_output=True, check=True).stdout


def version_of(folder: Path) -> str:
    found: str = get_version(str(folder), **SETTINGS)
    return found


def archive_of(repository: Path, folder: Path) -> Path:
    """Unpack what ``git archive`` makes, as sites do that offer sources to download."""
    with zipfile.ZipFile(io.BytesIO(git(repository, "archive", "--format", "zip", "HEAD"))) as packed:
        packed.extractall(folder)
    assert not (folder / ".git").exists()
    return folder


def commit(repository: Path, text: str) -> None:
    (repository / "file.txt").write_text(text)
    git(repository, "add", "-A")
    git(repository, "commit", "-m", text)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Two commits of a project with this one's settings, and no tag."""
    folder = tmp_path / "repository"
    folder.mkdir()
    for name in ("pyproject.toml", ".gitattributes", ".git_archival.txt"):
        shutil.copy(ROOT / name, folder / name)
    git(folder, "init")
    for text in ("one", "two"):
        commit(folder, text)
    return folder


def test_before_the_first_tag_it_is_before_the_release(repository: Path, tmp_path: Path) -> None:
    found = version_of(repository)
    assert re.fullmatch(rf"{AT}\.dev2\+g[0-9a-f]{{7,}}", found)
    assert Version(found) < Version(NEXT)
    assert version_of(archive_of(repository, tmp_path / "archive")) == f"{NEXT}.dev0"


def test_at_the_tag_it_is_the_release(repository: Path, tmp_path: Path) -> None:
    git(repository, "tag", "-a", f"v{NEXT}", "-m", "release")
    assert version_of(repository) == NEXT
    assert version_of(archive_of(repository, tmp_path / "archive")) == NEXT
    git(tmp_path, "clone", "--depth", "1", "--branch", f"v{NEXT}", repository.as_uri(), "shallow")
    assert version_of(tmp_path / "shallow") == NEXT


def test_after_the_tag_it_is_after_the_release(repository: Path, tmp_path: Path) -> None:
    git(repository, "tag", "-a", f"v{NEXT}", "-m", "release")
    (repository / "file.txt").write_text("changed")
    found = version_of(repository)
    assert re.fullmatch(rf"{AT}\.post1\.dev0\+g[0-9a-f]{{7,}}\.d\d{{8}}", found)
    commit(repository, "three")
    after = version_of(repository)
    assert re.fullmatch(rf"{AT}\.post1\.dev1\+g[0-9a-f]{{7,}}", after)
    assert Version(NEXT) < Version(found) < Version(after)
    # An archive may name the commit by fewer digits.
    assert Version(version_of(archive_of(repository, tmp_path / "archive"))).public == Version(after).public


def test_without_a_tag_in_sight_the_commit_is_told(repository: Path, tmp_path: Path) -> None:
    git(repository, "tag", "-a", f"v{NEXT}", "-m", "release")
    commit(repository, "three")
    git(tmp_path, "clone", "--depth", "1", repository.as_uri(), "shallow")
    with pytest.warns(UserWarning, match="is shallow"):
        found = version_of(tmp_path / "shallow")
    head = git(repository, "rev-parse", "HEAD").decode()
    assert found.startswith(f"{NEXT}.dev1+g")
    assert head.startswith(found.partition("+g")[2])


# What git would have filled in is not.
@pytest.mark.filterwarnings("ignore:git archive did not support describe output")
def test_a_source_distribution_tells_it_and_bare_files_do_not(repository: Path) -> None:
    shutil.rmtree(repository / ".git")
    assert version_of(repository) == f"{NEXT}.dev0"
    (repository / "PKG-INFO").write_text("Metadata-Version: 2.4\nName: scenetruth\nVersion: 1.2.3\n")
    assert version_of(repository) == "1.2.3"


def test_what_is_worked_on_is_the_next_release() -> None:
    latest = Version(releases()[0][0])
    # At a release, nothing is unreleased.
    assert Version(NEXT) == latest if unreleased() == "" else Version(NEXT) > latest
    assert SETTINGS["fallback_version"].endswith(".dev0")
