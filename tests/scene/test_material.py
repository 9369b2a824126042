"""Materials: presets, hidden defaults, and values that are refused."""

from __future__ import annotations

import pytest

import scenetruth as st
from scenetruth.errors import SceneError
from scenetruth.provenance import scene_hash
from scenetruth.scene.material import MATERIALS, Material


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
