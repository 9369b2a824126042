"""Board images of a capture in linear light, with the variance of the noise of every pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration import BoardImage, Observations, estimate_gain_spread, estimate_noise
from scenetruth.capture.corrections import FixedPatternCorrection
from scenetruth.capture.file_patterns import MatchedFile
from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.measured_noise import sensor_noise
from scenetruth.capture.radiometry import SensorNoise
from scenetruth.number_format import format_two_digits
from scenetruth.progress import Progress, say

__all__ = ["BoardReader", "in_camera_pixels"]

Floats = NDArray[np.float64]

_MOST_SATURATED = 0.01  # share of the pixels of an image
_SATURATED_VARIANCE = 1e3  # in squares of full scale: saturated pixels have no weight
_SPREAD_IMAGES = 6


def in_camera_pixels(given: Observations, folder: CaptureFolder) -> Observations:
    """Return points of images of one colour of a mosaic in pixels of the camera."""
    pixels, camera = folder.images.pixels, folder.capture.camera
    if pixels.step == 1:
        return given
    row, column = pixels.offset
    views = tuple(
        replace(
            view,
            pixels=pixels.step * view.pixels + np.array([column, row]),
            covariance_px2=pixels.step**2 * view.covariance_px2,
        )
        for view in given.views
    )
    return replace(given, width=camera.width, height=camera.height, views=views)


@dataclass(eq=False)
class BoardReader:
    """Reads board images in linear light, with the variance of the noise of every pixel.

    ``saturated``: Share of saturated pixels of images with more of them than usual.
    ``gain_spread``: Standard deviation of the gains of the pixels where no flat field corrects them.
    """

    folder: CaptureFolder
    correction: FixedPatternCorrection | None
    noise: SensorNoise | None
    progress: Progress | None
    saturated: dict[str, float]
    gain_spread: float = 0.0
    _variance: Floats | None = None

    @classmethod
    def open(cls, folder: CaptureFolder, progress: Progress | None) -> BoardReader:
        """Return a reader with the measured noise, if there is one."""
        linear = folder.images.pixels.encoding == "linear"
        noise = sensor_noise(folder) if linear else None
        known = noise is not None and bool(np.isfinite([noise.gain_dn_per_e, noise.dark_noise_dn]).all())
        reader = cls(folder, folder.correction(), noise if known else None, progress, {})
        if known and "flat" not in folder.sets:
            reader.gain_spread = reader.measure_gain_spread()
            share = f"the gains of the pixels differ by {format_two_digits(100 * reader.gain_spread)} %"
            say(f"files.flat: not stated; {share}, which adds to the noise of the corners")
        return reader

    def measure_gain_spread(self) -> float:
        """Return the standard deviation of the gains of the pixels, the median over some board images."""
        names = list(self.folder.board.values())
        dark, found = self.folder.black(), []
        for name in names[:: -(-len(names) // _SPREAD_IMAGES)]:
            values = self.folder.images.read(MatchedFile(name, {})).astype(np.float64)
            if values.ndim != 2:
                return 0.0
            variance = self._noise_variance(values, dark, np.ones(values.shape))
            found.append(estimate_gain_spread(values - dark, variance))
        return float(np.median(found))

    def board_image(
        self, name: str, position: int, pose: int, visit: int, task: str = "detect boards", total: int | None = None
    ) -> BoardImage:
        """Return an image that is read when it is analysed."""
        count = len(self.folder.board) if total is None else total
        done = visit if total is None else visit - len(self.folder.board)

        def read() -> Floats:
            if self.progress is not None:
                self.progress(task, min(done, count), count)
            image, self._variance = self._read(name)
            return image

        def variance() -> Floats:
            assert self._variance is not None  # the image is read before
            return self._variance

        return BoardImage(read, position, pose, visit, name=name, direction=0, variance=variance)

    def _read(self, name: str) -> tuple[Floats, Floats]:
        values = self.folder.images.read(MatchedFile(name, {})).astype(np.float64)
        full = self.folder.images.pixels.full_scale
        dark, gain = self.folder.black(), np.ones(values.shape)
        if self.correction is not None and self.correction.flat is not None:
            light = self.correction.flat - dark
            gain = light.mean(axis=(0, 1)) / np.where(light > 0, light, np.nan)
        image = (values - dark) * gain
        saturated = np.asarray(values >= full)
        if self.correction is not None and self.correction.defects is not None:
            image[self.correction.defects] = np.nan
        if image.ndim == 3:
            image, saturated = image.mean(axis=-1), np.asarray(saturated.any(axis=-1))
        share = float(saturated.mean())
        if share > _MOST_SATURATED:
            self.saturated[name] = share
        variance = self._noise_variance(values, dark, gain) if self.noise is not None and values.ndim == 2 else None
        if variance is None:
            least = np.mean(gain[np.isfinite(gain)] ** 2) / 12
            variance = np.full(image.shape, max(estimate_noise(image) ** 2, float(least)))
        variance[saturated] = _SATURATED_VARIANCE * full**2
        return image, np.nan_to_num(variance, nan=_SATURATED_VARIANCE * full**2)

    def _noise_variance(self, values: Floats, dark: Floats, gain: Floats) -> Floats:
        """Return the variance of a corrected image: its noise, that of the mean dark frame, and of the flat field."""
        assert self.noise is not None
        still = max(self.noise.dark_noise_dn**2, 1 / 12)
        signal = np.maximum(values - dark, 0.0)
        variance = self.noise.gain_dn_per_e * signal + still + (self.gain_spread * signal) ** 2
        if self.folder.dark is not None:
            variance += still / self.folder.dark.count
        level = self.folder.flat_level()
        if self.correction is not None and self.correction.flat is not None and level is not None:
            light = self.correction.flat - dark
            bright = self.noise.gain_dn_per_e * np.maximum(light, 0.0) + still
            variance += bright / self.folder.sets["flat"].moments(level).count * (signal / np.maximum(light, 1e-9)) ** 2
        return np.asarray(gain**2 * variance)
