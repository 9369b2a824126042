"""Arguments of simulations that nobody checks at a call."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import scenetruth as st
from tests.scenes import cube


@pytest.mark.parametrize(
    "call", [st.simulate, st.make_truth, partial(st.run_scene, output="nowhere")], ids=["simulate", "truth", "run"]
)
def test_wrong_arguments_are_named_together(
    call: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(st.ArgumentError) as caught:
        call(cube(), truth_views="al", truth_poses=None, truth_content=2, progress=3)
    names = [problem.path for problem in caught.value.problems]
    assert sorted(names) == ["progress", "truth_content", "truth_poses", "truth_views"]
    with pytest.raises(st.ArgumentError, match=r"scene: must be a scene, its values, .* \(got 'int'\)"):
        call(3)
    assert list(tmp_path.iterdir()) == []
