"""Selection of an OpenGL platform for headless rendering."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from scenetruth.errors import BackendUnavailableError
from scenetruth.render.opengl_probe import ANSWER

__all__ = ["PLATFORMS", "REMEDIES", "is_installed", "use_platform"]

PLATFORMS = ("osmesa", "egl")
"""Platforms in order of preference."""

REMEDIES = {
    "osmesa": "install the system library OSMesa (Debian, Ubuntu: apt-get install libosmesa6)",
    "egl": "install an EGL driver (Debian, Ubuntu: apt-get install libegl1 libegl-mesa0)",
}
"""Installation hint for each platform."""
_NO_PACKAGE = "pip install 'scenetruth[opengl]'"

_PACKAGES = ("pyrender", "OpenGL")
# The probe runs in a separate process, because a defective library may abort it.
_PROBE = Path(__file__).with_name("opengl_probe.py")


def is_installed() -> bool:
    """Return whether the packages of the extra `opengl` are installed; an installation without them is normal."""
    return all(name in sys.modules or find_spec(name) is not None for name in _PACKAGES)


def use_platform(wanted: str) -> str:
    """Select the OpenGL platform of this process and return its name."""
    loaded = os.environ.get("PYOPENGL_PLATFORM") if "OpenGL" in sys.modules else None
    if loaded in PLATFORMS:
        # PyOpenGL cannot change its platform within a process.
        if wanted not in ("auto", loaded):
            raise BackendUnavailableError(
                f"pyrender ({wanted})",
                f"this process already uses OpenGL through {loaded}",
                "use a separate process for each platform",
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
    """Return the reason why a platform is not available, or None."""
    for package in _PACKAGES:
        if find_spec(package) is None:
            return f"No module named '{package}'"
    environment = {**os.environ, "PYOPENGL_PLATFORM": platform}
    # Isolated from installed packages and from this directory, whose module names shadow the standard library.
    command = [sys.executable, "-I", "-S", str(_PROBE), platform]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    except subprocess.TimeoutExpired:
        return "no response within 60 s"
    if ANSWER in done.stdout:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"probe process ended with code {done.returncode}"
