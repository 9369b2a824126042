"""Methods of others: found by name, validated like ours, and no harm to anyone when they are broken."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import find_method, list_methods
from scenetruth.scene import Scene
from scenetruth.testing import check_estimator
from tests.cli.calling import scenetruth
from tests.estimators.plugins import offer, offer_package
from tests.scenes import cube

TINY = {"camera": {"width": 96, "height": 64, "focal_length_px": 900}, "frames": {"count": 2}}

WORKS = """
import numpy as np
import scenetruth as st
from scenetruth.estimators import Method, MethodSettings

class Flat(Method):
    name = "{name}"
    gives = frozenset({{"depth"}})

    def estimate(self, recording, settings, progress):
        return st.make_estimate(recording=recording, depth=np.full(recording.image.shape[-3:], 500.0))
"""


@pytest.fixture(scope="module")
def data() -> tuple[xr.Dataset, xr.Dataset]:
    return st.simulate(cube(**TINY))


def test_a_plug_in_estimates_and_is_scored_like_ours(
    data: tuple[xr.Dataset, xr.Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer_package("block_matching", tmp_path, monkeypatch)
    recording, truth = data
    estimate = st.estimate(recording, "block_matching", block_px=7, largest_disparity_px=20)
    assert json.loads(estimate.attrs["settings"]) == {"block_px": 7, "largest_disparity_px": 20}
    score = st.score(estimate, truth, recording)
    # To the whole pixel: uniform errors within half a pixel have an rms of 0.29 px.
    assert score.regions["interior"]["disparity"]["rmse"] == pytest.approx(0.29, abs=0.1)
    assert "velocity_z" not in score.regions["interior"]


def test_the_plug_in_keeps_to_the_contract(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offer_package("block_matching", tmp_path, monkeypatch)
    report = check_estimator("block_matching", settings={"block_px": 7, "largest_disparity_px": 20})
    assert not report.failed
    assert len(report.passed) >= 26


def test_settings_of_a_plug_in_are_validated_and_in_the_schema(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offer_package("block_matching", tmp_path, monkeypatch)
    with pytest.raises(
        st.SceneError, match=r"estimate\.block: unknown setting of 'block_matching'; did you mean 'block_"
    ):
        cube(estimate={"method": "block_matching", "block": 3})
    with pytest.raises(
        st.SceneError, match=r"estimate\.block_px: input should be greater than or equal to 1 \(got 0\)"
    ):
        cube(estimate={"method": "block_matching", "block_px": 0})
    variants = Scene.model_json_schema()["$defs"]["MethodChoice"]
    assert "block_matching" in json.dumps(variants)
    assert "Side of the blocks in px, odd." in json.dumps(variants)


def test_the_command_line_lists_a_plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offer_package("block_matching", tmp_path, monkeypatch)
    done = scenetruth("list", "methods", env={**os.environ, "COLUMNS": "150"})
    assert "block_matching" in done.stdout
    assert "block-matching 0.3" in done.stdout


def test_a_broken_plug_in_hurts_nobody_else(
    data: tuple[xr.Dataset, xr.Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(tmp_path, monkeypatch, "crooked", {"crooked": "crooked:Method"}, "raise RuntimeError('no luck today')")
    assert "crooked" in {entry.name for entry in list_methods()}
    assert find_method("structure_tensor").name == "structure_tensor"
    Scene.model_json_schema()
    with pytest.raises(st.EstimateError, match=r"loaded from crooked 1: RuntimeError: no luck today.*'crooked'"):
        st.estimate(data[0], "crooked")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("Flat = 3", r"is not a method: missing name, settings, gives"),
        ("class Flat:\n    name = 'a'\n", "missing settings, gives, needs, requirements, estimate"),
        ("class Flat:\n    def __init__(self, x):\n        pass\n", "cannot be instantiated: TypeError"),
        (
            WORKS.format(name="plug")
            + "    settings = type('S', (MethodSettings,), {'__annotations__': {'method': str, 'progress': int}, "
            "'method': 'x', 'progress': 1})\n",
            "reserved names: method, progress; rename them",
        ),
        (WORKS.format(name="plug") + "    settings = dict\n", "must be a model derived from"),
    ],
)
def test_what_is_not_a_method_is_refused(
    code: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(tmp_path, monkeypatch, f"plug{tmp_path.name}", {"plug": f"plug{tmp_path.name}:Flat"}, code)
    with pytest.raises(st.EstimateError, match=message):
        find_method("plug")


def test_names_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = {"structure_tensor": "takes_ours:Flat", "No-Name": "takes_ours:Flat", "twin": "takes_ours:Flat"}
    offer(tmp_path / "one", monkeypatch, "takes_ours", points, WORKS.format(name="twin"))
    offer(tmp_path / "two", monkeypatch, "other", {"twin": "other:Flat"}, WORKS.format(name="twin"))
    problems = {(entry.name, entry.origin): entry.problem for entry in list_methods() if entry.problem}
    assert "its name is that of a built-in method" in problems["structure_tensor", "takes_ours 1"]
    assert "its name must be lower-case letters" in problems["No-Name", "takes_ours 1"]
    assert "several installed plugins have this name" in problems["twin", "other 1"]
    assert type(find_method("structure_tensor")).__module__.startswith("scenetruth.")
    for name in ("No-Name", "twin"):
        with pytest.raises(st.EstimateError, match=r"its name must be lower-case letters|several installed plugins"):
            find_method(name)


def test_a_plain_function_is_a_method(
    data: tuple[xr.Dataset, xr.Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_methods.py").write_text(
        "import numpy as np\n"
        "def wall(recording, depth_mm: float = 700.0, *, progress=None):\n"
        "    progress('wall', 1, 1)\n"
        "    return {'depth': np.full(recording.image.shape[-3:], depth_mm)}\n"
        "def anything(recording, **settings):\n"
        "    return {}\n"
    )
    monkeypatch.chdir(tmp_path)
    told: list[tuple[str, int, int]] = []
    found = st.estimate(data[0], "my_methods:wall", depth_mm=800, progress=lambda *step: told.append(step))
    assert float(found["depth"].max()) == 800
    assert found.attrs["method"] == "my_methods:wall"
    assert told == [("wall", 1, 1)]
    with pytest.raises(st.EstimateError, match=r"depth_mm: input should be a valid number.*'far'"):
        st.estimate(data[0], "my_methods:wall", depth_mm="far")
    with pytest.raises(st.EstimateError, match="name each setting"):
        st.estimate(data[0], "my_methods:anything")
    with pytest.raises(st.EstimateError, match="cannot be imported as module:function"):
        st.estimate(data[0], "my_methods:nothing")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("slips_of_names.py:wall", "omit .py: slips_of_names:wall "),
        ("part/slips_of_names.py:wall", "omit .py: part.slips_of_names:wall "),
        ("slips_of_names", "specify a function with its module: slips_of_names:FUNCTION "),
        ("part.slips_of_names", "specify a function with its module: part.slips_of_names:FUNCTION "),
        ("slips_of_names.py", "specify a function with its module: slips_of_names:FUNCTION "),
        ("slips_of_nams", "no such method. Installed: "),
        ("a" * 10_000, "no such method. Installed: "),
        ("leaves_at_once:f", "module:function: it called sys.exit\\(3\\)"),
        ("fails_at_once:f", "module:function: ZeroDivisionError: .* \\(fails_at_once.py:2 in <module>\\)"),
    ],
)
def test_files_that_are_named_instead_of_modules(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "part").mkdir()
    (tmp_path / "slips_of_names.py").write_text("")
    (tmp_path / "part" / "slips_of_names.py").write_text("")
    (tmp_path / "leaves_at_once.py").write_text("import sys\nsys.exit(3)\n")
    (tmp_path / "fails_at_once.py").write_text("\n1 / 0\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(st.EstimateError, match=message):
        find_method(name)


def test_a_function_itself_will_do(data: tuple[xr.Dataset, xr.Dataset]) -> None:
    def wall(recording: xr.Dataset, depth_mm: float = 700.0) -> dict[str, np.ndarray]:
        return {"depth": np.full(recording["image"].shape[-3:], depth_mm)}

    assert float(st.estimate(data[0], wall, {"depth_mm": 3.0})["depth"].max()) == 3
