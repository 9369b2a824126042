"""Settings are shown in the words of their models, with units, and as a text that a scene file accepts."""

from __future__ import annotations

import json
import re

import pytest
import yaml

from scenetruth.estimators import choose, find_method, list_methods
from scenetruth.scoring.report import describe_settings, name_setting

INSTALLED = [entry.name for entry in list_methods() if entry.origin == "scenetruth"]
UNIT = re.compile(r"_(px|mm|frames|deg)$")


@pytest.mark.parametrize("method", INSTALLED)
def test_names_of_built_in_settings_are_words_and_differ(method: str) -> None:
    settings = find_method(method).settings().model_dump(mode="json")
    table = describe_settings(method, settings)
    assert table is not None
    assert [row.key for row in table.rows] == list(settings)
    names = [row.name for row in table.rows]
    assert len(set(names)) == len(names)
    for row in table.rows:
        assert row.name != name_setting(row.key)[0], f"{row.key} has no description"
        assert not re.search(r"[a-z]_[a-z]{2}|`|\bin$|,$", row.name)
        assert row.name[0].isupper()
        assert row.default == ""
        value = settings[row.key]
        if UNIT.search(row.key) and isinstance(value, int | float) and not isinstance(value, bool):
            assert re.search(r"[\d.]+\N{NO-BREAK SPACE}(px|mm|frames?)", row.value)


@pytest.mark.parametrize("method", INSTALLED)
def test_the_text_for_a_scene_file_is_the_same_choice(method: str) -> None:
    settings = find_method(method).settings()
    table = describe_settings(method, settings.model_dump(mode="json"))
    assert table is not None
    assert choose(yaml.safe_load(table.text)["estimate"]).settings == settings


def test_nested_settings_are_within_theirs_and_changes_state_the_default() -> None:
    given = {"noise": {"dark_noise_dn": 2.0, "gain_dn_per_e": 0.5, "dark_level_dn": 3.0}, "window_sigma_px": 4.0}
    table = describe_settings("refined", json.loads(json.dumps(given)))
    assert table is not None
    found = {row.key: (row.value.replace("\N{NO-BREAK SPACE}", " "), row.default) for row in table.rows}
    assert found["noise.dark_noise_dn"] == ("2 DN", "")
    assert found["noise.gain_dn_per_e"] == ("0.5 DN/e⁻", "")
    assert found["noise.dark_level_dn"] == ("3 DN", "0\N{NO-BREAK SPACE}DN")
    assert found["window_sigma_px"] == ("4 px", "6\N{NO-BREAK SPACE}px")
    assert all(row.name.startswith("Noise variance as a function of the grey value: ") for row in table.rows[:3])


@pytest.mark.parametrize("method", ["", "their_program", "os:system", "mine.py:method"])
def test_settings_of_methods_that_are_not_installed_are_words_of_their_keys(method: str) -> None:
    table = describe_settings(method, {"subset_px": 29, "smooth_images": True, "weights": {"outer_mm": 2.5}})
    assert table is not None
    assert [(row.name, row.value.replace("\N{NO-BREAK SPACE}", " ")) for row in table.rows] == [
        ("Subset", "29 px"),
        ("Smooth images", "yes"),
        ("Weights: outer", "2.5 mm"),
    ]
    assert ("method:" in table.text) == bool(method)


def test_without_settings_there_is_no_table() -> None:
    assert describe_settings("refined", {}) is None
