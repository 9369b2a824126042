"""Selection of an OpenGL platform that runs without a display."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from scenetruth.errors import BackendUnavailableError
from scenetruth.render.opengl_probe import ANSWER

__all__ = ["PLATFORMS", "REMEDIES", "use_platform"]

PLATFORMS = ("osmesa", "egl")
"""Platforms in the order in which they are tried."""

REMEDIES = {
    "osmesa": "install the system library OSMesa (Debian, Ubuntu: apt-get install libosmesa6)",
    "egl": "install an EGL driver (Debian, Ubuntu: apt-get install libegl1 libegl-mesa0)",
}
"""What makes a platform run."""
_NO_PACKAGE = "pip install 'scenetruth[opengl]'"

_PACKAGES = ("pyrender", "OpenGL")
# The question is asked in a process of its own, as a library that cannot start may abort it.
_PROBE = Path(__file__).with_name("opengl_probe.py")


def use_platform(wanted: str) -> str:
    """Choose the OpenGL platform of this process."""
    loaded = os.environ.get("PYOPENGL_PLATFORM") if "OpenGL" in sys.modules else None
    if loaded in PLATFORMS:
        # PyOpenGL cannot change its platform within a process.
        if wanted not in ("auto", loaded):
            raise BackendUnavailableError(
                f"pyrender ({wanted})",
                f"this process already uses OpenGL through {loaded}",
                "use a process of its own for each platform",
            )
        return loaded
    failures = []
    for platform in PLATFORMS if wanted == "auto" else (wanted,):
        reason = _why_not(platform)
        if reason is None:
            os.environ["PYOPENGL_PLATFORM"] = platform
            return platform
        failures.append((platform, reason))
    if all("No module named" in reason for _, reason in failures):
        raise BackendUnavailableError("pyrender", failures[0][1], _NO_PACKAGE)
    raise BackendUnavailableError(
        f"pyrender ({', '.join(platform for platform, _ in failures)})",
        "; ".join(f"{platform}: {reason}" for platform, reason in failures),
        ", or ".join(REMEDIES[platform] for platform, _ in failures),
    )


@cache
def _why_not(platform: str) -> str | None:
    """Return why a platform does not run, or None if it does."""
    for package in _PACKAGES:
        if find_spec(package) is None:
            return f"No module named '{package}'"
    environment = {**os.environ, "PYOPENGL_PLATFORM": platform}
    # Alone: without the packages of the environment, and without this folder, whose modules have names of Python's own.
    command = [sys.executable, "-I", "-S", str(_PROBE), platform]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    except subprocess.TimeoutExpired:
        return "it did not start within 60 s"
    if ANSWER in done.stdout:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"its test process ended with code {done.returncode}"
