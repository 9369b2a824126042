"""The changelog names everything that was renamed since version 0.2."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from scenetruth.testing import estimator_checks

CHANGELOG = (Path(__file__).parents[2] / "CHANGELOG.md").read_text(encoding="utf-8").partition("\n## [0.2.0]")[0]

DOCUMENTED = {
    "scenetruth": (
        "load_scene scene_from_plain Scene Limits simulate make_truth track_points two_point_correction run_scene "
        "RunFolder verify_folder make_recording make_estimate save load open_store estimate score Score "
        "surface_growth write_report compare Comparison load_recipe recipe_from_plain run_dataset open_dataset "
        "predict Prediction sweep Sweep Budget Design export_run export_data export_formats ScenetruthError Problem "
        "SceneError RecipeError RecordingError EstimateError ScoreError MismatchError RenderError "
        "BackendUnavailableError MachineError StoreError OutputExistsError ExportError SceneWarning EstimateWarning"
    ),
    "scenetruth.estimators": (
        "DEFAULT_METHOD Estimator Method StreamingMethod Estimation MethodSettings Needs MethodEntry method_entries "
        "find_method validate_settings"
    ),
    "scenetruth.estimators.external": ("CommandMethod ResultsFolder write_recording read_results recording_key"),
    "scenetruth.bound": ("cramer_rao envelope_of Envelope gradient_of_texture"),
    "scenetruth.design.predict": ("Figure Causes advise"),
    "scenetruth.design.budget": ("budget Calibration"),
    "scenetruth.design.optimise": ("optimise load_goal goal_from_plain Goal"),
    "scenetruth.design.page.write": ("write_design_page"),
    "scenetruth.design.pattern": ("make_pattern write_pattern pattern_worth rig_of Pattern Rig Worth"),
    "scenetruth.schema": ("make_estimate pixel_grid_of"),
    "scenetruth.camera": ("chain_of"),
    "scenetruth.camera.sensor.base": ("Effect Exposure Unit"),
    "scenetruth.model": ("NonNegative Positive Vector3"),
    "scenetruth.scene.jets": ("Field"),
    "scenetruth.scene.motion": ("compose"),
    "scenetruth.scene.motion.base": ("MotionModel PointMap Points"),
    "scenetruth.export": ("checked_source write_export export_formats"),
    "scenetruth.export.base": ("ExportFormat"),
    "scenetruth.export.geometry": ("point_problems points_in_world"),
    "scenetruth.export.raster": ("image_name"),
    "scenetruth.export.source": ("Source"),
    "scenetruth.testing": (
        "estimator_checks EstimatorCheck check_estimator ConformanceReport ConformanceError assert_accuracy LimitError"
    ),
}
"""All names of the reference of version 0.2 and of its pages on extensions, by module."""
CHECKS = (
    "at_rest crop deterministic exchanged_cameras form frame_interval frame_numbers gives_what_it_promises grey_scale "
    "image_types input_unchanged lengths mask memory_layout mirror_x mirror_y missing_is_nan not_finite own_arrays "
    "part_of_cameras part_of_frames principal_point progress quantities_agree read_only_input reversed_time round_trip "
    "single_camera single_frame standard_deviations streaming thread_safe truth_in_the_middle unknown_settings"
)
"""All checks of conformance of version 0.2."""
MOVED = {
    "scenetruth.design.budget": "scenetruth.design.uncertainty",
    "scenetruth.design.optimise": "scenetruth.design.optimisation",
    "scenetruth.design.pattern": "scenetruth.design.patterns",
    "scenetruth.design.predict": "scenetruth.design.prediction",
}
"""Modules that have another name, with the names that stay."""


def renamed() -> dict[tuple[str, str], str]:
    """Return the new names of the table of public names, by module and old name."""
    table = CHANGELOG.partition("### Breaking changes: public names")[2].partition("\n### ")[0]
    found = {}
    for line in re.findall(r"^\| (?:`([\w.]*)` )?\| (`.*?) \| (.*) \|$", table, re.MULTILINE):
        module, before, now = line
        for name in re.findall(r"`(\w+)`", before):
            found[f"scenetruth{module}", name] = now
    return found


def exported(module: str, name: str) -> bool:
    """Return whether a class, function or value can be imported from a module."""
    try:
        return not isinstance(getattr(import_module(module), name), ModuleType)
    except (ImportError, AttributeError):
        return False


@pytest.mark.parametrize("module", DOCUMENTED)
def test_a_name_of_the_reference_is_there_or_has_its_new_name(module: str) -> None:
    place = MOVED.get(module, module)
    assert module == place or f"`{module.removeprefix('scenetruth.')}`" in CHANGELOG
    for name in DOCUMENTED[module].split():
        assert exported(place, name) != ((module, name) in renamed()), f"{module}.{name}"


def test_a_check_of_conformance_is_there_or_has_its_new_name() -> None:
    table = CHANGELOG.partition("| conformance check before | now |\n|---|---|\n")[2].partition("\n\n")[0]
    rows = [[re.findall(r"`(\w+)`", cell) for cell in line.strip("| ").split(" | ")] for line in table.splitlines()]
    new = {old: name for before, now in rows for old, name in zip(before, now, strict=True)}
    present = {check.__name__ for check in estimator_checks("plane_sweep")}
    assert set(new.values()) <= present
    for name in CHECKS.split():
        assert (name in present) != (name in new), name


def test_new_names_can_be_imported() -> None:
    for (module, name), now in renamed().items():
        package = re.match(r"`([\w.]+)`: ", now)
        places = [f"scenetruth.{package.group(1)}"] if package else ["scenetruth", module]
        for full in re.findall(r"`([\w.]+)`(?!:)", now):
            first, *rest = full.split(".")
            found = [place for place in places if exported(place, first)]
            assert found, f"{name}: {full}"
            assert all(hasattr(getattr(import_module(found[0]), first), part) for part in rest), full
