"""Methods and settings of star 5, and the displacement along the centre row that each finds in two images."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.dic_challenge.images import Image, recording_of
from benchmarks.peers.catalogue import PEERS, python_of

__all__ = ["PROGRAM", "SETTINGS", "Setting", "displacement", "displacement_map", "rows_of_program", "strain_row"]

PROGRAM = "program"
SHIFT_PX = 24
"""Shift of the second image for methods that estimate disparities, which must not change sign."""
_VALID = 2
_ONE_THREAD = {"OMP_WAIT_POLICY": "PASSIVE", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}

Row = NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """One run of a method: a window, a subset or an element.

    Parameters
    ----------
    code
        Row of the table; its value is that of the three settings with the lowest MEI.
    group
        ``built-in``, ``OpenCV`` or ``program``.
    size_px
        Standard deviation of a Gaussian window, side of a subset, or side of an element.
    method
        Name of a method, or of one of the programs of `benchmarks.peers`.
    shape
        Shape functions of a program of subsets.
    settings
        Settings of the method.
    """

    code: str
    group: str
    size_px: float
    method: str
    shape: str = ""
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Name of its files."""
        return f"{self.code.replace(', ', '_').replace(' ', '_')}_{self.size_px:g}"


def displacement(setting: Setting, first: Image, second: Image) -> Row:
    """Return the displacement along y in the centre row, px; NaN where the method has none.

    Parameters
    ----------
    setting
        A method of scenetruth.
    first, second
        Both images, of 8 bits.
    """
    found = displacement_map(setting, first, second)
    return np.asarray(found[found.shape[0] // 2])


def displacement_map(setting: Setting, first: Image, second: Image) -> Row:
    """Return the displacement along y of all pixels, px; NaN where the method has none."""
    if setting.method in _OF_DISPARITY:
        return _of_disparity(setting, first, second)
    found = st.estimate(recording_of(first, second), setting.method, setting.settings).sel(t=0)
    flow = found["flow"].isel(image_component=1).values.astype(np.float64)
    return np.where(found["status"].values == _VALID, flow, np.nan)


def strain_row(displacements: Row, window_px: int) -> Row:
    """Return ∂v/∂y in the centre row: the slope of the plane through a square window of a map of displacements."""
    centre, half = displacements.shape[0] // 2, window_px // 2
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    slopes = offsets @ displacements[centre - half : centre + half + 1] / (offsets @ offsets)
    found = np.full(slopes.size, np.nan)
    found[half : slopes.size - half] = np.convolve(slopes, np.ones(window_px) / window_px, "valid")
    return found


_OF_DISPARITY = ("plane_sweep", "opencv_stereo")


def _of_disparity(setting: Setting, first: Image, second: Image) -> Row:
    """Return what a method of two cameras finds: images turned by 90°, the second moved by whole pixels.

    A point that moves down by v lies at x - d in the turned second image, with the disparity d = `SHIFT_PX` - v.
    """
    turned = np.rint(np.stack([first.T, np.roll(second.T, -SHIFT_PX, axis=1)])[:, None]).astype(np.uint8)
    recording = st.make_recording(turned, focal_length_px=5000.0, baseline_mm=1.0)
    found = st.estimate(recording, setting.method, setting.settings)
    found = found.isel(t=0) if "t" in found.dims else found
    disparity = found["disparity"].values.astype(np.float64)
    return np.asarray(np.where(found["status"].values == _VALID, SHIFT_PX - disparity, np.nan).T)


def rows_of_program(program: str, jobs: Sequence[tuple[Setting, Path, Path]], peers: Path, more: int = 0) -> str:
    """Let a program match several settings; return what it said.

    Parameters
    ----------
    program
        Name of the program in `benchmarks.peers.catalogue`.
    jobs
        Setting, file of two images, and file of the row.
    peers
        Folder with the environments of the programs.
    more
        Rows above and below the centre row that are matched as well: the files hold maps then.
    """
    peer = PEERS[program]
    job_file: dict[str, Any] = {
        "program": peer.program,
        "jobs": [
            {
                "images": str(images.absolute()),
                "output": str(row.absolute()),
                "size": one.size_px,
                "shape": one.shape,
                "rows": more,
            }
            for one, images, row in jobs
        ],
    }
    with tempfile.TemporaryDirectory(prefix="star5-") as work:
        file = Path(work) / "jobs.json"
        file.write_text(json.dumps(job_file), encoding="utf-8")
        ended = subprocess.run(
            [str(python_of(peers, peer.environment)), str(Path(__file__).with_name("rows.py")), str(file)],
            cwd=work,
            env={**os.environ, **_ONE_THREAD},
            capture_output=True,
            text=True,
        )
    return ended.stderr


def _settings() -> Iterator[Setting]:
    for sigma in (2, 3, 4, 6, 8):
        window = {"window_sigma_px": sigma, "window_taps_px": 2 * round(2 * sigma) + 1}
        yield Setting("structure tensor", "built-in", sigma, "structure_tensor", settings=window)
    for sigma in (4, 6, 8):
        yield Setting("refined", "built-in", sigma, "refined", settings={"window_sigma_px": sigma})
        # The image moves as a rigid whole within a window: shape functions of order zero.
        window = {"window_sigma_px": sigma, "motion": "translation"}
        yield Setting("refined, translation", "built-in", sigma, "refined", settings=window)
    sweep = {"disparity_px": (SHIFT_PX - 4, SHIFT_PX + 4)}
    yield Setting("plane sweep", "built-in", 1, "plane_sweep", settings=sweep)
    for side in (9, 13, 17, 25):
        yield Setting("OpenCV Farnebäck", "OpenCV", side, "opencv_flow", settings={"flow_window_px": side})
    yield Setting("OpenCV DIS", "OpenCV", 8, "opencv_flow", settings={"flow": "dis"})
    for side in (9, 13, 17, 21, 25, 29, 33, 41, 49):
        yield Setting("pyvale, affine", PROGRAM, side, "pyvale", "AFFINE")
        yield Setting("pyvale, quadratic", PROGRAM, side, "pyvale", "QUAD")
    for side in (17, 21, 25, 33):
        yield Setting("SUN-DIC, affine", PROGRAM, side, "sun_dic", "Affine")
        yield Setting("SUN-DIC, quadratic", PROGRAM, side, "sun_dic", "Quadratic")
    for side in (8, 12, 16, 24):
        yield Setting("pyxel, Q4", PROGRAM, side, "pyxel")
        yield Setting("muDIC, Q4", PROGRAM, side, "mudic")


SETTINGS: dict[str, Setting] = {setting.key: setting for setting in _settings()}
"""All settings, by the name of their files."""
