"""Scene files that are almost right give a scene or an error of ours; ``make nightly`` tries ten thousand."""

from __future__ import annotations

from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings

from tests.helpers.fuzzed_scenes import base_trees, scene_files
from tests.helpers.guarded_trials import Guarded
from tests.helpers.nightly import by_day, nightly
from tests.helpers.scene_trial import is_large, try_scene
from tests.helpers.scenes import LIBRARY


def test_all_scenes_of_the_library_are_among_those_that_are_changed() -> None:
    assert len(base_trees()) > len(LIBRARY)


@by_day
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(content=scene_files())
def test_any_file_gives_a_scene_or_an_error_of_ours(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(content)
    assert try_scene(file, smaller=10)


@nightly
def test_ten_thousand_files(guarded: Guarded) -> None:
    # All are tried, whatever becomes of some: those that fail are kept as files.
    @settings(suppress_health_check=list(HealthCheck), phases=[Phase.generate], database=None)
    @given(content=scene_files())
    def try_all(content: bytes) -> None:
        guarded.try_file(content)

    try_all()
    assert not guarded.failures, "\n\n".join(guarded.failures[:5])


def test_small_scenes_are_made_and_others_are_known_to_be_large(tmp_path: Path) -> None:
    import scenetruth as st

    plaid = st.load_scene(LIBRARY[[file.stem for file in LIBRARY].index("plaid")])
    assert not is_large(plaid)
    for change in ({"width": 4000}, {"height": 4000}):
        camera = plaid.camera.model_copy(update=change)
        assert is_large(plaid.model_copy(update={"camera": camera}))
