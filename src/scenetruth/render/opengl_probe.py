"""Probe script that requests an OpenGL context from a system library and reports the result.

`opengl` runs it in a separate process, because a defective library may abort it. Only the standard library is imported,
for a fast start.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys

ANSWER = "scenetruth: it runs"
"""Output on success."""

_LIBRARIES = {"osmesa": "libOSMesa.so", "egl": "libEGL.so"}
_VERSIONS = ("", *(f".{number}" for number in range(9, -1, -1)))
# Context attributes as in pyrender: RGBA, 24-bit depth, OpenGL 3.3 core profile.
_CONTEXT = (0x22, 0x1908, 0x30, 24, 0x33, 0x34, 0x36, 3, 0x37, 3, 0)
_UNSIGNED_BYTE, _VERSION, _COLOURS = 0x1401, 0x1F02, 0x4000


def _library(platform: str) -> ctypes.CDLL:
    """Load a library by the names used by PyOpenGL."""
    name = _LIBRARIES[platform]
    for version in _VERSIONS:
        try:
            return ctypes.CDLL(name + version, ctypes.RTLD_GLOBAL)
        except OSError as error:
            if "No such file" not in str(error):
                sys.exit(str(error))
    sys.exit(f"library {name} is not installed")


def _osmesa() -> None:
    """Create and use an off-screen context."""
    library = _library("osmesa")
    library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
    library.OSMesaCreateContextAttribs.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    context = library.OSMesaCreateContextAttribs((ctypes.c_int * len(_CONTEXT))(*_CONTEXT), None)
    if not context:
        sys.exit("OpenGL 3.3 is not supported")
    pixels = (ctypes.c_ubyte * 64)()
    library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_int]
    if not library.OSMesaMakeCurrent(context, pixels, _UNSIGNED_BYTE, 4, 4):
        sys.exit("the context cannot be made current")
    library.glGetString.restype = ctypes.c_char_p
    if not library.glGetString(_VERSION):
        sys.exit("the version cannot be read")
    library.glClear(_COLOURS)
    library.glFinish()


def _egl() -> None:
    """Create a context with pyrender, which selects the device."""
    _library("egl")
    code = "import pyrender; pyrender.OffscreenRenderer(4, 4).delete()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        sys.exit(lines[-1] if lines else f"probe process ended with code {done.returncode}")


if __name__ == "__main__":
    {"osmesa": _osmesa, "egl": _egl}[sys.argv[1]]()
    print(ANSWER)
