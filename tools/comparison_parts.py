"""Parts of the comparison: each records what a user can see of one feature of a checkout."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from comparison_adapter import (
    Scenes,
    api,
    call,
    find_attribute,
    first_parameter,
    member,
    schema_names,
    to_plain,
    to_table,
    words_of,
)
from comparison_commands import record_commands
from comparison_interface import record_help, record_lists, record_names, record_schemas
from comparison_records import Records
from comparison_renames import Renames
from comparison_scenes import VARIATIONS, WALL, made_scenes

__all__ = ["PARTS", "Context"]

_METHODS = ("structure_tensor", "refined", "plane_sweep")
_SETTINGS: dict[str, tuple[str, Mapping[str, Any]]] = {
    "structure_tensor by the paper": ("structure_tensor", {"divergence": "paper", "tau": "auto", "pyramid_levels": 1}),
    "structure_tensor small window": ("structure_tensor", {"window_sigma_px": 3, "window_taps_px": 13}),
    "refined growing": ("refined", {"motion": "growing", "surface": "plane", "window_sigma_px": 4}),
    "refined affine curved": ("refined", {"motion": "affine", "surface": "curved", "brightness": "none"}),
    "refined translation": ("refined", {"motion": "translation", "acceleration": False, "start": "structure_tensor"}),
    "refined without outlines": ("refined", {"outlines": False, "unfitted": "nothing", "noise": "estimated"}),
    "refined corrections": ("refined", {"corrections": {"x_px": 0.05, "y_px": 0.05, "roll_urad": 50}}),
    "plane_sweep of a range": ("plane_sweep", {"disparity_px": [1, 8], "distinctness": 1.1}),
}
"""Label to method and settings, beside the defaults of every method."""


@dataclass
class Context:
    """What a part works with.

    Parameters
    ----------
    records
        Where results go.
    scenes
        The bundled scenes of the checkout.
    chosen
        Names of bundled scenes.
    renames
        The table of renamed names.
    work
        An empty folder.
    checkout
        The checkout.
    """

    records: Records
    scenes: Scenes
    chosen: list[str]
    renames: Renames
    work: Path
    checkout: Path

    def each_scene(self) -> Iterator[tuple[str, Callable[[], Any]]]:
        """Give all scenes by name, with what loads them: bundled ones, those with changes, and made ones."""
        for name in self.chosen:
            yield name, partial(self.scenes.load, name)
        for name, (base, changes) in VARIATIONS.items():
            if base in self.chosen:
                yield name, partial(self.scenes.load, base, changes)
        for name, plain in made_scenes(self.work).items():
            yield name, partial(self.scenes.read, plain)

    def some_scenes(self, *names: str) -> list[str]:
        """Return those of some bundled scenes that are chosen; the first chosen one if none is."""
        return [name for name in names if name in self.chosen] or self.chosen[:1]


def recordings(context: Context) -> None:
    """Record images, linear images, planned poses and times, attributes."""
    for name, load in context.each_scene():
        key = f"recordings / {name}"
        with context.records.guarded(key):
            recording, _ = call(api("simulate"), load(), ideal=True)
            context.records.dataset(key, recording)


def truths(context: Context) -> None:
    """Record all maps, of one camera and of all, with real and nominal poses; points that are followed."""
    records, make = context.records, api("make_truth")
    for name, load in context.each_scene():
        key = f"truths / {name}"
        with records.guarded(key):
            scene = load()
            truth = call(make, scene, truth_content="standard" if name == "rolling shutter" else "complete")
            records.dataset(key, truth)
            if name in ("cube", "stage with errors", "stage of a preset", "leaf"):
                records.dataset(f"{key}, all cameras", call(make, scene, truth_views="all"))
                records.dataset(f"{key}, nominal poses", call(make, scene, truth_poses="nominal"))
            if name in ("cube", "leaf", "motions"):
                points = call(api("track_points"), scene, truth, [-1.0, 0.25, 1.0])
                records.array(f"{key}, points", points)


@dataclass
class _Estimation:
    """Data for an estimate: a scene, its recording and its truth, and what makes the estimate."""

    scene: Any
    recording: Any
    truth: Any
    make: Callable[[], Any]


def _estimations(context: Context) -> Iterator[tuple[str, _Estimation]]:
    """Give estimations by name: of every built-in method, with its defaults and with other settings."""
    estimate = api("estimate")
    scenes = {
        name: partial(context.scenes.load, name, width=96, crop=True) for name in context.some_scenes(*_ESTIMATED)
    }
    for name in ("stage with errors", "listed positions", "sensor of effects"):
        base, changes = VARIATIONS[name]
        if base in context.chosen:
            scenes[name] = partial(context.scenes.load, base, changes)
    for name, load in scenes.items():
        with context.records.guarded(f"estimations / {name}"):
            scene = load()
            recording, truth = api("simulate")(scene)
            made = partial(_Estimation, scene, recording, truth)
            varied = name in VARIATIONS
            if not varied:
                yield (
                    f"{name}, of the scene",
                    made(partial(estimate, recording, **member(scene, "estimate").model_dump())),
                )
            for method in ("structure_tensor", "refined") if varied else _method_names():
                if method == "structure_tensor" and "s_y" in recording["image"].dims:
                    continue  # it takes one row of cameras at a time
                yield f"{name}, {method}", made(partial(estimate, recording, method))
            for label, (method, settings) in _SETTINGS.items() if name in ("cube", "leaf") else ():
                with_settings = partial(_with_settings, context, recording, method, settings)
                yield f"{name}, {label}", made(with_settings)


_ESTIMATED = ("cube", "leaf", "plane", "rubber_sheet", "occluders", "relief")


def _with_settings(context: Context, recording: Any, method: str, settings: Mapping[str, Any]) -> Any:
    """Return an estimate with settings of a method, in the names that the checkout has for them."""
    model = member(api("find_method")(method), "settings")
    forms = [form[method] for form in context.renames.inputs({method: dict(settings)}, words_of(model) | {method})]
    for form in forms:
        try:
            model.model_validate(form)
        except ValueError:
            continue
        return api("estimate")(recording, method, form)
    return api("estimate")(recording, method, dict(settings))


def _method_names() -> list[str]:
    return [member(entry, "name") for entry in api("list_methods")() if not member(entry, "problem")]


def estimates(context: Context) -> None:
    """Record estimates of every built-in method with its defaults and of some with other settings."""
    for name, one in _estimations(context):
        with context.records.guarded(f"estimates / {name}"):
            context.records.dataset(f"estimates / {name}", one.make())


def scores(context: Context) -> None:
    """Record all statistics of all regions and quantities, the growth rate of maps, detected mismatches."""
    records, sections = context.records, ("regions", "quantities", "statistics")
    for name, one in _estimations(context):
        if "sensor" in name or "refined " in name:
            continue
        key = f"scores / {name}"
        with records.guarded(key):
            estimate, truth, recording = one.make(), one.truth, one.recording
            found = call(api("score"), estimate=estimate, truth=truth, recording=recording)
            records.flat(f"{key} / values", member(found, "regions"), sections)
            records.flat(f"{key} / metadata", member(found, "metadata"), ("attributes",))
            records.table(f"{key} / table", to_table(found))
            records.prose(f"{key} / line", repr(found))
            records.flat(f"{key} / mismatches", api("mismatches")(estimate, truth))
            if not name.endswith("of the scene"):
                continue
            for label, maps in (("truth", truth), ("estimate", estimate)):
                if "velocity" in maps and "depth" in maps:
                    records.flat(f"{key} / growth rate of the {label}", call(api("growth_rate"), maps))
            given = {"estimate": estimate, "truth": truth, "recording": recording}
            if "margin_px" in inspect.signature(api("score")).parameters:
                found = call(api("score"), **given, margin_px=2.0)
            else:
                found = call(api("score"), **given, settings={"interior_margin_px": 2.0})
            records.flat(f"{key} / values, margin of 2 px", member(found, "regions"), sections)
            wrong = estimate.copy()
            for each, factor in (("depth", 0.001), ("disparity", -1), ("velocity", -1000), ("flow", 0.5)):
                if each in wrong:
                    wrong[each] = wrong[each] * factor
            records.flat(f"{key} / mismatches of wrong units", api("mismatches")(wrong, truth))


def predictions(context: Context) -> None:
    """Record predictions of both levels, recommendations, and bounds."""
    records, scenes = context.records, context.scenes
    cases = {name: partial(scenes.load, name, width=96, crop=True) for name in context.some_scenes("cube", "leaf")}
    cases |= {name: partial(scenes.load, name) for name in context.some_scenes("plane", "rubber_sheet", "plaid")}
    if "plaid" in cases:
        cases["plaid"] = partial(scenes.load, "plaid", {"sensor": {"noise_std": 0.01}})
    cases["wall"] = partial(scenes.read, WALL)
    for name, load in cases.items():
        for level, method in (("envelope", "refined"), ("envelope", "structure_tensor"), ("bound", "refined")):
            key = f"predictions / {name}, {level}, {method}"
            with records.guarded(key):
                scene = load()
                found = call(api("predict"), scene, level=level, method=method)
                _result(records, key, found)
                records.prose(f"{key} / recommendations", list(call(api("recommend"), scene, found)))
    recording, truth = call(api("simulate"), scenes.load(context.some_scenes("cube")[0]), ideal=True)
    rig = {"focal_length_px": 1000, "baseline_mm": 5, "positions": 5, "frames": 5, "depth_mm": 500}
    for motion in ("translation", "rigid", "growing", "affine"):
        key = f"predictions / bound, {motion}"
        with records.guarded(key):
            found = call(api("cramer_rao"), truth=truth, recording=recording, motion=motion, noise_std=2.0, every_px=4)
            records.dataset(key, found)
            found = call(api("closed_form"), **rig, gradient=2.2, noise_std=1.0, motion=motion)
            records.flat(f"{key}, closed form", found)


def _result(records: Records, key: str, result: Any) -> None:
    """Record a result: its fields, its table, and its summary in words."""
    records.flat(f"{key} / fields", result)
    records.table(f"{key} / table", to_table(result))
    words = next((name for name in ("summary", "words") if hasattr(result, name)), "")
    if words:
        records.prose(f"{key} / words", find_attribute(result, words))


def budget(context: Context) -> None:
    """Record uncertainty budgets of a wall by two methods: contributions, totals, files."""
    for method, share in (("structure_tensor", 1.0), ("refined", 0.3)):
        key, folder = f"budget / {method}", context.work / f"budget of {method}"
        with context.records.guarded(key):
            scene = context.scenes.read(WALL)
            found = call(api("budget"), scene, folder=folder, method=method, draws=1, confirm=share)
            _result(context.records, key, found)
            context.records.folder(f"{key} / folder", folder)


def sweep(context: Context) -> None:
    """Record a sweep over a grid and one over a range, each with two seeds."""
    grid: dict[str, Any] = {"vary": {"stage.baseline_mm": [2, 4]}, "methods": ["structure_tensor", "refined"]}
    ranges: dict[str, Any] = {"vary": {"sensor.noise_std": "0.002..0.02:log"}, "methods": ["structure_tensor"]}
    for label, given in {"grid": grid, "range": {**ranges, "sobol": 2}}.items():
        key, folder = f"sweep / {label}", context.work / f"sweep of {label}"
        with context.records.guarded(key):
            scene = context.scenes.read(WALL)
            for form in context.renames.inputs(given.pop("vary"), schema_names("Scene"))[:1]:
                found = call(api("sweep"), scene, form, folder=folder, seeds=2, **given)
            _result(context.records, key, found)
            context.records.folder(f"{key} / folder", folder)


def design(context: Context) -> None:
    """Record a design of a wall with 48 predictions and two simulated rigs."""
    goal = {
        "title": "A wall",
        "scene": WALL,
        "free": {"stage.baseline_mm": {"from": 2, "to": 10, "log": True}, "stage.positions": {"from": 2, "to": 5}},
        "constraints": [{"kind": "stage_travel", "at_most": 16}, {"kind": "images", "at_most": 15}],
        "objectives": [{"quantity": "depth"}, {"quantity": "velocity_z", "within": 0.5}],
        "search": {"predictions": 48, "morris": 2, "sobol": 8, "seed": 3},
        "confirm": {"rigs": 2, "seeds": 2},
    }
    folder = context.work / "design"
    with context.records.guarded("design"):
        found = call(api("optimise"), context.scenes.form(goal, "Goal"), folder=folder)
        _result(context.records, "design", found)
        context.records.flat("design / plain", to_plain(found))
        context.records.folder("design / folder", folder)


def pattern(context: Context) -> None:
    """Record patterns to print, their assessment and files."""
    rig = {"focal_length_px": 2500, "distance_mm": 500, "baseline_mm": 5, "positions": 5, "frames": 5}
    for kind in ("speckle", "noise", "grey_noise"):
        key, folder = f"pattern / {kind}", context.work / f"pattern of {kind}"
        with context.records.guarded(key):
            found = api("pattern")(call(api("pattern_rig"), **rig), kind, size_mm=(20, 20), seed=1)
            context.records.array(
                f"{key} / reflectance", member(found, "radiance", "reflectance")((0, 0, 20, 20), (100, 100))
            )
            context.records.flat(f"{key} / plain", to_plain(found))
            context.records.flat(f"{key} / assessment", api("assess_pattern")(found))
            folder.mkdir()
            api("write_pattern")(found, folder, page="A5")
            context.records.folder(f"{key} / folder", folder)


def benchmark(context: Context) -> None:
    """Record all cases of the short benchmark suite at one level each, two of them with two methods."""
    records = context.records
    for kind, case in api("cases")().items():
        level = next(iter(member(case, "values", "levels")("core")), None)
        if level is None:
            continue
        two = kind.startswith(("noise", "disparity"))
        key, folder = f"benchmark / cases:{kind}", context.work / f"benchmark of {kind}"
        with records.guarded(key):
            methods = ["structure_tensor", "refined"] if two else ["structure_tensor"]
            found = call(api("compare"), methods, folder=folder, cases=[kind], values=[level])
            records.table(f"{key} / table", to_table(found))
            records.table(f"{key} / summary", find_attribute(found, "ranking", "summary"))
            records.table(f"{key} / efficiency", find_attribute(found, "efficiency"))
            records.prose(f"{key} / failures", list(member(found, "failures")))
            records.folder(f"{key} / folder", folder)


def dataset(context: Context) -> None:
    """Record two samples of a recipe in folders, two of another in shards: stores, catalogue, scores, card."""
    for name, layout in (("cubes", "folder"), ("leaves", "shards")):
        with context.records.guarded(f"dataset / {layout}"):
            _data_set(context, name, layout)


def _data_set(context: Context, name: str, layout: str) -> None:
    import yaml

    records, place = context.records, context.work / f"data set in {layout}"
    file = context.scenes.file(f"datasets/{name}.yaml", f"recipes/{name}.yaml")
    # The recipe is that of the checkout, in its names; what is added here is in the names of the checkout before.
    plain = yaml.safe_load(file.read_text(encoding="utf-8"))
    small = {"camera.width": 64, "camera.height": 48, "camera.focal_length_px": 400, "frames.count": 3}
    plain["set"] = {**plain.get("set", {}), **small, "render.backend": "raycast"}
    plain = {key: value for key, value in plain.items() if key not in ("paired", "paired_factors")}
    plain |= {"samples": 2, "layout": layout}
    if layout == "shards":
        plain |= {"ideal": True, "truth": {"poses": "real", "content": "complete"}}
    recipe = context.work / f"{layout}.yaml"
    recipe.write_text(yaml.safe_dump(context.scenes.form(plain, "Recipe"), sort_keys=False), encoding="utf-8")
    call(api("run_dataset"), api("load_recipe")(recipe), folder=place)
    samples = api("open_dataset")(place)
    for number in range(len(samples)):
        key = f"dataset / {layout} / sample {number}"
        records.dataset(f"{key} / recording", member(samples[number], "recording"))
        records.dataset(f"{key} / truth", member(samples[number], "truth"))
        records.flat(f"{key} / drawn", dict(find_attribute(samples[number], "values", "parameters")))
    if layout == "folder":
        call(api("estimate_dataset"), place, "structure_tensor")
        call(api("write_card"), place)
    records.folder(f"dataset / {layout} / folder", place)


def exports(context: Context) -> None:
    """Record files of every format of export: of a truth and of an estimate, with colours, and with other options."""
    records, simulate, name = context.records, api("simulate"), context.some_scenes("cube")[0]
    recording, truth = simulate(context.scenes.load(name, width=64), truth_content="complete", truth_views="all")
    estimate = api("estimate")(recording, "structure_tensor")
    base, changes = VARIATIONS["sensor of a preset"]
    coloured = simulate(context.scenes.load(base, changes, width=48), truth_content="complete")
    base, changes = VARIATIONS["stage with errors"]
    stage = {name: value for name, value in changes["stage"].items() if name not in ("rows", "row_spacing_mm")}
    moved = simulate(context.scenes.load(base, {**changes, "stage": stage}, width=48), truth_views="all")
    options: dict[str, dict[str, Any]] = {"exr": {"compression": "none"}, "npz": {"compress": False}}
    options |= {"ply": {"coordinates": "float32"}, "png": {}, "tiff": {}, "colmap": {"every": 2}}
    options["opencv_yaml"] = {"poses": "real"}
    for kind in api("export_formats")():
        for label, data, chosen in (
            ("truth", (recording, truth), {}),
            ("estimate", (recording, estimate), {}),
            ("colours", coloured, {}),
            ("stage errors", moved, {}),
            ("options", (recording, truth), options.get(kind, {"image_bits": 16})),
        ):
            key, folder = f"exports / formats:{kind} / {label}", context.work / f"{kind} of {label}"
            try:
                written = _export(context, data, folder, kind, chosen)
            except Exception as error:  # a format that does not suit these data
                records.put(f"{key} / problem", type(error).__name__)
                records.prose(f"{key} / problem", str(error))
                continue
            records.prose(f"{key} / notes", list(member(written, "notes")))
            records.folder(key, folder)


def _export(context: Context, data: tuple[Any, Any], folder: Path, kind: str, options: Mapping[str, Any]) -> Any:
    export = api("export")
    # Options have the names of the checkout before; the first form that the checkout takes is meant.
    forms = context.renames.inputs(dict(options), words_of(api("format_models")()[kind])) if options else [{}]
    for number, form in enumerate(forms, start=1):
        try:
            if first_parameter(export) == "source":
                return export(data, kind, output=folder, **form)
            return export(*data, folder, kind, **form)
        except Exception:  # of any class: the next form may be accepted
            if number == len(forms):
                raise
    return None


def run(context: Context) -> None:
    """Record the folder of a run by three methods: stores, scores, reports, figures, images; its verification."""
    records = context.records
    stages = ("render", "estimate", "score", "report")
    for name, given in (
        ("leaf", {"images": "png", "stages": stages, "methods": _METHODS}),
        ("cube", {"images": "tiff", "stages": stages[:3], "methods": _METHODS[:1]}),
    ):
        key, folder = f"run / {name}", context.work / f"run of {name}"
        with records.guarded(key):
            scene = context.scenes.load(name, width=64)
            call(api("run_scene"), scene, folder=folder, ideal=True, **given)
            records.folder(f"{key} / folder", folder)
            records.flat(f"{key} / verified", api("verify")(folder))


def external(context: Context) -> None:
    """Record files for programs of other languages, and results that are read from them; data sets of arrays."""
    records = context.records
    recording, truth = api("simulate")(context.scenes.load(context.some_scenes("cube")[0], width=48))
    for images in ("png", "tiff", "npy"):
        with records.guarded(f"external / {images}"):
            folder = context.work / f"images as {images}"
            api("write_recording")(recording, folder, images)
            records.folder(f"external / {images}", folder)
    with records.guarded("external / results"):
        folder = context.work / "results"
        folder.mkdir()
        np.save(folder / "depth.npy", truth["depth"].values.astype(np.float32))
        np.save(folder / "flow.npy", truth["flow"].transpose("image_component", "t", "y", "x").values)
        records.dataset("external / results", api("read_results")(folder, recording))
    with records.guarded("external / arrays"):
        made = call(api("make_recording"), np.zeros((3, 2, 6, 8)), focal_length_px=500, baseline_mm=5)
        records.dataset("external / arrays / recording", made)
        depth = np.full((2, 6, 8), 600.0)
        records.dataset("external / arrays / estimate", call(api("make_estimate"), depth=depth, like=made))


def validation(context: Context) -> None:
    """Record the virtual EMVA 1288 measurement of a sensor."""
    folder = context.work / "emva"
    with context.records.guarded("validation / emva1288"):
        context.records.flat("validation / emva1288", list(api("emva")(folder, ["industrial_cmos"])))
        context.records.folder("validation / emva1288 / folder", folder)


def names(context: Context) -> None:
    """Record names that can be imported, arguments with defaults, members of classes."""
    record_names(context.records, context.checkout)


def command_help(context: Context) -> None:
    """Record commands, options, types and defaults; the text of every help page."""
    record_help(context.records)


def lists(context: Context) -> None:
    """Record methods, formats, cases, bundled files, checks."""
    record_lists(context.records, context.checkout)


def schemas(context: Context) -> None:
    """Record JSON Schemas of scenes, recipes, goals, settings of methods and options of formats."""
    record_schemas(context.records)


def runs(context: Context) -> None:
    """Record runs of the command line: exit codes, text, files."""
    goal = {
        "title": "A wall",
        "scene": WALL,
        "free": {"stage.baseline_mm": {"values": [2, 4, 6]}},
        "constraints": [{"kind": "stage_travel", "at_most": 16}],
        "objectives": [{"quantity": "depth"}],
        "search": {"predictions": 16, "morris": 0, "sobol": 0},
        "confirm": {"rigs": 1, "seeds": 1},
    }
    recipe = {
        "name": "walls",
        "base": {"scene": WALL},
        "samples": 2,
        "vary": {"objects.0.pose.position_mm.2": {"kind": "uniform", "low": 400, "high": 600}},
        "accept": [{"kind": "depth", "at_most": 2000}],
        "splits": {"train": 1, "test": 1},
    }
    broken = {**WALL, "camera": {"width": 0, "height": 48}, "stage": {"positions": 3}, "sensors": {}}
    inputs = {
        "goal.yaml": context.scenes.form(goal, "Goal"),
        "recipe.yaml": context.scenes.form(recipe, "Recipe"),
        "wall.yaml": context.scenes.form(WALL, "Scene"),
        "broken.yaml": broken,
    }
    record_commands(context.records, context.renames, context.work, inputs)


PARTS: dict[str, Callable[[Context], None]] = {
    "names": names,
    "help": command_help,
    "lists": lists,
    "schemas": schemas,
    "recordings": recordings,
    "truths": truths,
    "estimates": estimates,
    "scores": scores,
    "predictions": predictions,
    "budget": budget,
    "sweep": sweep,
    "design": design,
    "pattern": pattern,
    "benchmark": benchmark,
    "dataset": dataset,
    "exports": exports,
    "run": run,
    "external": external,
    "validation": validation,
    "runs": runs,
}
"""All parts by name, in their order."""
