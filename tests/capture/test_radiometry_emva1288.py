"""Photon transfer against the package emva1288, the reference implementation of the standard, on the same frames."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from scenetruth.camera import EmvaSensor, LinearImage, build_sensor_chain
from scenetruth.capture import measure_noise
from scenetruth.random_streams import generator_for

Frames = NDArray[np.uint16]

SHAPE, COUNT, PAIR = (240, 320), 16, 2


def frames_of(preset: str, shares: Sequence[float]) -> tuple[list[Frames], float]:
    """Return frames of a sensor at shares of its saturation, and its full scale."""
    chain = build_sensor_chain(EmvaSensor.model_validate({"kind": "emva1288", "preset": preset}))
    sensor = chain.open(SHAPE, partial(generator_for, 5, "sensor"))
    found = []
    for level, share in enumerate(shares):
        light = np.full(SHAPE, share * chain.saturation_radiance, dtype=np.float32)
        stack = [sensor.read(LinearImage(light, 0, 0, 100 * level + n)) for n in range(COUNT)]
        found.append(np.array(stack, dtype=np.uint16))
    return found, chain.full_scale


def evaluate(folder: Path, dark: Frames, flat: Frames, bright: Frames) -> Any:
    """Return the results of the package; the brightest level is only that of saturation."""
    process = pytest.importorskip("emva1288.process", reason="needs emva1288: pip install emva1288")
    names: dict[float, list[str]] = {}
    for photons, stack in ((0.0, dark), (1000.0, flat), (1500.0, bright)):
        names[photons] = [f"{photons:.0f}_{n}.tif" for n in range(COUNT)]
        for name, frame in zip(names[photons], stack, strict=True):
            tifffile.imwrite(folder / name, frame)
    temporal = {photons: each[:PAIR] for photons, each in names.items()}
    spatial = {photons: names[photons] for photons in (0.0, 1000.0)}
    images = {"temporal": {1e7: temporal}, "spatial": {1e7: spatial}}
    quiet = {"loglevel": logging.ERROR}
    loaded = process.LoadImageData(images, path=str(folder), fload=tifffile.imread, **quiet)
    return process.Results1288(process.Data1288(loaded.data, **quiet).data, index_u_ysat=1, **quiet)


@pytest.mark.parametrize("preset", ["scientific_cmos", "industrial_cmos", "ccd_2002"])
def test_gain_and_noise_are_those_of_the_reference_implementation(
    preset: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same frames: what remains are a smooth field of degree 4, and the variance of the means of frames."""
    # Release 1.0.2 was written for NumPy 1.
    monkeypatch.setattr(np, "asfarray", partial(np.asarray, dtype=np.float64), raising=False)
    (dark, flat, bright), full = frames_of(preset, (0.0, 0.5, 0.75))
    theirs = evaluate(tmp_path, dark, flat, bright)
    pair, every = (measure_noise(dark[:n], flat[:n], full_scale=full) for n in (PAIR, COUNT))
    found = {
        "gain": pair.gain_dn_per_e / theirs.K,
        "dark noise": pair.temporal_dark_noise_e / theirs.sigma_d,
        "DSNU": every.dsnu_e * every.gain_dn_per_e / theirs.DSNU1288_DN(),
        "PRNU": 100 * every.prnu / theirs.PRNU1288,
    }
    assert found == pytest.approx(dict.fromkeys(found, 1.0), abs=2e-4)
