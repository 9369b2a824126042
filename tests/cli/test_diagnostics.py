"""What the doctor finds, and what of it keeps scenes from being run."""

from __future__ import annotations

import importlib.metadata
import io
import json
import os
import sys
from pathlib import Path
from unittest import mock

import pytest

from scenetruth.cli import diagnostics as renderers
from scenetruth.cli.diagnostics import (
    EXTRAS,
    DoctorCheck,
    check_caches,
    check_extras,
    check_machine,
    check_packages,
    check_rendering,
    check_terminal,
    is_fit,
    print_checks,
    render_alone,
)
from tests.helpers.command_line import scenetruth

WORKS = dict.fromkeys(renderers.RENDERERS, (True, "drawn"))


def states(findings: list[DoctorCheck]) -> dict[str, str]:
    return {one.name: one.state for one in findings}


def test_a_triangle_is_ray_cast_in_a_process_of_its_own() -> None:
    works, told = render_alone("raycast")
    assert works, told
    assert told == f"embreex {importlib.metadata.version('embreex')}"


def test_missing_packages_and_processes_that_die_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with mock.patch.object(renderers, "find_spec", return_value=None):
        assert render_alone("egl") == (False, "No module named 'pyrender'")
    script = tmp_path / "script.py"
    monkeypatch.setattr(renderers, "_SCRIPT", script)
    script.write_text("import os\nos.abort()\n")
    assert render_alone("raycast") == (False, "its process ended with code -6")
    script.write_text("import sys\nsys.exit('no driver\\nno device')\n")
    assert render_alone("raycast") == (False, "no device")
    script.write_text("print('something else')\n")
    assert not render_alone("raycast")[0]


def test_only_ray_casting_is_needed() -> None:
    findings = check_rendering(WORKS)
    assert set(states(findings).values()) == {"ok"}
    assert "OpenGL leaves light, gloss, bands and lens distortion to it" in findings[0].message
    one_less = check_rendering({**WORKS, "egl": (False, "no driver")})
    assert states(one_less)["pyrender (egl)"] == "missing"
    assert [one.remedy for one in one_less] == ["", "", ""]
    none = {"osmesa": (False, "no library"), "egl": (False, "No module named 'pyrender'")}
    findings = check_rendering({**WORKS, **none})
    assert is_fit(findings)
    assert "libosmesa6" in findings[1].remedy
    assert findings[2].remedy == "pip install 'scenetruth[opengl]'"
    findings = check_rendering({**WORKS, "raycast": (False, "No module named 'embreex'")})
    assert not is_fit(findings)
    assert findings[0].remedy


def test_renderers_that_are_not_installed_are_optional(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is wrong with an installation without OpenGL."""
    nothing = dict.fromkeys(("osmesa", "egl"), (False, "No module named 'pyrender'"))
    findings = check_rendering({**WORKS, **nothing})
    assert findings[1].message == "not installed; not required: raycast renders all scenes"
    print_checks(findings)
    shown = "".join(capsys.readouterr())
    assert shown.count("optional") == 2
    assert "missing" not in shown
    assert "scenes can be run" in shown
    # Ray casting is needed, and Python's packages are.
    print_checks(check_rendering({**WORKS, "raycast": (False, "No module named 'embreex'")}))
    assert "broken" in "".join(capsys.readouterr())


def test_packages_that_are_missing_or_old_are_named_with_the_command_that_installs_them() -> None:
    assert set(states(check_packages()).values()) == {"ok"}
    installed = importlib.metadata.version
    told = {"typer": "0.1", "h5py": "0.1"}

    def version(name: str) -> str:
        if name in ("scipy", "optuna"):
            raise importlib.metadata.PackageNotFoundError(name)
        return told.get(name) or installed(name)

    with mock.patch.object(importlib.metadata, "version", version):
        packages, extras = check_packages(), {one.name: one for one in check_extras()}
    assert not is_fit(packages)
    assert states(packages) == {"needed": "broken", "scipy": "broken", "typer": "broken"}
    assert packages[1].message == "scipy is not installed"
    assert packages[1].remedy.startswith("pip install 'scipy>=")
    assert "typer 0.1 is installed, but >=" in packages[2].message
    assert set(extras) == set(EXTRAS)
    assert extras["design"].state == extras["formats"].state == "missing"
    assert "h5py 0.1" in extras["formats"].message
    assert extras["design"].remedy == "pip install 'scenetruth[design]'"
    assert is_fit(list(extras.values()))


def test_extras_are_those_that_there_are_for_users() -> None:
    offered = importlib.metadata.metadata("scenetruth").get_all("Provides-Extra") or []
    assert set(EXTRAS) == set(offered) - {"all", "test", "rivals", "docs"}


def test_caches_are_told_with_what_is_in_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tag = f"py{sys.version_info.major}{sys.version_info.minor}"
    code, textures = tmp_path / "room" / "__pycache__", tmp_path / "textures"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("SCENETRUTH_CACHE", str(textures))
    empty = check_caches()
    assert states(empty) == {"compiled code": "missing", "textures": "ok"}
    assert "precompile" in empty[0].remedy
    for folder in (code, textures):
        folder.mkdir(parents=True)
    (code / f"kernels.first-1.{tag}.nbi").touch()
    (code / f"kernels.first-1.{tag}.1.nbc").write_bytes(bytes(2_000_000))
    (code / f"later.second-1.{tag}.nbi").touch()
    (textures / "noise-1.entry").write_bytes(bytes(3_000_000))
    # A module that was changed since it was compiled.
    (tmp_path / "room" / "later.py").touch()
    os.utime(code / f"later.second-1.{tag}.nbi", (0, 0))
    found = check_caches()
    assert found[0].message == f"{tmp_path}: 1 kernels, 2 MB"
    assert found[1].message == f"{textures}: 1 entries, 3 MB"
    monkeypatch.setenv("SCENETRUTH_CACHE", "off")
    assert "off" in check_caches()[1].message
    monkeypatch.setenv("SCENETRUTH_CACHE", "/proc/nothing")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/dev/null/nothing")
    assert states(check_caches()) == {"compiled code": "broken", "textures": "broken"}


def test_a_machine_with_little_left_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCENETRUTH_CACHE", "off")
    assert states(check_machine())["processors"] == "ok"
    with mock.patch("scenetruth.resources.system.free_disk_bytes", return_value=10_000_000):
        disk = next(one for one in check_machine() if one.name == "disk")
    assert disk.state == "missing"
    assert disk.message.startswith("0.0 GB free at ")
    assert disk.remedy


@pytest.mark.parametrize(("encoding", "state"), [("utf-8", "ok"), ("ascii", "missing")])
def test_terminals_without_all_characters_are_told(encoding: str, state: str) -> None:
    with mock.patch.object(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding=encoding)):
        found = check_terminal()
    assert found.state == state
    assert encoding in found.message


def test_everything_in_json_and_as_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    def rendered(name: str) -> tuple[bool, str]:
        return name == "raycast", "of [this] test"

    monkeypatch.setattr("scenetruth.cli.diagnostics.render_alone", rendered)
    done = scenetruth("doctor", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["fit"] is True
    assert {one["group"] for one in content["findings"]} == {
        *("python", "packages", "rendering", "machine", "caches", "extras", "terminal")
    }
    assert {"numba", "numpy", "scenetruth"} <= set(content["packages"])
    table = scenetruth("doctor")
    assert "scenes can be run" in table.stdout
    assert "of [this] test; not required" in table.stdout
    monkeypatch.setattr("scenetruth.cli.diagnostics.render_alone", lambda name: (False, "broken"))
    done = scenetruth("doctor")
    assert done.returncode == 2
    assert "scenes cannot be run" in done.stdout
