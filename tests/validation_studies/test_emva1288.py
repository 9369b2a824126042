"""A virtual EMVA 1288 measurement gives back what the sensors were nominal to be."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from typer.testing import CliRunner

import scenetruth as st
from scenetruth.camera import PRESETS, EmvaSensor, PhotonTransfer
from scenetruth.cli.app import app
from scenetruth.validation_studies import emva1288 as emva
from scenetruth.validation_studies.emva1288 import compare_with_settings, measure_sensor, run_emva
from tests.helpers.nightly import by_night, nightly
from tests.helpers.sensors import NOISY_SENSOR

# What a measurement must recover. Scatter, as one standard error with 300 x 400 pixels: gain 0.1 %, spatial standard
# deviations 0.2 % to 0.4 %, saturation as the gain, a level's mean 0.01 %.
BOUNDS = {
    "gain_dn_per_e": 0.01,
    "temporal_dark_noise_e": 0.03,
    "dsnu_e": 0.03,
    "prnu": 0.03,
    "quantum_efficiency": 0.01,
    "saturation_capacity_e": 0.01,
    "linearity_error": 0.001,
}
# One more, whose dark current has more time to add electrons.
NOISY = NOISY_SENSOR | {"exposure_time_s": 0.1}
SENSORS: dict[str, dict[str, Any]] = {**{name: {"preset": name} for name in PRESETS}, "noisy": NOISY}
BY_DAY = ["noisy"]


DOCS = Path(__file__).parents[2] / "docs" / "results" / "emva1288.md"


def made(name: str, **changes: Any) -> EmvaSensor:
    return EmvaSensor.model_validate({"kind": "emva1288", **SENSORS[name], **changes})


@cache
def measured(name: str) -> PhotonTransfer:
    return measure_sensor(made(name), name=name)


@pytest.mark.parametrize("name", [*BY_DAY, *by_night(*sorted({*SENSORS} - {*BY_DAY}))])
def test_measured_as_told(name: str) -> None:
    sensor, found = made(name), measured(name)
    errors = {one.quantity: abs(one.error) for one in compare_with_settings(name, sensor, found)}
    assert set(errors) == set(BOUNDS)
    assert {quantity: error for quantity, error in errors.items() if error > BOUNDS[quantity]} == {}
    dark_e = sensor.dark_current_e_per_s * sensor.exposure_time_s
    # Standard error of the mean of 16 images each, with the patterns the same in both.
    noise = np.sqrt(2 * (sensor.temporal_dark_noise_e**2 + dark_e) / (16 * 300 * 400))
    assert found.dark_e == pytest.approx(dark_e, rel=0.01, abs=5 * noise)


@nightly
def test_the_page_has_these_measurements() -> None:
    rows = [line.strip("| \n").split(" | ") for line in DOCS.read_text(encoding="utf-8").splitlines()]
    table = {row[0].strip("`"): row[1:] for row in rows if row[0].strip("`") in BOUNDS and len(row) == 5}
    assert list(table) == list(BOUNDS)
    for column, name in enumerate(PRESETS):
        for one in compare_with_settings(name, made(name), measured(name)):
            if one.quantity != "linearity_error":
                assert float(table[one.quantity][column].split()[0]) == pytest.approx(one.measured, rel=1e-4)


@pytest.mark.parametrize("name", PRESETS)
def test_full_well_shows_at_half_the_gain(name: str) -> None:
    # Where the converter ends before the full well does, less gain brings the full well into its range.
    sensor = made(name, gain_dn_per_e=made(name).gain_dn_per_e / 2)
    found = measure_sensor(sensor, shape=(200, 300), levels=12, stack=2, name=f"well/{name}")
    assert found.saturation_e == pytest.approx(sensor.full_well_e, rel=0.01)


def test_gamma_and_filters_are_left_out() -> None:
    plain, dressed = (
        measure_sensor(made("ccd_2002", **extra), shape=(60, 80), levels=8, stack=2)
        for extra in ({}, {"gamma": 0.5, "bayer": "rggb"})
    )
    assert plain.gain_dn_per_e == dressed.gain_dn_per_e
    np.testing.assert_array_equal(plain.mean_dn, dressed.mean_dn)


def test_the_command_writes_tables_and_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emva.measure_sensor, "__kwdefaults__", {"shape": (60, 80), "levels": 8, "stack": 3, "name": ""})
    result = CliRunner().invoke(
        app, ["validation", "emva1288", "-o", str(tmp_path / "out"), "--preset", "industrial_cmos"]
    )
    assert result.exit_code == 0, result.output
    with (tmp_path / "out" / "emva.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["quantity"] for row in rows] == list(BOUNDS)
    assert {row["sensor"] for row in rows} == {"industrial_cmos"}
    assert float(rows[0]["nominal"]) == PRESETS["industrial_cmos"].values["gain_dn_per_e"]
    with (tmp_path / "out" / "emva_levels.csv").open() as stream:
        assert len(list(csv.reader(stream))) == 1 + 8 + 5
    picture = imageio.imread(tmp_path / "out" / "industrial_cmos.png")
    assert picture.shape[1] > 1000
    assert picture.std() > 10


def test_unknown_presets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(st.SceneError, match=r"--preset: no such preset; available: scientific_cmos, .*'nikon'"):
        run_emva(tmp_path / "out", ["nikon"])
    assert not (tmp_path / "out").exists()
