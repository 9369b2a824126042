"""The backend that a scene asks for, or the next one that runs here."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.raycast import ShadowCaster
from scenetruth.render import choose_renderer, opengl
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from tests.helpers.nightly import by_night, nightly
from tests.helpers.scenes import SCENES, cube


@pytest.fixture
def no_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that no OpenGL platform starts, and that this process has not loaded any."""
    monkeypatch.setattr(opengl, "_why_not", lambda platform: f"no {platform} here")
    monkeypatch.setattr(opengl, "is_installed", lambda: True)
    monkeypatch.delitem(sys.modules, "OpenGL", raising=False)


@pytest.mark.usefixtures("no_opengl")
def test_auto_falls_back_to_raycast_and_says_why() -> None:
    scene = cube(render={"backend": "auto"})
    choice = choose_renderer(scene, build_scene(scene))
    assert choice.renderer.name == "raycast"
    assert "osmesa: no osmesa here; egl: no egl here" in choice.fallback_reason
    assert "libosmesa6" in choice.fallback_reason


@pytest.mark.usefixtures("no_opengl")
def test_pyrender_by_name_is_an_error_that_names_the_remedy() -> None:
    scene = cube(render={"backend": "pyrender"})
    with pytest.raises(BackendUnavailableError, match="libosmesa6") as caught:
        choose_renderer(scene, build_scene(scene))
    assert caught.value.backend == "pyrender (osmesa, egl)"


def test_auto_takes_egl_where_osmesa_does_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "_why_not", lambda platform: "missing" if platform == "osmesa" else None)
    monkeypatch.delitem(sys.modules, "OpenGL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "before")
    assert opengl.use_platform("auto") == "egl"
    assert os.environ["PYOPENGL_PLATFORM"] == "egl"


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "_why_not", lambda _: "ModuleNotFoundError: No module named 'pyrender'")
    monkeypatch.delitem(sys.modules, "OpenGL", raising=False)
    with pytest.raises(BackendUnavailableError, match=r"pip install 'scenetruth\[opengl\]'"):
        opengl.use_platform("auto")


def test_ray_casting_without_the_opengl_extra_is_no_fallback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "find_spec", lambda _: None)
    for name in ("OpenGL", "pyrender"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    scene = cube(render={"backend": "auto"})
    choice = choose_renderer(scene, build_scene(scene))
    assert (choice.renderer.name, choice.fallback_reason) == ("raycast", "")
    scene = cube(render={"backend": "pyrender"})
    opengl._why_not.cache_clear()
    with pytest.raises(BackendUnavailableError, match=r"pip install 'scenetruth\[opengl\]'"):
        choose_renderer(scene, build_scene(scene))
    opengl._why_not.cache_clear()


def test_raycast_never_loads_opengl() -> None:
    code = (
        "import sys, scenetruth as st\n"
        f"scene = st.load_scene({str(SCENES / 'plaid.yaml')!r}, overrides=['frames.count=1', 'stage.positions=2'])\n"
        "recording, truth = st.simulate(scene)\n"
        "print(recording.attrs['render_backend'], 'OpenGL' in sys.modules, 'pyrender' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["raycast", "False", "False"]


@nightly
@pytest.mark.parametrize("platform", ["osmesa", *by_night(*sorted({*opengl.PLATFORMS} - {"osmesa"}))])
def test_each_platform_renders_the_cube_where_it_runs(platform: str) -> None:
    scene = cube(
        frames={"count": 1},
        stage={"positions": 1, "baseline_mm": 5.0},
        render={"backend": "pyrender", "platform": platform, "supersampling": 2},
    )
    code = (
        "import json, sys, scenetruth as st\n"
        "from scenetruth.render import opengl\n"
        f"reason = opengl._why_not({platform!r})\n"
        "if reason is not None:\n"
        "    sys.exit(print('not here:', reason))\n"
        "recording, truth = st.simulate(st.Scene.from_dict(json.loads(sys.stdin.read())))\n"
        "image = recording.image.values\n"
        "print(recording.attrs['render_backend'], image.max() > 0.7, 0.1 < image.mean() < 0.5)"
    )
    given = json.dumps(scene.to_dict())
    done = subprocess.run([sys.executable, "-c", code], input=given, capture_output=True, text=True, check=True)
    if done.stdout.startswith("not here:"):
        pytest.skip(f"{platform}: {done.stdout}")
    assert done.stdout.split() == ["pyrender", f"({platform})", "True", "True"]


def test_a_library_that_is_missing_broken_or_deadly_is_told_and_harmless(tmp_path: Path) -> None:
    script = opengl._PROBE.read_text()
    for spoiled, expected, code in (
        (script.replace("libOSMesa.so", "libNowhere.so"), "library libNowhere.so is not installed", 1),
        (script.replace("library.glFinish()", "os.abort()").replace("import sys", "import os, sys"), "", -6),
        (script.replace("36, 3, 0x37, 3, 0)", "36, 9, 0x37, 9, 0)"), "OpenGL 3.3 is not supported", 1),
    ):
        assert spoiled != script
        file = tmp_path / "probe.py"
        file.write_text(spoiled)
        done = subprocess.run([sys.executable, "-I", "-S", file, "osmesa"], capture_output=True, text=True, check=False)
        if "library libOSMesa.so is not installed" in done.stderr:
            pytest.skip("OSMesa is not installed")
        assert (done.stdout, done.stderr.strip(), done.returncode) == ("", expected, code)
        opengl._why_not.cache_clear()
        with patch.object(opengl, "_PROBE", file):
            assert opengl._why_not("osmesa") == (expected or "probe process ended with code -6")
        opengl._why_not.cache_clear()


def test_packages_that_do_not_fit_together_are_no_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    from scenetruth.render import pyrender_backend

    def broken(*_: object) -> None:
        raise AttributeError("module 'numpy' has no attribute 'infty'")

    monkeypatch.setattr(opengl, "_why_not", lambda _: None)
    monkeypatch.setattr(opengl, "is_installed", lambda: True)
    monkeypatch.setattr(pyrender_backend, "_Drawing", broken)
    scene = cube(render={"backend": "auto"})
    choice = choose_renderer(scene, build_scene(scene))
    assert choice.renderer.name == "raycast"
    assert "has no attribute 'infty'" in choice.fallback_reason


def test_threads_share_the_surfaces_of_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    sheet = {"name": "sheet", "mesh": {"kind": "plane", "size_mm": [20, 20]}, "texture": {"kind": "uniform"}}
    walls = [wall | {"pose": {"position_mm": [0, 0, 100]}}, sheet | {"pose": {"position_mm": [0, 0, 80]}}]
    lamp = {"kind": "directional", "direction": [0.4, 0.2, 1], "irradiance": 0.8}
    scene = Scene.from_dict(
        {
            "camera": {"width": 40, "height": 30, "focal_length_px": 60},
            "stage": {"positions": 3, "baseline_mm": 5},
            "frames": {"count": 1},
            "objects": walls,
            "lighting": {"ambient": 0.1, "lights": [lamp]},
        }
    )
    world, viewpoints = build_scene(scene), [Viewpoint.on_axis(x) for x in (0.0, 5.0, 10.0)]
    alone = [choose_renderer(scene, world).renderer.render(0.0, each) for each in viewpoints]
    found: list[object] = []
    search = ShadowCaster._find_shadows

    def counted(self: ShadowCaster, to_light: NDArray[np.float64]) -> object:
        found.append(self)
        return search(self, to_light)

    monkeypatch.setattr(ShadowCaster, "_find_shadows", counted)
    choice = choose_renderer(scene, world)
    assert choice.another is not None
    renderers = [choice.renderer, choice.another(), choice.another()]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda pair: pair[0].render(0.0, pair[1]), zip(renderers, viewpoints, strict=True)))
    assert len(found) == 1
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)
