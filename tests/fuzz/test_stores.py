"""Stores that are almost right are read and used, or refused by an error of ours; ``make nightly`` tries a thousand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings

import scenetruth as st
from tests.helpers.fuzzed_stores import KINDS, Damage, broken_stores, damaged, whole_stores
from tests.helpers.guarded_trials import Guarded
from tests.helpers.nightly import by_day, nightly
from tests.helpers.store_trial import STORE_OUTCOMES, try_store


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    whole_stores(folder)
    return folder


@pytest.fixture(scope="module")
def others(whole: Path) -> dict[str, Any]:
    return {kind: st.load_store(whole / f"{kind}.zarr") for kind in KINDS}


def test_whole_stores_are_used(whole: Path, others: dict[str, Any]) -> None:
    assert {try_store(store, others) for store in whole.iterdir()} == {"used"}


@by_day
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(damage=broken_stores())
def test_any_store_is_used_or_refused(
    whole: Path, others: dict[str, Any], tmp_path_factory: pytest.TempPathFactory, damage: Damage
) -> None:
    target = tmp_path_factory.mktemp("broken") / f"store.zarr{'.zip' if damage['zipped'] else ''}"
    damaged(whole, damage, target)
    assert try_store(target, others) in STORE_OUTCOMES


@nightly
def test_a_thousand_stores(guarded_stores: Guarded) -> None:
    @settings(max_examples=1000, suppress_health_check=list(HealthCheck), phases=[Phase.generate], database=None)
    @given(damage=broken_stores())
    def try_all(damage: Damage) -> None:
        guarded_stores.try_file(json.dumps(damage).encode())

    try_all()
    assert not guarded_stores.failures, "\n\n".join(guarded_stores.failures[:5])
