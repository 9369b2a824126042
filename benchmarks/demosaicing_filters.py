"""Bias of ``refined`` behind a Bayer filter after different interpolations, as tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.demosaicing_filters``.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.jobs import heading, line
from scenetruth.camera import demosaic, mosaic

Images = NDArray[np.float64]

STEPS, DISPARITY_PX, PATTERN = np.arange(5) - 2, 0.3, "RGGB"
SHAPE, PADDING = (96, 128), 32
COLOURS = {"green": (0.1, 1.0, 0.1), "red": (1.0, 0.05, 0.05), "coloured": (1.0, 0.5, 0.2)}
WAVES_PX = ((5, 7), (6, 12), (12, 24))


def mosaics(waves_px: tuple[float, float], colour: tuple[float, ...], seed: int, noise: float = 0.0) -> Images:
    """Return mosaics of a plane with 24 random waves, shape (5, y, x), with grey values around 0.5."""
    drawn = np.random.default_rng(seed)
    y, x = np.indices(SHAPE).astype(np.float64)
    images = np.zeros((len(STEPS), *SHAPE, 3))
    for _ in range(24):
        k = 2 * np.pi / np.exp(drawn.uniform(*np.log(waves_px)))
        angle, phase = drawn.uniform(0, 2 * np.pi, 2)
        for image, s in zip(images, STEPS, strict=True):
            moved = x + DISPARITY_PX * s
            wave = np.cos(k * (np.cos(angle) * moved + np.sin(angle) * y) + phase)
            image += wave[..., None] * np.array(colour) / np.sqrt(24)
    sampled = np.array([mosaic(0.5 + 0.2 * image, PATTERN) for image in images])
    return sampled + noise * drawn.normal(size=sampled.shape)


def green_alone(sampled: Images) -> Images:
    """Return the green channel from its own samples, by the waves that they determine."""
    mask = np.zeros(SHAPE)
    mask[0::2, 1::2] = mask[1::2, 0::2] = 1.0
    sides = ((0, 0), (PADDING, PADDING), (PADDING, PADDING))
    spectrum = np.fft.fft2(np.pad(2 * (sampled - 0.5) * mask, sides, mode="reflect"))
    down, along = (np.abs(np.fft.fftfreq(size)) for size in spectrum.shape[1:])
    passed = np.clip((0.5 - down[:, None] - along) / 0.08 + 0.5, 0.0, 1.0)
    return np.asarray(np.fft.ifft2(spectrum * passed).real[:, PADDING:-PADDING, PADDING:-PADDING] + 0.5)


def estimated(images: Images, method: str | None, every: int = 1) -> tuple[float, float, float, float]:
    """Return bias and RMSE of the disparity in px, RMS z-score, and the share of valid pixels."""
    attrs: dict[str, Any] = {} if method is None else {"demosaicing": method}
    stage_x_mm = 5.0 * STEPS
    single = images.astype(np.float32)[:, None]
    recording = st.make_recording(single, 1000.0, 5.0, stage_x_mm=stage_x_mm, full_scale=1.0, attrs=attrs)
    settings: dict[str, Any] = {"window_sigma_px": 4 / every, "discontinuity_refit": False, "surface": "plane"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        estimate = st.estimate(recording, "refined", **settings).isel(t=0)
    inner = {"y": slice(14 // every, -14 // every), "x": slice(20 // every, -20 // every)}
    estimate = estimate[["disparity", "disparity_std", "valid"]].isel(inner)
    valid = estimate["valid"].values.astype(bool)
    if not valid.any():
        return float("nan"), float("nan"), float("nan"), 0.0
    error = estimate["disparity"].values[valid] - DISPARITY_PX / every
    z = error / estimate["disparity_std"].values[valid]
    rms = [float(np.sqrt(np.mean(each**2))) for each in (error, z)]
    return every * float(error.mean()), every * rms[0], rms[1], float(valid.mean())


def interpolated(sampled: Images, kind: str) -> tuple[Images, str | None, int]:
    """Return images after an interpolation, the demosaicing that they state, and their distance of pixels."""
    if kind in ("malvar", "bilinear", "binomial"):
        return np.array([demosaic(each, PATTERN, kind) for each in sampled]), kind, 1  # type: ignore[arg-type]
    return (green_alone(sampled), None, 1) if kind == "green samples" else (sampled[:, ::2, ::2], None, 2)


KINDS = ("malvar", "bilinear", "red plane", "green samples", "binomial")


def main() -> None:
    """Print bias without noise, and RMSE and z-score with noise."""
    print(heading(["waves, px", "colour", *KINDS]))
    for colour, values in COLOURS.items():
        for waves in WAVES_PX:
            cells = []
            for kind in KINDS:
                found = [estimated(*interpolated(mosaics(waves, values, seed), kind)) for seed in (1, 2)]
                bias = [1e3 * each[0] for each in found if each[3] > 0]
                cells.append(", ".join(f"{round(each, 1) + 0.0:.1f}" for each in bias) if bias else "no valid pixels")
            print(line([f"{waves[0]} to {waves[1]}", colour, *cells]), flush=True)
    print()
    print(heading(["colour", *KINDS]))
    for colour in ("green", "coloured"):
        cells = []
        for kind in KINDS:
            _, rms, z, valid = estimated(*interpolated(mosaics((6, 12), COLOURS[colour], 3, noise=0.01), kind))
            cells.append(f"{1e3 * rms:.1f}, {z:.2f}, {100 * valid:.0f} %")
        print(line([colour, *cells]), flush=True)


if __name__ == "__main__":
    main()
