"""Materials: presets, hidden defaults, and values that are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.errors import SceneError
from scenetruth.provenance import scene_hash
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.material import MATERIALS, Material
from tests.helpers.mesh_files import gltf


@pytest.mark.parametrize("name", sorted(MATERIALS))
def test_presets_are_valid_and_can_be_changed(name: str) -> None:
    material = Material.model_validate({"preset": name, "transmittance": 0.25})
    values = MATERIALS[name].values
    assert {key: getattr(material, key) for key in values} == dict(values)
    assert material.transmittance == 0.25
    assert set(MATERIALS[name].sources) == set(values)
    assert Material.model_validate(material.model_dump(mode="json")) == material


def test_matt_materials_leave_no_trace_in_a_scene() -> None:
    plain, matt = st.load_scene("rosette"), st.load_scene("rosette", overrides=["plants.0.material={}"])
    assert "material" not in str(plain.to_dict())
    assert scene_hash(plain) == scene_hash(matt)
    glossy = st.load_scene("rosette", overrides=["plants.0.material.preset=leaf"])
    assert scene_hash(glossy) != scene_hash(plain)
    assert st.Scene.from_dict(glossy.to_dict()) == glossy
    assert all(item.material.preset == "leaf" for path, item in glossy.parts if path.startswith("plants"))


def test_values_out_of_range_are_named_together() -> None:
    changes = ["refractive_index=0.9", "roughness=0", "metallic=2", "transmittance=-1"]
    with pytest.raises(SceneError) as caught:
        st.load_scene("cube", overrides=[f"objects.0.material.{change}" for change in changes])
    paths = {problem.path for problem in caught.value.problems}
    assert paths == {f"objects.0.material.{change.split('=')[0]}" for change in changes}


def with_gloss(material: dict[str, Any], **extensions: dict[str, Any]) -> str:
    """Return a glTF file of a square with a material."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    own = {f"KHR_materials_{name}": values for name, values in extensions.items()}
    return gltf(
        {"points": points, "index": np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)},
        {"attributes": {"POSITION": "@points"}, "indices": "@index", "material": 0},
        materials=[{"pbrMetallicRoughness": material, "extensions": own}],
        extensionsUsed=sorted(own),
    )


def read_materials(file: Path, text: str) -> tuple[Material, ...]:
    file.write_text(text)
    mesh = {"kind": "file", "file": str(file)}
    item = {"name": "square", "mesh": mesh, "texture": {"kind": "embedded"}, "material": {"from_file": True}}
    item |= {"pose": {"position_mm": [0, 0, 100]}}
    plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [item]}
    plain |= {"stage": {"positions": 1, "baseline_mm": 5}, "frames": {"count": 1}, "lighting": {"ambient": 1}}
    return build_scene(st.Scene.from_dict(plain)).bodies[0].materials


@pytest.mark.parametrize(
    ("material", "extensions", "values"),
    [
        # Values that the specification states: roughness is the root of α, and 1.5 the default of the index.
        ({"metallicFactor": 0, "roughnessFactor": 0.5}, {}, (1.5, 0.25, 0.0, 1.0, 0.0)),
        ({}, {}, (1.5, 1.0, 1.0, 1.0, 0.0)),
        ({"metallicFactor": 0}, {"ior": {"ior": 1.33}}, (1.33, 1.0, 0.0, 1.0, 0.0)),
        # Half the reflectance of 0.04: n = (1 + √0.02) / (1 - √0.02).
        ({"metallicFactor": 0}, {"specular": {"specularFactor": 0.5}}, (1.3294314, 1.0, 0.0, 1.0, 0.0)),
        ({"metallicFactor": 0}, {"specular": {"specularFactor": 0}}, (1.0, 1.0, 0.0, 1.0, 0.0)),
        (
            {"metallicFactor": 0, "roughnessFactor": 0.9},
            {"clearcoat": {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.3}},
            (1.5, 0.09, 0.0, 1.0, 0.0),
        ),
        (
            {"metallicFactor": 0},
            {"diffuse_transmission": {"diffuseTransmissionFactor": 0.3}},
            (1.5, 1.0, 0.0, 0.7, 0.3),
        ),
    ],
)
def test_materials_of_gltf_files_are_read(
    tmp_path: Path, material: dict[str, Any], extensions: dict[str, Any], values: tuple[float, ...]
) -> None:
    (found,) = read_materials(tmp_path / "square.gltf", with_gloss(material, **extensions))
    given = (found.refractive_index, found.roughness, found.metallic, found.reflectance, found.transmittance)
    assert given == pytest.approx(values, abs=1e-6)


@pytest.mark.parametrize(
    ("material", "extensions", "message"),
    [
        ({"metallicRoughnessTexture": {"index": 0}}, {}, "gloss that varies over the surface"),
        ({"metallicFactor": 2}, {}, "metallicFactor must be a number from 0 to 1, and is 2"),
        ({"roughnessFactor": "x"}, {}, "roughnessFactor must be a number from 0 to 1, and is x"),
        (
            {"roughnessFactor": None, "metallicFactor": -1},
            {"specular": {"specularColorFactor": [1, 1]}, "ior": {"ior": 0}},
            "metallicFactor .* -1; roughnessFactor .* None; ior .* 0; specularColorFactor .* at least 0, and is",
        ),
        ({}, {"clearcoat": {"clearcoatFactor": 1}}, "on metal"),
        ({"metallicFactor": 0}, {"ior": {"ior": 0.5}}, "ior must be a number at least 1, and is 0.5"),
        ({}, {"unlit": {}}, "no gloss"),
    ],
)
def test_materials_of_gltf_files_that_cannot_be_shown_are_named(
    tmp_path: Path, material: dict[str, Any], extensions: dict[str, Any], message: str
) -> None:
    with pytest.raises(SceneError, match=rf"objects\.0\.material\.from_file: .*{message}"):
        read_materials(tmp_path / "square.gltf", with_gloss(material, **extensions))


def test_problems_of_all_materials_of_a_gltf_file_are_named(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    halves = {"lower": np.array([0, 1, 2], dtype=np.uint16), "upper": np.array([0, 2, 3], dtype=np.uint16)}
    primitives = [
        {"attributes": {"POSITION": "@points"}, "indices": f"@{half}", "material": n} for n, half in enumerate(halves)
    ]
    gloss = [{"metallicFactor": 2}, {"roughnessFactor": 7}]
    text = gltf(
        {"points": points, **halves},
        {},
        meshes=[{"primitives": primitives}],
        materials=[{"pbrMetallicRoughness": each} for each in gloss],
    )
    with pytest.raises(SceneError, match=r"metallicFactor must .*; material .*: roughnessFactor must"):
        read_materials(tmp_path / "square.gltf", text)


def test_from_file_stands_alone() -> None:
    with pytest.raises(SceneError, match="remove roughness"):
        st.load_scene("cube", overrides=["objects.0.material={from_file: true, roughness: 0.2}"])
    with pytest.raises(SceneError, match="the mesh has no materials"):
        build_scene(st.load_scene("cube", overrides=["objects.0.material.from_file=true"]))
    with pytest.raises(SceneError, match=r"plants\.0\.material: .*leaves have none") as caught:
        st.load_scene("rosette", overrides=["plants.0.material.from_file=true"])
    assert len(caught.value.problems) == 1
