"""Recording and truth of the scene that formats are tried with, and what exports them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import scenetruth as st
from scenetruth.exporters import ExportResult, ExportSource
from tests.helpers.exported_scene import Export, scene


@pytest.fixture(scope="session")
def recording_and_truth() -> tuple[xr.Dataset, xr.Dataset]:
    return st.simulate(scene(), truth_views="all", truth_content="complete")


@pytest.fixture(scope="session")
def recording(recording_and_truth: tuple[xr.Dataset, xr.Dataset]) -> xr.Dataset:
    return recording_and_truth[0]


@pytest.fixture(scope="session")
def truth(recording_and_truth: tuple[xr.Dataset, xr.Dataset]) -> xr.Dataset:
    return recording_and_truth[1]


@pytest.fixture(scope="session")
def source(recording: xr.Dataset, truth: xr.Dataset) -> ExportSource:
    return ExportSource(recording, truth)


@pytest.fixture
def export(recording: xr.Dataset, truth: xr.Dataset, tmp_path: Path) -> Export:
    """Write the scene in a format, into a folder of that name."""

    def write(format: str, **options: Any) -> ExportResult:
        return st.export((recording, truth), format, output=tmp_path / format, **options)

    return write
