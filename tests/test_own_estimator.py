"""The example of a method as a package of its own: installed, found by its name, and tested as its users would."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.helpers.nightly import nightly

EXAMPLE = Path(__file__).parents[1] / "examples" / "own_estimator"
MOST_LINES = 40
"""Lines of code that a method and its registration take."""


def code_lines(source: str) -> int:
    """Count the lines that are no blanks, comments or docstrings."""
    lines = {number for number, line in enumerate(source.splitlines(), 1) if line.split("#")[0].strip()}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            assert node.end_lineno is not None
            lines -= set(range(node.lineno, node.end_lineno + 1))
    return len(lines)


def install(source: Path, target: Path) -> None:
    """Install a package without network, by pip where it can build wheels, else by its build system itself."""
    numbers = metadata.version("setuptools").split(".") if find_spec("setuptools") else ["0", "0"]
    if (int(numbers[0]), int(numbers[1])) >= (70, 1) or find_spec("wheel"):
        command = ["-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-index", "--no-deps"]
        command += ["--no-build-isolation", "--target", str(target), str(source)]
    elif find_spec("setuptools"):
        command = ["-c", "import setuptools; setuptools.setup()", "-q", "build_py", "--build-lib", str(target)]
        command += ["egg_info", "--egg-base", str(target)]
    else:
        pytest.skip("setuptools is not installed: pip install 'setuptools>=77'")
    target.mkdir()
    done = subprocess.run([sys.executable, *command], cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_example_is_short() -> None:
    points = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"]
    # Its heading and one line for each method.
    registration = sum(1 + len(group) for group in points.values())
    source = (EXAMPLE / "src" / "own_estimator" / "__init__.py").read_text()
    assert 20 < code_lines(source) + registration <= MOST_LINES


@nightly
def test_the_example_passes_its_own_tests_once_installed(tmp_path: Path) -> None:
    project, target = tmp_path / "project", tmp_path / "installed"
    shutil.copytree(
        EXAMPLE, project, ignore=shutil.ignore_patterns("__pycache__", ".pytest_cache", "build", "*.egg-info")
    )
    install(project, target)
    # What is tested is what was installed.
    shutil.rmtree(project / "src")
    found = [
        point.value
        for package in metadata.distributions(path=[str(target)])
        for point in package.entry_points
        if point.group == "scenetruth.estimators"
    ]
    assert found == ["own_estimator:OwnEstimator"]
    path = os.pathsep.join(filter(None, [str(target), os.environ.get("PYTHONPATH", "")]))
    # Of the plug-ins that are installed here, users have ours.
    env = {**os.environ, "PYTHONPATH": path, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "scenetruth.testing.pytest_plugin", "--scenetruth-report"]
    done = subprocess.run(command, cwd=project, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "test_own_estimator.py::test_accuracy" in done.stdout.partition("accuracy of estimates")[2]
    (entry,) = (project / ".pytest_cache" / "d" / "scenetruth").iterdir()
    assert entry.name.startswith("recording-")
