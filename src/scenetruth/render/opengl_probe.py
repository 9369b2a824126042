"""Requests an OpenGL context from a system library and reports the result.

`opengl` runs it as a script in a separate process.

A library that cannot start may abort the process. Nothing but ctypes is imported: a twentieth of a second.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys

ANSWER = "scenetruth: it runs"
"""What is printed if it does."""

_LIBRARIES = {"osmesa": "libOSMesa.so", "egl": "libEGL.so"}
_VERSIONS = ("", *(f".{number}" for number in range(9, -1, -1)))
# As pyrender asks for it: format RGBA, 24 bits of depth, the core profile of OpenGL 3.3.
_CONTEXT = (0x22, 0x1908, 0x30, 24, 0x33, 0x34, 0x36, 3, 0x37, 3, 0)
_UNSIGNED_BYTE, _VERSION, _COLOURS = 0x1401, 0x1F02, 0x4000


def _library(platform: str) -> ctypes.CDLL:
    """Load a library by the names under which PyOpenGL looks for it."""
    name = _LIBRARIES[platform]
    for version in _VERSIONS:
        try:
            return ctypes.CDLL(name + version, ctypes.RTLD_GLOBAL)
        except OSError as error:
            if "No such file" not in str(error):
                sys.exit(str(error))
    sys.exit(f"there is no library {name}")


def _osmesa() -> None:
    """Make a context in memory, and use it."""
    library = _library("osmesa")
    library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
    library.OSMesaCreateContextAttribs.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    context = library.OSMesaCreateContextAttribs((ctypes.c_int * len(_CONTEXT))(*_CONTEXT), None)
    if not context:
        sys.exit("it has no OpenGL 3.3")
    pixels = (ctypes.c_ubyte * 64)()
    library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_int]
    if not library.OSMesaMakeCurrent(context, pixels, _UNSIGNED_BYTE, 4, 4):
        sys.exit("its context cannot be used")
    library.glGetString.restype = ctypes.c_char_p
    if not library.glGetString(_VERSION):
        sys.exit("it tells no version")
    library.glClear(_COLOURS)
    library.glFinish()


def _egl() -> None:
    """Let pyrender make a context if there is a library at all: which device it takes is its own business."""
    _library("egl")
    code = "import pyrender; pyrender.OffscreenRenderer(4, 4).delete()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        sys.exit(lines[-1] if lines else f"its test process ended with code {done.returncode}")


if __name__ == "__main__":
    {"osmesa": _osmesa, "egl": _egl}[sys.argv[1]]()
    print(ANSWER)
