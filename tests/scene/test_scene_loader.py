"""Scene files: every problem is named, with its path, its value and the remedy."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.estimators import choose
from scenetruth.scene.scene_loader import apply_overrides
from tests.helpers.scenes import SCENES, cube

ALL_SCENES = sorted(SCENES.glob("*.yaml"))


@pytest.mark.parametrize("file", ALL_SCENES, ids=lambda file: file.stem)
def test_scenes_of_the_repository_load_and_survive_a_round_trip(file: Path) -> None:
    scene = st.load_scene(file)
    assert scene.description
    assert st.Scene.from_dict(scene.to_dict()) == scene
    assert st.Scene.from_dict(yaml.safe_load(yaml.safe_dump(scene.to_dict()))) == scene


@pytest.mark.parametrize(
    "changes", [{"sensor": {"bit_depth": None}}, {"sensor": {"bit_depth": 8}}, {"sensor": "ideal"}]
)
def test_what_is_not_the_default_survives_a_round_trip(changes: dict[str, Any]) -> None:
    scene = cube(**changes)
    assert st.Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene


def test_yaml_and_python_are_equal(tmp_path: Path) -> None:
    scene = cube()
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene.to_dict()))
    assert st.load_scene(tmp_path / "scene.yaml") == scene


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("camera.widht=3", r"camera\.widht: unknown key; did you mean 'width'\? \(got 3\)"),
        ("camera.width=-3", r"camera\.width: .*greater than or equal to 1 \(got -3\)"),
        ("camera.width=wide", r"camera\.width: .*valid integer.*\(got 'wide'\)"),
        ("camera.focal_length_px=.nan", r"camera\.focal_length_px: .*finite"),
        ("stage.baseline_mm=0", r"stage\.baseline_mm: must not be zero"),
        ("frames.count=0", r"frames\.count: .*greater than or equal to 1"),
        ("objects=[]", r"plants: a scene requires at least one object or plant"),
        ("objects.0.mesh.size_mm=[49, 49]", r"objects\.0\.mesh\.size_mm\.2: is missing"),
        ("objects.0.mesh.size_mm=[49, -49, 49]", r"objects\.0\.mesh\.size_mm\.1: .*greater than 0 \(got -49\)"),
        ("objects.0.mesh.kind=ball", r"objects\.0\.mesh: .*'ball'.*'box', 'cylinder', 'file'"),
        ("objects.0.texture.wavelength_mm=[4, 1]", r"wavelength_mm: must be \(shortest, longest\)"),
        ("objects.0.texture.mean=0.9", r"mean ± 3 rms_contrast mean must stay within \[0, 1\]"),
        ("objects.0.pose.rotations.0.axis=[0, 0, 0]", r"axis: must not be the zero vector"),
        ("sensor=idal", r"sensor: must be 'ideal', or a mapping with `kind` gaussian.*\(got 'idal'\)"),
        ("sensor.noise_std=-0.1", r"sensor\.noise_std: .*greater than or equal to 0"),
        ("render.backend=povray", r"render\.backend: .*'pyrender'.*'povray'"),
        ("estimate.window_taps_px=24", r"estimate\.window_taps_px: must be odd"),
        ("nonsense=1", r"nonsense: unknown key"),
    ],
)
def test_what_is_wrong_is_named(override: str, message: str) -> None:
    with pytest.raises(st.SceneError, match=message) as caught:
        st.load_scene(SCENES / "cube.yaml", overrides=[override])
    assert "cube.yaml" in str(caught.value)
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    ("path", "changes"),
    [
        ("stage.baseline_mm", {"stage": {"baseline_mm": True}}),
        ("camera.width", {"camera": {"width": True}}),
        ("camera.principal_point_px.1", {"camera": {"principal_point_px": [3, False]}}),
        ("sensor.noise_std", {"sensor": {"noise_std": False}}),
        ("seed", {"seed": True}),
    ],
)
def test_booleans_are_no_numbers(path: str, changes: dict[str, Any]) -> None:
    with pytest.raises(st.SceneError) as caught:
        cube(**changes)
    assert f"{path}: must be a number, not a boolean; YAML reads yes, no, on and off" in str(caught.value)
    assert not cube(lighting={"shadows": False}).lighting.shadows


def test_paths_of_windows_have_a_remedy(tmp_path: Path) -> None:
    text = yaml.safe_dump(cube().to_dict())
    plain = yaml.safe_load(text)
    plain["objects"][0]["mesh"] = {"kind": "file", "file": "NAME"}
    for name, message in (
        (r'"C:\temp\new.obj"', "contains a tab, a line break or another control character; use / in paths"),
        (r"C:\data\leaf.obj", "it is a path of Windows: use / and a path relative to the directory of the file"),
    ):
        (tmp_path / "scene.yaml").write_text(yaml.safe_dump(plain).replace("NAME", name))
        with pytest.raises(st.SceneError) as caught:
            st.simulate(tmp_path / "scene.yaml")
        assert message in str(caught.value)


def test_decimal_commas_are_named() -> None:
    plain = cube().to_dict()
    plain["camera"]["focal_length_px"] = "5016,5"
    plain["objects"][0]["pose"] = {"position_mm": [0, 0, 600, 5]}
    with pytest.raises(st.SceneError) as caught:
        st.Scene.from_dict(plain)
    assert r"camera.focal_length_px: must be a number with a decimal point: 5016.5 (got '5016,5')" in str(caught.value)
    assert "a decimal comma separates items: write 0.5, not 0,5" in str(caught.value)


def test_all_problems_at_once() -> None:
    wrong = ["camera.widht=3", "sensor.noise_std=-1", "objects.0.texture.kind=foo", "frames.count=x"]
    with pytest.raises(st.SceneError) as caught:
        st.load_scene(SCENES / "cube.yaml", overrides=wrong)
    paths = sorted(problem.path for problem in caught.value.problems)
    assert paths == ["camera.widht", "frames.count", "objects.0.texture", "sensor.noise_std"]


def test_names_must_be_unique() -> None:
    item = cube().to_dict()["objects"][0]
    with pytest.raises(st.SceneError, match="objects: names must be unique; used more than once: cube"):
        cube(objects=[item, item])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- 1\n- 2", "must be a mapping"),
        ("camera: [", "is not valid YAML"),
        ("camera: {}", r"camera\.width: is missing"),
        ("\x00", "not valid YAML"),
    ],
)
def test_files_that_are_no_scene(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(text)
    with pytest.raises(st.SceneError, match=message):
        st.load_scene(file)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(st.SceneError, match=r"nothing\.yaml.*\n.*no such file; specify"):
        st.load_scene(tmp_path / "nothing.yaml")


def test_overrides_reach_into_lists_and_new_sections() -> None:
    overrides = ["objects.0.motion.0.velocity_mm_per_frame=[1, 2, 3]", "render.supersampling=2", "sensor=ideal"]
    scene = st.load_scene(SCENES / "plaid.yaml", overrides=overrides)
    assert scene.objects[0].motion[0].velocity_mm_per_frame == (1, 2, 3)  # type: ignore[attr-defined]
    assert scene.render.supersampling == 2


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("camera.width", "must have the form path=value"),
        ("=3", "must have the form path=value"),
        ("objects.7.name=x", "'objects' is a list of 1; '7' is not an index of it"),
        ("objects.name=x", "is not an index of it"),
        ("camera.width.more=1", "'camera.width' is 640 and has no fields"),
        ("seed=[", "value, line 2, column 1: is not valid YAML"),
    ],
)
def test_overrides_that_do_not_fit(override: str, message: str) -> None:
    with pytest.raises(st.SceneError, match=message):
        st.load_scene(SCENES / "cube.yaml", overrides=[override])


@pytest.mark.parametrize(
    "overrides",
    [["estimate.method=refined"], {"estimate.method": "refined"}],
)
def test_settings_of_the_former_method_are_dropped_with_a_warning(overrides: Any) -> None:
    with pytest.warns(st.SceneWarning, match=r"^estimate\.method: the settings of 'structure_tensor' .*: tau "):
        scene = st.load_scene(SCENES / "leaf.yaml", overrides=overrides)
    assert scene.estimate == choose({"method": "refined"})
    # Of a scene that is loaded, every setting has a value: only those without their default are named.
    with pytest.warns(st.SceneWarning, match="'refined': tau ignored"):
        assert st.load_scene(st.load_scene(SCENES / "leaf.yaml"), overrides=overrides) == scene


@pytest.mark.parametrize(
    "overrides",
    [
        ["estimate.window_sigma_px=4.5", "estimate.method=refined"],
        ["estimate.method=refined", "estimate.window_sigma_px=4.5"],
    ],
)
def test_settings_of_the_same_overrides_stay(overrides: list[str]) -> None:
    with pytest.warns(st.SceneWarning, match="tau ignored"):
        scene = st.load_scene(SCENES / "leaf.yaml", overrides=overrides)
    assert scene.estimate == choose({"method": "refined", "window_sigma_px": 4.5})


def test_settings_stay_where_the_method_does_not_change_or_does_not_exist() -> None:
    leaf = SCENES / "leaf.yaml"
    assert st.load_scene(leaf, overrides=["estimate.method=structure_tensor"]) == st.load_scene(leaf)
    with pytest.raises(st.SceneError, match="no such method; did you mean 'refined'") as error:
        st.load_scene(leaf, overrides=["estimate.method=refind"])
    assert len(error.value.problems) == 1
    with pytest.raises(st.SceneError, match=r"estimate\.tau: unknown setting of 'refined'"):
        st.load_scene(leaf, overrides=["estimate.method=refined", "estimate.tau=0.1"])


plain_values = some.recursive(
    some.none() | some.booleans() | some.integers(-5, 5) | some.floats() | some.text(max_size=3),
    lambda inner: (
        some.lists(inner, max_size=3) | some.dictionaries(some.sampled_from(["kind", "file", "camera", "x"]), inner)
    ),
    max_leaves=6,
)


@given(
    path=some.sampled_from(
        [
            "camera",
            "stage",
            "frames",
            "objects",
            "objects.0",
            "objects.0.mesh",
            "objects.0.texture",
            "objects.0.motion",
            "sensor",
            "lighting",
            "lighting.lights",
            "seed",
        ]
    ),
    value=plain_values,
)
def test_any_value_gives_a_scene_or_a_scene_error(path: str, value: object) -> None:
    plain = cube().to_dict()
    with contextlib.suppress(st.SceneError):
        apply_overrides(plain, [f"{path}={yaml.safe_dump(value, default_flow_style=True)}"])
        assert isinstance(st.Scene.from_dict(plain), st.Scene)


def test_relative_paths_count_from_the_scene_file(tmp_path: Path) -> None:
    plain = cube().to_dict()
    plain["objects"][0]["texture"] = {"kind": "image", "file": "pattern.png"}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(plain))
    texture = st.load_scene(tmp_path / "scene.yaml").objects[0].texture
    assert texture.file == str(tmp_path / "pattern.png")  # type: ignore[attr-defined]


def test_a_later_format_is_refused() -> None:
    assert cube(format=1).format == 1
    with pytest.raises(st.SceneError, match=r"format: unsupported format .*; this scenetruth version reads format 1"):
        cube(format=2)


def test_a_shipped_scene_goes_by_its_name_unless_a_file_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert st.load_scene("plane").objects[0].name == "plane"
    Path("plane").write_text(FILE_SCENE, encoding="utf-8")
    assert st.load_scene("plane").objects[0].name == "wall"
    with pytest.raises(st.SceneError, match="no_such"):
        st.load_scene("no_such")


FILE_SCENE = """
camera: {width: 40, height: 30, focal_length_px: 60}
stage: {positions: 3, baseline_mm: 5}
frames: {count: 2}
objects:
  - {name: wall, mesh: {kind: plane, size_mm: [90, 90]}, texture: {kind: uniform}, pose: {position_mm: [0, 0, 100]}}
"""
