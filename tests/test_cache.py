from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from scenetruth import cache
from scenetruth.cache import cache_folder, entry_key, load_or_compute, read_entry, source_hash, write_entry
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene

VALUES = {"image": np.arange(12, dtype=np.float32).reshape(3, 4), "place": np.array([1.5, -2.0])}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "made" / "cache"
    monkeypatch.setenv("SCENETRUTH_CACHE", str(place))
    return place


def entries(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@given(
    arrays(
        st.sampled_from([np.float64, np.float32, np.int32, np.uint8, np.bool_]),
        array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
    )
)
def test_packed_arrays_come_back_to_the_bit(values: np.ndarray) -> None:
    raw = np.frombuffer(b"".join(cache._packed({"one": values, "two": VALUES["image"]})), dtype=np.uint8)
    found = cache._unpacked(raw)
    assert found is not None
    assert found["one"].dtype == values.dtype
    assert found["one"].shape == values.shape
    assert found["one"].tobytes() == values.tobytes()
    assert (found["two"] == VALUES["image"]).all()


def test_what_is_made_once_is_taken_from_the_disk(folder: Path) -> None:
    made = []

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {name: values.copy() for name, values in VALUES.items()}

    first, again = load_or_compute(entry_key("thing", 1), make), load_or_compute(entry_key("thing", 1), make)
    load_or_compute(entry_key("thing", 2), make)
    assert len(made) == 2
    assert all(first[name].tobytes() == again[name].tobytes() == VALUES[name].tobytes() for name in VALUES)
    # As arrays that are made anew: kernels are compiled for one kind only.
    assert again["image"].flags.writeable
    assert again["image"].flags.aligned


@pytest.mark.parametrize("damage", ["cut", "bit in the middle", "bit at the end", "bit in the head", "empty", "grown"])
def test_damaged_entries_are_made_again(folder: Path, damage: str) -> None:
    key = entry_key("thing", 1)
    write_entry(key, VALUES)
    path = folder / entries(folder)[0]
    data = bytearray(path.read_bytes())
    if damage == "cut":
        data = data[: len(data) // 2]
    elif damage == "empty":
        data = bytearray()
    elif damage == "grown":
        data += b"\0"
    else:
        data[{"bit in the middle": len(data) // 2, "bit at the end": -1, "bit in the head": 3}[damage]] ^= 4
    path.write_bytes(data)
    assert read_entry(key) is None
    assert entries(folder) == []
    found = load_or_compute(key, lambda: VALUES)
    assert (found["image"] == VALUES["image"]).all()
    assert read_entry(key) is not None


def test_entries_are_verified_once_and_again_after_a_change(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key, trusted = entry_key("thing", 2), list[bool]()
    write_entry(key, VALUES)
    unpacked = cache._unpacked

    def counted(raw: np.ndarray, *, verified: bool = False) -> cache.Arrays | None:
        trusted.append(verified)
        return unpacked(raw, verified=verified)

    monkeypatch.setattr(cache, "_unpacked", counted)
    for _ in range(3):
        found = read_entry(key)
        assert found is not None
        assert (found["image"] == VALUES["image"]).all()
    assert trusted == [False, True, True]
    path = folder / entries(folder)[0]
    data = bytearray(path.read_bytes())
    data[-1] ^= 4
    path.write_bytes(data)
    assert read_entry(key) is None
    # Another file with the same name.
    write_entry(key, VALUES)
    assert read_entry(key) is not None
    assert trusted[3:] == [False, False]


def test_keys_tell_everything_apart() -> None:
    state = generator_for(1, "texture", "cube").bit_generator.state
    other = generator_for(1, "texture", "box").bit_generator.state
    parts = [(1.0, 0.1, state), (1.0, np.nextafter(0.1, 1), state), (1.0, 0.1, other), (1.0, 0.1), (-0.0,), (0.0,)]
    parts += [(np.arange(3),), (np.arange(3.0),), (np.float64(1.0), 0.1, state, 2)]
    keys = [entry_key(what, *given) for given in parts for what in ("noise", "leaf")]
    assert len({*keys}) == len(keys)
    assert entry_key("noise", 1.0, 0.1, state) == entry_key("noise", np.float64(1.0), 0.1, state)
    with pytest.raises(TypeError, match="cannot contain"):
        entry_key("noise", {1, 2})


def test_changed_sources_have_another_hash(tmp_path: Path) -> None:
    file = tmp_path / "below" / "one.py"
    file.parent.mkdir()
    found = set()
    for text in ("a = 1", "a = 2"):
        file.write_text(text)
        source_hash.cache_clear()
        found.add(source_hash(tmp_path))
    assert len(found) == 2


def test_the_least_recently_used_go_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCENETRUTH_CACHE_MB", "0.0035")
    large = {"values": np.zeros(250)}  # 2000 bytes, and a little
    keys = [entry_key("thing", n) for n in range(4)]
    small = {"values": np.zeros(50)}
    for n, key in enumerate(keys[:3]):
        write_entry(key, small)
        os.utime(folder / f"{key}.entry", (n, n))
    assert read_entry(keys[0]) is not None  # used: now the youngest
    write_entry(keys[3], large)
    assert read_entry(keys[1]) is None
    assert all(read_entry(key) is not None for key in (keys[0], keys[3]))
    # What is larger than all there may be is not kept, and drives nothing out.
    write_entry(entry_key("thing", 9), {"values": np.zeros(1000)})
    assert read_entry(keys[0]) is not None


def test_remains_of_killed_writers_are_taken_away(folder: Path) -> None:
    folder.mkdir(parents=True)
    old, young = folder / "old.aside", folder / "young.aside"
    for path in (old, young):
        path.write_bytes(b"half")
    os.utime(old, (time.time() - 7200,) * 2)
    write_entry(entry_key("thing"), VALUES)
    assert not old.exists()
    assert young.exists()


def test_many_writers_and_readers_never_see_half_an_entry(folder: Path) -> None:
    key, bad = entry_key("thing"), []
    stop = threading.Event()

    def write(number: int) -> None:
        while not stop.is_set():
            write_entry(key, {"values": np.full(20_000, number)})

    def read() -> None:
        for _ in range(200):
            found = read_entry(key)
            if found is not None and len({*found["values"].tolist()}) != 1:
                bad.append(found)

    write_entry(key, {"values": np.full(20_000, 9)})
    writers = [threading.Thread(target=write, args=(number,)) for number in range(2)]
    for thread in writers:
        thread.start()
    read()
    stop.set()
    for thread in writers:
        thread.join()
    assert not bad
    # No reader took a half written file for a damaged one and deleted it.
    assert read_entry(key) is not None


def test_unwritable_folders_and_none_leave_the_result_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder")
    for place in (str(tmp_path / "file"), str(tmp_path / "file" / "below"), "/proc/nowhere", "off"):
        monkeypatch.setenv("SCENETRUTH_CACHE", place)
        found = load_or_compute(entry_key("thing"), lambda: VALUES)
        assert (found["image"] == VALUES["image"]).all()
        assert read_entry(entry_key("thing")) is None


def test_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("SCENETRUTH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "scenetruth"
    for ignored in ("relative/cache", ""):
        monkeypatch.setenv("XDG_CACHE_HOME", ignored)
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        assert cache_folder() == tmp_path / "home" / ".cache" / "scenetruth"
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # no HOME, and no entry for the user
    assert cache_folder() is None
    monkeypatch.setenv("SCENETRUTH_CACHE", "OFF")
    assert cache_folder() is None


def test_textures_are_the_same_with_and_without(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    leaf = {"kind": "leaf", "length_mm": 20, "width_mm": 12, "resolution_mm": 2}
    noise = {"kind": "noise", "wavelength_mm": [1, 4]}
    objects = [
        {"name": "leaf", "mesh": leaf, "texture": {"kind": "leaf", "texels_per_mm": 5}, "pose": {}},
        {"name": "wall", "mesh": {"kind": "plane", "size_mm": [20, 30]}, "texture": noise, "pose": {}},
    ]
    for item in objects:
        item["pose"] = {"position_mm": [0, 0, 100]}
    scene = Scene.from_dict(
        {
            "camera": {"width": 8, "height": 8, "focal_length_px": 20},
            "stage": {"positions": 2, "baseline_mm": 5},
            "frames": {"count": 1},
            "objects": objects,
        }
    )
    kept = [build_scene(scene) for _ in range(2)]
    assert len(entries(folder)) == 2
    monkeypatch.setenv("SCENETRUTH_CACHE", "off")
    plain = build_scene(scene)
    for world in kept:
        for one, other in zip(world.bodies, plain.bodies, strict=True):
            assert one.texture.raster().tobytes() == other.texture.raster().tobytes()
            assert one.uv.tobytes() == other.uv.tobytes()
