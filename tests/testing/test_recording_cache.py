"""Recordings for tests: made once, kept whole, made again when they are damaged, and the same for everybody."""

from __future__ import annotations

import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from PIL import Image

import scenetruth as st
from scenetruth.errors import SceneWarning
from scenetruth.testing import recording_cache
from scenetruth.testing.recording_cache import RecordingCache, remove_entries
from tests.helpers.cached_scene import SMALL
from tests.helpers.nightly import by_night


class Kitchen:
    """A folder of entries, where ``SMALL`` was made before, and what else is made in it."""

    def __init__(self, before: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder / "kept"
        self.root = folder
        shutil.copytree(before, self.folder)
        self.made: list[str] = []
        make = recording_cache._make

        def counted(entry: Path, *args: Any) -> None:
            make(entry, *args)
            self.made.append(entry.name)

        monkeypatch.setattr(recording_cache, "_make", counted)

    def open(self) -> RecordingCache:
        """Return recordings as another run would have them."""
        return RecordingCache(self.folder, self.root)


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder where ``SMALL`` is made."""
    folder = tmp_path_factory.mktemp("before")
    RecordingCache(folder, folder)(SMALL)
    return folder


@pytest.fixture
def kitchen(before: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kitchen:
    return Kitchen(before, tmp_path, monkeypatch)


def test_a_recording_is_that_of_the_scene_and_made_once(kitchen: Kitchen) -> None:
    made = kitchen.open()(SMALL, "seed=3", save_radiance=True)
    recording, truth = st.simulate(st.Scene.from_dict({**SMALL, "seed": 3}), save_radiance=True)
    xr.testing.assert_identical(made.recording.drop_attrs(), recording.drop_attrs())
    xr.testing.assert_identical(made.truth.drop_attrs(), truth.drop_attrs())
    assert made.recording.attrs["recording_hash"] == recording.attrs["recording_hash"]
    assert made.scene.seed == 3
    again = kitchen.open()(SMALL, "seed=3", save_radiance=True)
    xr.testing.assert_identical(again.recording, made.recording)
    assert len(kitchen.made) == 1


def test_what_images_depend_on_has_an_entry_of_its_own(kitchen: Kitchen, monkeypatch: pytest.MonkeyPatch) -> None:
    class AskedForError(Exception):
        pass

    def tell(entry: Path, *args: Any) -> None:
        raise AskedForError(entry.name)

    monkeypatch.setattr(recording_cache, "_make", tell)

    def entry_of(*overrides: str, **options: Any) -> str:
        with pytest.raises(AskedForError) as caught:
            kitchen.open()(SMALL, *overrides, **options)
        return str(caught.value)

    image = kitchen.root / "texture.png"
    Image.fromarray(np.zeros((8, 8), dtype=np.uint8)).save(image)
    textured = f"objects.0.texture={{kind: image, file: {image}}}"
    names = [
        entry_of("seed=4"),
        entry_of("render.supersampling=2"),
        entry_of(save_radiance=True),
        entry_of(truth_content="complete"),
        entry_of(textured),
    ]
    # A file counts by its content, and so does the source of what makes the images.
    Image.fromarray(np.ones((8, 8), dtype=np.uint8)).save(image)
    names.append(entry_of(textured))
    monkeypatch.setattr(recording_cache, "_source", lambda: "another version")
    names.append(entry_of())
    assert len(set(names)) == len(names)
    # What they do not depend on has not.
    assert entry_of("description=another", "storage.form=zip", "score.interior_margin_px=3") == names[-1]


def test_nobody_can_change_what_others_get(kitchen: Kitchen) -> None:
    fixture = kitchen.open()
    first = fixture(SMALL)
    before = first.recording.image.values.copy()
    with pytest.raises(ValueError, match="read-only"):
        first.recording.image.values[...] = 0
    with pytest.raises(ValueError, match="read-only"):
        first.truth.depth.values[...] = 0
    first.recording["image"] = first.recording.image * 0
    first.recording.attrs["full_scale"] = 7.0
    first.recording.image.attrs["units"] = "px"
    second = fixture(SMALL)
    assert np.array_equal(second.recording.image.values, before)
    assert second.recording.attrs["full_scale"] != 7.0
    assert second.recording.image.attrs["units"] != "px"


@pytest.mark.parametrize("harm", ["chunk", "missing", *by_night("metadata", "file")])
def test_what_is_damaged_is_made_again(kitchen: Kitchen, harm: str) -> None:
    (entry,) = kitchen.folder.iterdir()
    made = kitchen.open()(SMALL)
    if harm == "chunk":
        chunk = max((file for file in (entry / "truth.zarr" / "depth").rglob("*") if file.is_file()), key=_size)
        content = bytearray(chunk.read_bytes())
        content[len(content) // 2] ^= 1
        chunk.write_bytes(content)
    elif harm == "metadata":
        (entry / "warnings.json").write_text("[")
    elif harm == "missing":
        shutil.rmtree(entry / "recording.zarr")
    else:
        shutil.rmtree(entry)
        entry.write_text("no folder")
    again = kitchen.open()(SMALL)
    xr.testing.assert_identical(again.recording, made.recording)
    xr.testing.assert_identical(again.truth, made.truth)
    assert kitchen.made == [entry.name]
    assert [file.name for file in kitchen.folder.iterdir()] == [entry.name]


def _size(file: Path) -> int:
    return file.stat().st_size


def test_what_fails_leaves_nothing(kitchen: Kitchen, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: Any, **options: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("scenetruth.simulation.TruthTasks.put", fail)
        with pytest.raises(KeyboardInterrupt):
            kitchen.open()(SMALL, "seed=3")
    assert len(list(kitchen.folder.glob("*"))) == 1
    assert kitchen.made == []


def test_one_makes_what_several_ask_for(kitchen: Kitchen) -> None:
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda _: kitchen.open()(SMALL, "seed=3").recording.image.values.sum(), range(3)))
    assert len(kitchen.made) == 1
    assert len(set(found)) == 1


def test_warnings_are_told_each_time(kitchen: Kitchen) -> None:
    # Of such images, all is edge.
    for _ in range(2):
        with pytest.warns(SceneWarning, match="without interior pixels") as told:
            kitchen.open()(SMALL)
        assert {item.filename for item in told} == {__file__}
    assert kitchen.made == []


def test_scenes_are_found_by_path_and_by_name(kitchen: Kitchen, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = st.Scene.from_dict(SMALL)
    expected = kitchen.open()(scene).recording
    (kitchen.root / "scenes").mkdir()
    file = kitchen.root / "scenes" / "tiny.yaml"
    file.write_text(yaml.safe_dump(SMALL))
    for given in (file, str(file), "tiny", "scenes/tiny.yaml", Path("scenes/tiny.yaml")):
        xr.testing.assert_identical(kitchen.open()(given).recording, expected)
    assert kitchen.made == []
    # A checkout of scenetruth has a library.
    assert kitchen.open()._file("cube").name == "cube.yaml"
    with pytest.raises(st.SceneError, match="did you mean 'tiny'"):
        kitchen.open()("tinny")
    monkeypatch.setattr(recording_cache, "_checkout", list)
    with pytest.raises(st.SceneError, match="in a checkout only"):
        kitchen.open()("cube")
    with pytest.raises(st.SceneError, match=r"nowhere\.yaml"):
        kitchen.open()("nowhere.yaml")
    with pytest.raises(st.SceneError, match="must be a scene, its file, its name"):
        kitchen.open()(7)  # type: ignore[arg-type]
    with pytest.raises(st.SceneError, match=r"camera\.widht"):
        kitchen.open()("tiny", "camera.widht=3")


def test_images_do_not_depend_on_what_renders_on_a_machine(kitchen: Kitchen) -> None:
    auto = {**SMALL, "render": {"supersampling": 1}}
    assert kitchen.open()(auto).recording.attrs["render_backend"] == "raycast"
    assert kitchen.made == []


def test_only_entries_are_removed(kitchen: Kitchen) -> None:
    (kitchen.folder / "notes.txt").write_text("mine")
    (kitchen.folder / "recording-of-mine").mkdir()
    assert remove_entries(kitchen.folder) == 1
    assert sorted(file.name for file in kitchen.folder.iterdir()) == ["notes.txt", "recording-of-mine"]
    assert remove_entries(kitchen.root / "nowhere") == 0


def test_a_plug_in_that_is_not_used_costs_nothing() -> None:
    code = "import sys; import scenetruth.testing.pytest_plugin; print(*sorted(sys.modules))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    own = {name for name in found if name.startswith("scenetruth")}
    assert own == {
        "scenetruth",
        "scenetruth.compilation",
        "scenetruth.errors",
        "scenetruth.lazy_exports",
        "scenetruth.testing",
        "scenetruth.testing.pytest_plugin",
        "scenetruth.testing.assertion_context",
    }
    assert not {"numpy", "xarray", "numba", "scipy", "pandas", "matplotlib"} & set(found)
