"""Scores and reports of long recordings, a few frames at a time, are those of all frames at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.scoring import alignment
from scenetruth.scoring.figures import iterate_error_samples
from scenetruth.scoring.report import describe_maps
from tests.helpers.synthetic_case import Case, make_case

FRAMES = (-1, 0, 1)
SIZE = (48, 36)


@pytest.fixture(scope="module")
def case() -> Case:
    made = make_case(*SIZE, 400.0, frames=FRAMES)
    rate = xr.full_like(made.truth["depth"], 1e-3).where(np.isfinite(made.truth["depth"]))
    number = xr.zeros_like(made.truth["depth"], dtype=np.int32)
    # The second object comes into view late, the third not at all.
    number[1:, :, 10:30] = 1
    truth = made.truth.assign(growth_rate=rate, object_id=number).assign_attrs(object_names='["one", "two", "three"]')
    return Case(recording=made.recording, estimate=made.estimate, truth=truth)


def in_parts(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    monkeypatch.setattr(alignment, "_PIXELS", frames * SIZE[0] * SIZE[1])


@pytest.mark.parametrize("frames", [1, 2])
def test_scores_are_those_of_all_frames_at_once(case: Case, monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    whole = st.score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": 3})
    in_parts(monkeypatch, frames)
    assert alignment.count_blocks(case.estimate) == -(-len(FRAMES) // frames)
    found = st.score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": 3})
    assert list(found.regions) == list(whole.regions)
    assert "object_two" in whole.regions
    assert "object_three" not in whole.regions
    for region, quantities in whole.regions.items():
        assert list(found.regions[region]) == list(quantities)
        for quantity, values in quantities.items():
            assert_same(found.regions[region][quantity], values)


def assert_same(found: Any, expected: Any) -> None:
    assert list(found) == list(expected)
    few = (expected["count"] or 0) < 200
    for statistic, value in expected.items():
        if statistic in ("median_abs_error", "p95_abs_error") and value is not None:
            # Histograms are right to a bin; few values leave gaps that they know nothing of.
            assert found[statistic] == pytest.approx(value, rel=0.5 if few else 0.05)
        else:
            assert found[statistic] == (value if value is None else pytest.approx(value, rel=1e-12, abs=1e-15))


def test_histograms_hold_every_error_once(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    def gathered() -> dict[tuple[str, str], list[float]]:
        found: dict[tuple[str, str], list[float]] = {}
        for name, samples in iterate_error_samples(case.estimate, case.truth, ("depth", "velocity_epe"), 4.0):
            for region, values in samples.items():
                found.setdefault((name, region), []).extend(values.tolist())
        return found

    whole = gathered()
    in_parts(monkeypatch, 2)
    assert gathered() == whole


def test_maps_are_described_alike(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = describe_maps(case.estimate)
    in_parts(monkeypatch, 2)
    found = describe_maps(case.estimate)
    assert list(found) == list(whole)
    for name, item in whole.items():
        assert (found[name].count, found[name].density) == (item.count, item.density)
        assert found[name].median == pytest.approx(item.median, rel=0.02, abs=1e-3)


def test_stores_are_scored_without_being_loaded(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, dataset in (("recording", case.recording), ("truth", case.truth), ("estimate", case.estimate)):
        st.save_store(dataset, tmp_path / f"{name}.zarr")
    opened = {name: st.open_store(tmp_path / f"{name}.zarr") for name in ("recording", "truth", "estimate")}
    in_parts(monkeypatch, 2)
    whole = st.score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": 3})
    found = st.score(opened["estimate"], opened["truth"], opened["recording"], settings={"interior_margin_px": 3})
    assert found.regions == whole.regions
    most = max(
        (variable.values.nbytes for variable in opened["truth"].variables.values() if variable._in_memory), default=0
    )
    assert most < 1000
