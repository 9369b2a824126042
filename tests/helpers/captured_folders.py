"""Folders of simulated images, as a camera on a stage leaves them: moving texture, darks, flats, static frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from scenetruth.camera import EmvaSensor, LinearImage
from scenetruth.camera.sensor import OpenSensor
from scenetruth.random_streams import generator_for

__all__ = ["CapturedFolder", "fall_off", "read", "store", "texture", "write_capture"]

DISPARITY_PX, FLOW_PX = 3.3, 0.4


@dataclass
class CapturedFolder:
    """A folder with its truth: the sensor, and the names of the images by (s, t)."""

    folder: Path
    sensor: EmvaSensor
    plain: dict[str, Any]
    names: dict[tuple[int, int], str] = field(default_factory=dict)

    def write(self) -> Path:
        """Write the capture file again, after changes of its values."""
        file = self.folder / "capture.yaml"
        file.write_text(yaml.safe_dump(self.plain), encoding="utf-8")
        return file

    def frames(self, name: str) -> list[Path]:
        """Return the files of a set, in order."""
        return sorted((self.folder / name).glob("*.tif"))


def texture(shape: tuple[int, int], seed: int, wavelength_px: float = 6.0) -> NDArray[np.float64]:
    """Return smooth noise of mean 0.45 and standard deviation 0.13, at least 0.04."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), wavelength_px / 4, mode="wrap")
    return np.asarray(np.clip(0.45 + 0.13 * noise / noise.std(), 0.04, 0.9))


def fall_off(shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the light of the flat fields, which falls off by 20 % in the corners."""
    y, x = np.indices(shape)
    return np.asarray(1 - 0.4 * ((x / shape[1] - 0.5) ** 2 + (y / shape[0] - 0.5) ** 2))


def write_capture(
    folder: Path,
    seed: int = 0,
    *,
    preset: str = "industrial_cmos",
    shape: tuple[int, int] = (72, 96),
    positions: int = 5,
    frames: int = 5,
    sets: Sequence[str] = ("dark", "flat", "static"),
    count: int = 8,
    exposure: float = 1.0,
    **fields: Any,
) -> CapturedFolder:
    """Write a capture folder.

    ``exposure``: Factor of the light in all images.
    ``fields``: Fields of the sensor instead of those of the preset.
    """
    sensor = EmvaSensor.model_validate({"kind": "emva1288", "preset": preset, **fields})
    opened = sensor.chain().open(shape, lambda *key: generator_for(seed, *key))
    height, width = shape
    surface = texture((height + 20, width + 80), seed)
    y, x = np.mgrid[:height, :width].astype(float)

    def seen(s: float, t: float) -> NDArray[np.float64]:
        return np.asarray(
            map_coordinates(surface, [y + 10 + 0.2 * t, x + 40 + DISPARITY_PX * s + FLOW_PX * t], order=3, mode="wrap")
        )

    plain: dict[str, Any] = {
        "camera": {
            "width": width,
            "height": height,
            "bit_depth": max(sensor.bit_depth, 8),
            "black_level_dn": sensor.black_level_dn,
            "exposure_time_s": sensor.exposure_time_s,
            "focal_length_px": 1000.0,
        },
        "stage": {"positions": positions, "baseline_mm": 2.0},
        "frames": {"count": frames, "frame_interval_s": 10.0},
        "files": {"images": "images/s{s:+d}_t{t:03d}.tif"},
    }
    made = CapturedFolder(folder, sensor, plain)
    for s in range(-((positions - 1) // 2), positions // 2 + 1):
        for t in range(frames):
            name = f"images/s{s:+d}_t{t:03d}.tif"
            made.names[s, t] = name
            store(folder / name, read(opened, exposure * seen(s, t - (frames - 1) // 2), s, t))
    if "dark" in sets:
        plain["files"]["dark"] = "dark/*.tif"
        for n in range(count):
            store(folder / f"dark/dark{n:02d}.tif", read(opened, np.zeros(shape), 101, n))
    if "flat" in sets:
        plain["files"] |= {"flat": "flat/e{level}_*.tif"}
        plain["files"]["exposure_times_s"] = [sensor.exposure_time_s / 2, sensor.exposure_time_s]
        for level, share in enumerate((0.35, 0.7)):
            for n in range(count):
                store(folder / f"flat/e{level}_{n:02d}.tif", read(opened, share * fall_off(shape), 102 + level, n))
    if "static" in sets:
        plain["files"]["static"] = "static/*.tif"
        for n in range(count):
            store(folder / f"static/n{n:02d}.tif", read(opened, exposure * seen(0, 0), 110, n))
    made.write()
    return made


def read(opened: OpenSensor, radiance: NDArray[np.float64], s: int, t: int) -> NDArray[Any]:
    """Return the digital numbers of a radiance; each pair (s, t) has its own noise."""
    return np.asarray(opened.read(LinearImage(radiance.astype(np.float32), s=s, t=t)))


def store(file: Path, values: NDArray[Any], **more: Any) -> None:
    """Write a TIFF file, and create its folder."""
    file.parent.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(file, values, **more)
