"""Wrong keys and words: what is suggested exists, is allowed there, and is never what was written."""

from __future__ import annotations

import re

import pytest

import scenetruth as st
from scenetruth.scene.suggestions import collect_keys, suggest_key
from tests.helpers.scenes import SCENES


def message_of(override: str) -> str:
    with pytest.raises(st.SceneError) as caught:
        st.load_scene(SCENES / "cube.yaml", overrides=[override])
    path = override.partition("=")[0]
    # A wrong kind is told of the whole, and a wrong key of a part where the part was to begin.
    found = [item for item in caught.value.problems if item.path.startswith(path) or path.startswith(item.path)]
    return found[0].message


@pytest.mark.parametrize(
    ("override", "end"),
    [
        ("camera.widht=3", "did you mean 'width'?"),
        ("camera.Width=3", "did you mean 'width'?"),
        ("camera.focal_length=3", "did you mean 'focal_length_mm' or 'focal_length_px'?"),
        ("camra.width=3", "did you mean 'camera'?"),
        ("width=3", "did you mean 'camera.width'?"),
        ("widht=3", "did you mean 'camera.width'?"),
        ("camera.seed=5", "did you mean 'seed' at the top level?"),
        ("camera.positions=5", "did you mean 'stage.positions'?"),
        ("camera.noise_std=1", "did you mean 'estimate.noise_std' or 'sensor.noise_std' of `kind` gaussian?"),
        ("objects.0.position_mm=[0, 0, 1]", "did you mean 'objects.0.pose.position_mm'?"),
        (
            "objects.0.texture.size_mm=[1, 2]",
            "did you mean 'objects.0.mesh.size_mm' of `kind` box, plane, relief or saddle?",
        ),
        (
            "size_mm=3",
            "did you mean 'lighting.lights.N.size_mm' of `kind` rectangle or 'objects.N.mesh.size_mm' of `kind` box, "
            "plane, relief or saddle?",
        ),
        (
            "objects.0.mesh.cap_deg=3",
            "it belongs to `kind` sphere; valid keys: kind, size_mm",
        ),
        ("sensor.gain=3", "did you mean 'sensor.gain_dn_per_e' of `kind` emva1288?"),
        ("estimate.interior_margin_px=3", "did you mean 'score.interior_margin_px'?"),
        ("frames.nonsense=1", "valid keys: count, frame_interval_s"),
        ("render.backend=raycst", "did you mean 'raycast'?"),
        ("estimate.divergence=papr", "did you mean 'paper'?"),
        ("shutter.samples=auo", "input should be a valid integer or 'auto'; did you mean 'auto'?"),
        ("shutter.samples=-1", "input should be greater than or equal to 1 or 'auto'"),
        ("sensor=idal", "did you mean 'ideal'?"),
        ("sensor.kind=emva", "did you mean 'emva1288'?"),
        ("objects.0.mesh.kind=bx", "did you mean 'box'?"),
        ("optics.psf={sigma_px: 2}", "requires `kind`, one of 'airy', 'gaussian'"),
        ("sensor={kind: chain, effects: [{kind: gamma, gama: 3}]}", "unknown key; did you mean 'gamma'?"),
    ],
)
def test_what_was_meant_is_told(override: str, end: str) -> None:
    message = message_of(override)
    assert message.endswith(end)


@pytest.mark.parametrize(("wrong", "right"), [("object", "objects"), ("plnts", "plants"), ("camra", "camera")])
def test_what_seems_missing_is_first_told_under_the_name_it_has(wrong: str, right: str) -> None:
    plain = st.load_scene(SCENES / ("rosette.yaml" if right == "plants" else "cube.yaml")).to_dict()
    if right == "plants":
        plain["objects"] = []
    plain[wrong] = plain.pop(right)
    with pytest.raises(st.SceneError) as caught:
        st.Scene.from_dict(plain)
    first, *others = caught.value.problems
    assert first.path == wrong
    assert first.message == f"unknown key; did you mean '{right}'?"
    # Nothing was given there, so nothing is shown.
    assert [str(other) for other in others] == [
        "camera: is missing" if right == "camera" else "plants: a scene requires at least one object or plant"
    ]


PLACES = [
    (),
    ("camera",),
    ("stage", "errors"),
    ("objects", 0),
    ("objects", 0, "mesh", "box"),
    ("objects", 0, "motion", 1, "turn"),
    ("sensor", "gaussian"),
    ("plants", 0, "rosette", "texture"),
]


@pytest.mark.parametrize("place", PLACES, ids=str)
def test_no_key_is_suggested_to_itself(place: tuple[str | int, ...]) -> None:
    here = suggest_key((*place, "qqqqqq")).removeprefix("; valid keys: ").split(", ")
    path = ".".join(str(part) for part in place if part not in ("box", "turn", "gaussian", "rosette"))
    elsewhere = sorted(collect_keys() - set(here))
    assert "kind" in here or "kind" in elsewhere
    for key in elsewhere:
        guesses = re.findall(r"'([^']*)'(?! at the top level)", suggest_key((*place, key)))
        assert not {key, f"{path}.{key}"} & set(guesses)
        assert all(guess in here or "." in guess or not path for guess in guesses)


def test_missing_field_called_like_its_kind_has_its_path() -> None:
    with pytest.raises(st.SceneError, match=r"sensor\.effects\.0\.gamma: is missing"):
        st.load_scene(SCENES / "cube.yaml", overrides=["sensor={kind: chain, effects: [{kind: gamma}]}"])


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("render.backend=RayCast", "render.backend", "raycast"),
        ("stage.scan=Bidirectional", "stage.scan", "bidirectional"),
        ("stage.errors={preset: Screw_Stage}", "stage.errors.backlash_um", 5.0),
        ("sensor={kind: EMVA1288, preset: CCD_2002}", "sensor.full_well_e", 45000.0),
        ("sensor=Ideal", "sensor", "ideal"),
        ("estimate.tau=Auto", "estimate.settings.tau", "auto"),
        ("optics.psf={kind: Gaussian, sigma_px: 1}", "optics.psf.kind", "gaussian"),
        (
            "objects.0.motion=[{kind: Turn, preset: LEAF_TILT, axis: [0, 0, 1]}]",
            "objects.0.motion.0.angle_deg.start",
            0,
        ),
        (
            "objects.0.motion=[{kind: turn, axis: [0, 0, 1], angle_deg: {kind: Linear, rate_per_frame: 2}}]",
            "objects.0.motion.0.angle_deg.kind",
            "linear",
        ),
    ],
)
def test_words_of_scenes_may_be_in_any_case(override: str, path: str, value: object) -> None:
    found: object = st.load_scene(SCENES / "cube.yaml", overrides=[override])
    for part in path.split("."):
        found = found[int(part)] if isinstance(found, tuple) else getattr(found, part)
    assert found == value
