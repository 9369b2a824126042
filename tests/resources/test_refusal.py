"""What the machine does not have is refused before any work begins."""

from __future__ import annotations

from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.resources.cost_estimate import Forecast, StageForecast
from scenetruth.resources.enforcement import machine_problems, refuse_resources
from scenetruth.resources.limits import Limits
from scenetruth.resources.system import Machine
from tests.scenes import cube

FORECAST = Forecast({"render": StageForecast(3e9, 5e9, 7200, 8e9), "estimate": StageForecast(6e9, 1e9, 1800, 1e9)})
PLENTY = Machine(100 * 10**9, 100 * 10**9, 2)


def paths(machine: Machine = PLENTY, limits: Limits | None = None) -> list[str]:
    return [problem.path for problem in machine_problems(FORECAST, machine, limits or Limits())]


def test_what_fits_is_let_through_and_what_is_not_known_is_not_refused() -> None:
    refuse_resources(FORECAST, PLENTY, Limits())
    refuse_resources(FORECAST, Machine(None, None, 1), Limits())


def test_all_that_is_too_much_is_told_at_once() -> None:
    small = Machine(5 * 10**9, 8 * 10**9, 2)
    assert paths(small, Limits(hours=2)) == ["memory of estimate", "disk space, with a margin for compression", "time"]
    with pytest.raises(st.MachineError) as caught:
        refuse_resources(FORECAST, small, Limits(hours=2))
    text = str(caught.value)
    for words in ("about 6 GB, limit 5:", "--limit memory_gb=6.3", "2.5 hours", "hours=2.6"):
        assert words in text


def test_who_insists_is_let_through_as_the_message_says() -> None:
    small = Machine(5 * 10**9, 8 * 10**9, 2)
    assert paths(small, Limits(memory_gb=6.3, disk_gb=9.5)) == []
    assert paths(PLENTY, Limits(memory_gb=2)) == ["memory of estimate"]


def test_where_nothing_can_be_written_is_told_and_not_as_lack_of_disk() -> None:
    with pytest.raises(st.MachineError, match=r"output: results cannot be written here: .*\(got '/proc'\)") as caught:
        refuse_resources(FORECAST, Machine(None, None, 2, unwritable="/proc"), Limits())
    assert "disk" not in str(caught.value)
    # A check writes nothing.
    assert paths(Machine(None, None, 2, unwritable="/proc")) == []


def test_a_run_is_refused_before_it_leaves_anything(tmp_path: Path) -> None:
    for limits, what in ((Limits(memory_gb=0.1), "memory of render"), (Limits(hours=1e-6), "time")):
        with pytest.raises(st.MachineError, match=what):
            st.run_scene(cube(), output=tmp_path / "run", stages=("render",), limits=limits)
    with pytest.raises(st.SceneError, match="--limit frames="):
        st.run_scene(cube(), output=tmp_path / "run", limits=Limits(frames=3))
    assert list(tmp_path.iterdir()) == []
