"""The worked example of a leaf in the wind: its scene at another time and rate is the same leaf in the same motion."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.scene.built_scene import build_scene

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def example() -> Iterator[Any]:
    spec = importlib.util.spec_from_file_location(
        "wind_sway", ROOT / "docs" / "results" / "worked_examples" / "wind_sway.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Data classes look their module up.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_other_beginnings_and_rates_are_the_same_motion(example: Any) -> None:
    own = build_scene(st.load_scene(example.FILE), ROOT, painted=False).bodies[0]
    start_s, rate_hz = 37.3, 12.5
    moved = build_scene(example.windy(start_s, rate_hz), ROOT, painted=False).bodies[0]
    for later_s in (0.0, 0.31):
        # Float64 keeps sums of some hundred mm, and phases of some hundred turns, to 1e-12 and better.
        expected = own.positions_at((start_s + later_s) * 50)
        assert np.allclose(moved.positions_at(later_s * rate_hz), expected, rtol=0, atol=1e-9)


def test_plans_with_harmonics_find_the_drift_of_a_steady_sway(example: Any) -> None:
    sway = np.array([0, 0, 1.5, -2.0, 0.3, 0.1, 0.4, 0.6])[:, None]
    harmonics = example.Plan(at_random=True, periods_s=example.ALL_PERIODS_S, burst=True)
    # Unit noise of 31 depths of 0.08 mm over 30 minutes: 0.08 / (√31 · 9 min) is 0.0016 mm/min.
    assert example.tried(sway, 30, True, harmonics) < 2 * 0.0016
    assert example.tried(sway, 30, True, example.Plan()) > 3 * 0.0016
