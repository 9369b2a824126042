"""The plug-in of pytest: pictures and a table of what assertions found, recordings that stay from run to run."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import pytest

from scenetruth.testing.recording_cache import RecordingCache
from tests.helpers.cached_scene import SMALL
from tests.helpers.nightly import nightly
from tests.helpers.synthetic_case import make_case

pytest_plugins = ["pytester"]

# Where scenetruth was installed before it had the entry point, pytest does not find the plug-in by itself.
LOADED = bool(metadata.entry_points(group="pytest11", name="scenetruth"))
PLUGIN = [] if LOADED else ["-p", "scenetruth.testing.pytest_plugin"]

ASSERTIONS = """
import numpy as np
from scenetruth.schema import Intrinsics, label
from scenetruth.testing import assert_accuracy

CAMERA = Intrinsics(focal_length_px=1000.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
ONE, STILL = np.ones((1, 24, 32)), np.zeros((3, 1, 24, 32))
MAPS = {"depth": 500 * ONE, "disparity": 10 * ONE, "velocity": STILL, "flow": STILL[:2], "mixed": ONE == 0}
TRUTH = label("truth", MAPS, CAMERA, t=[0])
ESTIMATE = label("estimate", {"depth": 500.1 * ONE}, CAMERA, t=[0])


def test_kept():
    assert_accuracy(ESTIMATE, TRUTH, depth_mm={"rmse": 0.2, "bias": 0.4})


def test_broken():
    assert_accuracy(ESTIMATE, TRUTH, check_conventions=False, depth_mm=0.05)


def test_lacking():
    assert_accuracy(ESTIMATE, TRUTH, check_conventions=False, velocity_z_mm=1.0)
"""
RECORDINGS = f"""
import pytest
import scenetruth as st
from scenetruth.testing import assert_accuracy

SCENE = {SMALL!r}


@pytest.mark.parametrize("number", range(2))
@pytest.mark.filterwarnings("ignore:objects")
def test_recording(scenetruth_recording, number):
    made = scenetruth_recording(SCENE)
    estimate = st.make_estimate(recording=made.recording, depth=made.truth.depth.values + 0.5)
    assert_accuracy(estimate, made.truth, made.recording, region="all", depth_mm=0.6)
"""


@pytest.fixture(scope="module", autouse=True)
def ready(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Import what runs inside of this process need: libraries cannot be imported twice, and pytester forgets them."""
    from scenetruth.testing.accuracy import draw_differences

    folder = tmp_path_factory.mktemp("ready")
    RecordingCache(folder, folder)(SMALL)
    case = make_case(40, 30, 300.0)
    assert draw_differences(case.estimate, case.truth, None, ["depth"], folder)


def test_pictures_of_what_fails_go_to_the_folder_of_the_test(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(ASSERTIONS)
    result = pytester.runpytest(*PLUGIN, "-k", "test_kept or test_broken")
    result.assert_outcomes(passed=1, failed=1, deselected=1)
    result.stdout.fnmatch_lines(["*1 of 1 limit broken*", "*BROKEN  depth*"])
    files = {Path(line.split()[-1]) for line in result.outlines if line.endswith("depth.png")}
    assert {(file.parent.name, file.exists()) for file in files} == {("pictures", True)}
    assert {file.parents[1].name for file in files} == {"test_broken0"}
    # The line that is shown is the test's own.
    assert not any("assertion.py" in line for line in result.outlines)
    assert "accuracy of estimates" not in result.stdout.str()


def test_the_folder_is_that_of_the_fixture(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
from scenetruth.testing.assertion_context import get_context


def test_folder(scenetruth_pictures, tmp_path):
    assert get_context().pictures() == scenetruth_pictures
    assert tmp_path in scenetruth_pictures.parents


def test_that_asks_for_nothing(request):
    base = request.config._tmp_path_factory.getbasetemp()
    assert not any("asks_for_nothing" in folder.name for folder in base.iterdir())
"""
    )
    pytester.runpytest(*PLUGIN).assert_outcomes(passed=2)


def test_the_table_has_every_limit_of_the_run(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_own=ASSERTIONS)
    result = pytester.runpytest(*PLUGIN, "--scenetruth-report", "-k", "test_kept or test_lacking")
    result.assert_outcomes(passed=1, failed=1, deselected=1)
    result.stdout.fnmatch_lines(
        [
            "test                       region    quantity    statistic  found                limit          times",
            "test_own.py::test_kept *  depth       rmse       0.1 mm               <= 0.2 mm      0.5 x",
            "test_own.py::test_kept *  depth       bias       0.1 mm               <= 0.4 mm      0.25 x",
            "test_own.py::test_lacking  interior  velocity_z  rmse  *not in the estimate  <= 1 mm/frame  -  *BROKEN",
        ],
        consecutive=True,
    )


def test_a_table_of_nothing_says_so(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_nothing(): pass")
    result = pytester.runpytest(*PLUGIN, "--scenetruth-report")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["assert_accuracy was not called"])


def kept(pytester: pytest.Pytester) -> set[tuple[str, int]]:
    """The entries of the cache, with the numbers of their files, which change when an entry is made again."""
    folder = pytester.path / ".pytest_cache" / "d" / "scenetruth"
    return {(entry.name, entry.stat().st_ino) for entry in folder.iterdir()} if folder.is_dir() else set()


@nightly
def test_recordings_stay_until_they_are_cleared(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(RECORDINGS)
    pytester.runpytest(*PLUGIN).assert_outcomes(passed=2)
    first = kept(pytester)
    assert len(first) == 1
    pytester.runpytest(*PLUGIN).assert_outcomes(passed=2)
    assert kept(pytester) == first
    other = pytester.path / ".pytest_cache" / "d" / "scenetruth" / "other"
    other.mkdir()
    pytester.runpytest(*PLUGIN, "--scenetruth-clear", "-k", "nothing").assert_outcomes(deselected=2)
    assert {name for name, _ in kept(pytester)} == {"other"}
    pytester.runpytest(*PLUGIN).assert_outcomes(passed=2)
    assert {name for name, _ in kept(pytester)} == {"other", *(name for name, _ in first)}


def test_without_a_cache_recordings_are_made_for_the_run(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(RECORDINGS)
    pytester.runpytest(*PLUGIN, "-p", "no:cacheprovider").assert_outcomes(passed=2)
    assert not (pytester.path / ".pytest_cache").exists()


def test_workers_hand_on_what_they_found(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xdist")
    # Plug-ins of others take longer to import than all else.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    # Taken down as assertions do, without the seconds that importing them takes in other processes.
    pytester.makepyfile(
        test_own="""
from scenetruth.testing.assertion_context import get_context


def test_noted():
    row = {"quantity": "depth", "statistic": "rmse", "region": "all", "found": "1 mm", "limit": "<= 2 mm"}
    get_context().note([{**row, "times": 0.5, "kept": True}, {**row, "times": float("inf"), "kept": False}])
"""
    )
    plugins = ("-p", "scenetruth.testing.pytest_plugin", "-p", "xdist")
    result = pytester.runpytest_subprocess(*plugins, "-n", "1", "--scenetruth-report")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(
        [
            "test_own.py::test_noted  all     depth     rmse       1 mm   <= 2 mm  0.5 x",
            "test_own.py::test_noted  all     depth     rmse       1 mm   <= 2 mm  inf x  BROKEN",
        ]
    )
