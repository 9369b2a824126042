"""Whether images can be rendered: by ray casting, and by OpenGL on each of its platforms."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from scenetruth.cli.doctor.finding import Finding
from scenetruth.cli.doctor.tiny_render import ANSWER

__all__ = ["RENDERERS", "look_at_rendering", "render_alone"]

RENDERERS = ("osmesa", "egl", "raycast")
"""What renders: platforms of OpenGL, and ray casting."""

_SCRIPT = Path(__file__).with_name("tiny_render.py")
_MOST_S = 20
_NEEDED_PACKAGES = {"raycast": ("embreex",), "osmesa": ("pyrender", "OpenGL"), "egl": ("pyrender", "OpenGL")}


def render_alone(name: str) -> tuple[bool, str]:
    """Render a triangle in a process of its own.

    Parameters
    ----------
    name
        One of `RENDERERS`.

    Returns
    -------
    tuple
        Whether it is there, and what rendered it; or why it is not.
    """
    for package in _NEEDED_PACKAGES[name]:
        if find_spec(package) is None:
            return False, f"No module named '{package}'"
    # -P: without this folder, whose modules may have names of other packages.
    command = [sys.executable, "-P", str(_SCRIPT), name]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_MOST_S, check=False)
    except subprocess.TimeoutExpired:
        return False, f"it did not render within {_MOST_S} s"
    lines = [line.strip() for line in done.stdout.splitlines() if line.startswith(ANSWER)]
    if done.returncode == 0 and lines:
        return True, lines[-1].removeprefix(ANSWER).strip()
    errors = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return False, errors[-1] if errors else f"its process ended with code {done.returncode}"


def look_at_rendering(answers: Mapping[str, tuple[bool, str]]) -> list[Finding]:
    """Return what renders here, of what `render_alone` says of each renderer."""
    rendered, told = answers["raycast"]
    remedy = "" if rendered else "pip install --force-reinstall embreex"
    found = [Finding("rendering", "raycast", "ok" if rendered else "broken", told, remedy, needed=True)]
    opengl = [platform for platform in RENDERERS if platform != "raycast"]
    for platform in opengl:
        rendered, told = answers[platform]
        others = [other for other in opengl if other != platform and answers[other][0]]
        if not rendered:
            told += f"; not needed, as {others[0]} runs" if others else "; not needed, as raycast renders all scenes"
        remedy = "" if rendered or others else _remedy(platform, told)
        name = f"pyrender ({platform})"
        found.append(Finding("rendering", name, "ok" if rendered else "missing", told, remedy))
    return found


def _remedy(platform: str, told: str) -> str:
    from scenetruth.render.opengl import REMEDIES

    return "pip install 'scenetruth[opengl]'" if told.startswith("No module named") else REMEDIES[platform]
