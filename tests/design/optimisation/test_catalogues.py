"""Catalogues: what ships, and files that are wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth.camera.sensor import PRESETS
from scenetruth.design.optimisation import load_catalogues
from scenetruth.errors import DesignSpecError


def test_every_entry_that_ships_has_a_source() -> None:
    entries = load_catalogues()
    for kind in ("lens", "camera", "stage"):
        found = entries.of(kind)
        assert len(found) >= 4
        # Figures are from somewhere, or plainly those of a class.
        for one in found.values():
            assert "typical of its class" in one.source or any(
                word in one.source for word in ("data sheet", "manual", ":")
            )
    assert {one.preset for one in entries.cameras.values() if one.preset} == set(PRESETS)


def test_own_files_add_entries_and_replace_them(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(
        "stages: {mine: {title: My stage, source: measured in 2026, travel_mm: 40, repeatability_um: 0.5,"
        " straightness_um: 1, pitch_urad: 10, yaw_urad: 10, roll_urad: 5, price_eur: 3000}}"
    )
    entries = load_catalogues([file])
    assert entries.stages["mine"].price_eur == 3000
    assert entries.stages["air_bearing"] == load_catalogues().stages["air_bearing"]


def test_missing_units_and_all_else_is_told_at_once(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(
        "lenses: {mine: {title: Mine, source: a sheet, focal_length: 50, least_focus_mm: 300, f_number_least: 8,"
        " f_number_most: 4, image_circle_mm: 11}}\n"
        "cameras: {mine: {title: Mine, source: a sheet, width: 640, height: 480, pixel_pitch_um: 5, full_well_e: 9}}\n"
        "stages: {mine: {title: Mine, source: a sheet, travel_mm: 25 mm, yaw: 3}}\n"
        "lights: {}\n"
    )
    with pytest.raises(DesignSpecError) as caught:
        load_catalogues([file, tmp_path / "none.yaml"])
    told = str(caught.value)
    for expected in (
        "lenses.mine.focal_length: unknown key; did you mean 'focal_length_mm'?",
        "lenses.mine.focal_length_mm: is missing",
        "cameras.mine: requires a preset, or quantum_efficiency, read_noise_e, bit_depth",
        "stages.mine.travel_mm: must be a number without a unit: 25",
        "stages.mine.yaw: unknown key; did you mean 'yaw_urad'?",
        "lights: unknown key",
        "none.yaml: (top level): no such file; specify the path of a catalogue",
    ):
        assert expected in told
