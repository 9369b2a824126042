"""Shape of the reference pair of the Stereo-DIC Challenge 1.0: ``python -m benchmarks.dic_challenge.stereo``.

pyvale brings the reference images of both cameras and its calibration of them; there is no moved image, so that shape
alone can be measured. The cameras differ (focal length, principal point, lens) and enclose 26°, which the calibration
of a linear stage cannot represent: it has one camera that is moved. Both images are therefore resampled to parallel
axes here, and the second is moved by whole pixels, because the disparity is 5,000 px. Angles are θ about X, φ about Y,
ψ about Z, in this order: of the orders of three angles, this one leaves 0.02 px between matched features and their
epipolar lines.

A window of the specimen around the middle of pyvale's region is compared, at the points of pyvale, along Z of camera 0.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

import scenetruth as st
from benchmarks.dic_challenge.__main__ import FOLDER, PEERS_FOLDER, data_of_pyvale
from benchmarks.jobs import heading, line
from benchmarks.peers.catalogue import python_of

CENTRE_PX, SIZE_PX = (1300.0, 1000.0), (640, 480)
"""Middle of the compared part in the image of camera 0, and its size."""
SUBSET_PX, STEP_PX = 27, 5
MARGIN_PX = 40
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "plane sweep": ("plane_sweep", {}),
    "structure tensor, 8 px": ("structure_tensor", {"window_sigma_px": 8, "window_taps_px": 33}),
    "refined, 8 px": ("refined", {"window_sigma_px": 8}),
    "OpenCV SGBM": ("opencv_stereo", {}),
}
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A camera of the pair: matrix with skew, lens, and rotation from the frame of camera 0."""

    matrix: Array
    lens: Array
    rotation: Array

    def pixels(self, directions: Array) -> Array:
        """Return the pixels of directions in the frame of camera 0, shape (..., 2)."""
        inside = directions @ self.rotation.T
        x, y = inside[..., 0] / inside[..., 2], inside[..., 1] / inside[..., 2]
        k1, k2, p1, p2, k3 = self.lens
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        bent = (
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        )
        return np.stack(
            [
                self.matrix[0, 0] * bent[0] + self.matrix[0, 1] * bent[1] + self.matrix[0, 2],
                self.matrix[1, 1] * bent[1] + self.matrix[1, 2],
            ],
            axis=-1,
        )

    def directions(self, pixels: Array) -> Array:
        """Return the directions of pixels in the frame of camera 0, of unit depth in the own frame, by iteration."""
        y = (pixels[..., 1] - self.matrix[1, 2]) / self.matrix[1, 1]
        x = (pixels[..., 0] - self.matrix[0, 2] - self.matrix[0, 1] * y) / self.matrix[0, 0]
        found = np.stack([x, y, np.ones_like(x)], axis=-1) @ self.rotation
        for _ in range(20):
            off = pixels - self.pixels(found)
            inside = found @ self.rotation.T
            inside[..., 0] += off[..., 0] / self.matrix[0, 0]
            inside[..., 1] += off[..., 1] / self.matrix[1, 1]
            found = inside @ self.rotation
        return np.asarray(found)


@dataclass(frozen=True)
class Rig:
    """Both cameras, the axes of the parallel ones as columns in the frame of camera 0, and the baseline."""

    cameras: tuple[Camera, Camera]
    axes: Array
    baseline_mm: float
    focal_px: float


def rig_of(file: Path) -> Rig:
    """Return the rig of a file of pyvale."""
    with file.open(encoding="utf-8") as opened:
        values = {name: float(value) for name, value in csv.reader(opened)}
    turn = Rotation.from_euler("xyz", [values[f"{name}_deg"] for name in ("theta", "phi", "psi")], degrees=True)
    rotations = (np.eye(3), turn.as_matrix())
    cameras = []
    for name, rotation in zip(("cam0", "cam1"), rotations, strict=True):
        fx, fy, fs, cx, cy = (values[f"{name}_{part}_px"] for part in ("fx", "fy", "fs", "cx", "cy"))
        lens = np.array([values[f"{name}_{part}"] for part in ("k1", "k2", "p1", "p2", "k3")])
        cameras.append(Camera(np.array([[fx, fs, cx], [0, fy, cy], [0, 0, 1]]), lens, rotation))
    centre = -rotations[1].T @ np.array([values[f"t{axis}_mm"] for axis in "xyz"])
    x = centre / np.linalg.norm(centre)
    forward = np.array([0.0, 0.0, 1.0]) + rotations[1][2]
    z = forward - (forward @ x) * x
    z /= np.linalg.norm(z)
    focal_px = float(np.mean([camera.matrix[0, 0] for camera in cameras]))
    return Rig(
        (cameras[0], cameras[1]), np.column_stack([x, np.cross(z, x), z]), float(np.linalg.norm(centre)), focal_px
    )


def resampled(image: Array, camera: Camera, rig: Rig, origin: tuple[int, int], size: tuple[int, int]) -> Array:
    """Return a part of the image of the parallel camera, whose principal point is pixel (0, 0)."""
    columns, rows = np.meshgrid(np.arange(size[0]) + origin[0], np.arange(size[1]) + origin[1])
    rays = np.stack([columns, rows, np.full(columns.shape, rig.focal_px)], axis=-1).astype(np.float64) @ rig.axes.T
    places = camera.pixels(rays).astype(np.float32)
    return cv2.remap(image.astype(np.float32), places[..., 0], places[..., 1], cv2.INTER_LANCZOS4)


def parallel_pixels(pixels: Array, rig: Rig) -> Array:
    """Return the pixels of the parallel camera 0 for pixels of camera 0."""
    rays = rig.cameras[0].directions(pixels) @ rig.axes
    return np.asarray(rig.focal_px * rays[..., :2] / rays[..., 2:])


def depth_of(disparity_px: Array, pixels: Array, rig: Rig) -> Array:
    """Return Z in the frame of camera 0 of pixels of the parallel camera 0, mm."""
    rays = np.concatenate([pixels, np.full((*pixels.shape[:-1], 1), rig.focal_px)], axis=-1)
    return np.asarray((rays @ rig.axes.T)[..., 2] * rig.baseline_mm / disparity_px)


def shift_between(first: Array, second: Array) -> int:
    """Return by how many columns the middle of the first image is moved in the second, by normalised correlation."""
    half = 60
    middle = (first.shape[0] // 2, first.shape[1] // 2)
    patch = first[middle[0] - half : middle[0] + half, middle[1] - half : middle[1] + half].astype(np.float32)
    score = cv2.matchTemplate(second.astype(np.float32), patch, cv2.TM_CCOEFF_NORMED)
    return int(np.unravel_index(int(np.argmax(score)), score.shape)[1]) - (middle[1] - half)


def points_of_pyvale(data: Path, folder: Path, peers: Path) -> dict[str, Array]:
    """Return pixels of camera 0 and X, Y, Z of the points of pyvale in its frame, mm."""
    file = folder / "stereo_pyvale.npz"
    if not file.exists():
        left, top = (int(middle - size / 2) for middle, size in zip(CENTRE_PX, SIZE_PX, strict=True))
        job = {"data": str(data), "output": str(file.absolute()), "box": [left, top, *SIZE_PX]}
        job |= {"subset": SUBSET_PX, "step": STEP_PX}
        program = Path(__file__).with_name("stereo_pyvale.py")
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
        words = [str(python_of(peers, "pyvale")), str(program), json.dumps(job)]
        subprocess.run(words, check=True, env=environment, cwd=folder)
    return dict(np.load(file))


def main() -> None:
    """Measure, and print the differences from pyvale."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--peers", type=Path, default=PEERS_FOLDER)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.folder.mkdir(parents=True, exist_ok=True)
    data = data_of_pyvale(given.peers).parents[1]
    rig = rig_of(data / "dic_ex10_dic_chal_calibration.txt")
    files = [data / "dic" / "stereo_challenge" / f"Step01_00,00-sys1-0000_{camera}.tif" for camera in (0, 1)]
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE).astype(np.float64) for file in files]
    middle = np.rint(parallel_pixels(np.array(CENTRE_PX), rig)).astype(int)
    origin = (int(middle[0]) - SIZE_PX[0] // 2, int(middle[1]) - SIZE_PX[1] // 2)
    first = resampled(images[0], rig.cameras[0], rig, origin, SIZE_PX)
    # Where both optical axes come closest.
    across = float(rig.cameras[1].rotation[2] @ rig.axes[:, 0])
    expected = int(rig.focal_px * (abs(rig.axes[2, 0]) + abs(across)))
    wide = 1200
    strip = (origin[0] - expected - wide, origin[1])
    second = resampled(images[1], rig.cameras[1], rig, strip, (SIZE_PX[0] + 2 * wide, SIZE_PX[1]))
    moved = origin[0] - strip[0] - shift_between(first, second)
    # Disparities remain positive over the part.
    shift = moved - MARGIN_PX
    second = resampled(images[1], rig.cameras[1], rig, (origin[0] - shift, origin[1]), SIZE_PX)
    recording = st.make_recording(
        np.stack([first, second])[:, None].astype(np.float32) / 255, focal_length_px=rig.focal_px, baseline_mm=1.0
    )
    found = points_of_pyvale(data, given.folder, given.peers)
    pixels = parallel_pixels(np.stack([found["x_px"], found["y_px"]], axis=-1), rig)
    places = (pixels - np.array(origin))[..., ::-1].T
    rows = [["pyvale", len(found["z_mm"]), "", "", "", f"{np.median(found['z_mm']):.2f}"]]
    for name, (method, settings) in METHODS.items():
        started = time.process_time()
        estimate = st.estimate(recording, method, settings)
        estimate = estimate.isel(t=0) if "t" in estimate.dims else estimate
        known = estimate["status"].values == 2
        disparity = np.where(known, estimate["disparity"].values, np.nan) + shift
        at_points = map_coordinates(disparity, places, order=1, cval=np.nan)
        off = depth_of(at_points, pixels, rig) - found["z_mm"]
        inside = np.isfinite(off)
        off = off[inside]
        plane = np.column_stack([np.ones(off.size), pixels[inside]])
        flat = off - plane @ np.linalg.lstsq(plane, off, rcond=None)[0]
        cells = [
            name,
            off.size,
            *(f"{value * 1e3:.1f}" for value in (np.median(off), off.std(), np.median(np.abs(flat)))),
        ]
        rows.append([*cells, ""])
        print(f"{name}: {time.process_time() - started:.1f} s", file=sys.stderr, flush=True)
    columns = ("method", "points", "median Z - pyvale, µm", "std, µm", "median without plane, µm", "median Z, mm")
    print(heading(columns))
    for cells in rows:
        print(line(cells))


if __name__ == "__main__":
    main()
