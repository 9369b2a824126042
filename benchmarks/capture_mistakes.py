"""Mistakes that are planted in simulated captures: how often check and calibration name them, and false alarms.

Run it from the top of the repository:
``python -m benchmarks.capture_mistakes [--held-out] [--fresh FIRST] [--only NAME ...]``.
Each rig is drawn once: scene, lens, stage, sensor, board and frame sets. A mistake is planted in a copy of its folder.
It is named if one message has its cause and a remedy. ``--held-out`` takes rigs that have not been used in development;
``--fresh`` checks ten clean rigs from a number on.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from benchmarks.capture_chains import chain_scene
from scenetruth.capture import calibrate_capture, check_capture, simulate_capture
from scenetruth.errors import ScenetruthError

__all__ = ["main"]

Floats = NDArray[np.float64]

_CLEAN, _FRESH, _OPEN, _HELD_OUT = 20, 10, 4, 2
_FIRST_HELD_OUT = 500
_SCENES, _BOARDS = (
    ("plane", "cube", "leaf"),
    ("charuco", "checkerboard", "charuco", "dots", "charuco", "asymmetric_dots"),
)
_PRESETS = ("industrial_cmos", "scientific_cmos", "ccd_2002")


@dataclass(frozen=True)
class Rig:
    """A drawn rig: its scene, and the settings of its capture."""

    number: int
    scene: dict[str, Any]
    settings: dict[str, Any]


def draw_rig(number: int) -> Rig:
    """Return a rig with its own scene, lens, stage, sensor, board and frame sets."""
    generator = np.random.default_rng([number, 11])
    scene = chain_scene(_SCENES[number % 3], 1000 + number)
    scene["frames"] = {"count": 3, "frame_interval_s": 60}
    # Grids of dots, all of which must be visible, leave no room for five positions.
    scene["stage"] |= {"positions": 3 if number % 6 == 3 else (3, 5)[number % 2]}
    scene["sensor"] = {"kind": "emva1288", "preset": _PRESETS[int(generator.integers(3))]}
    kind = _BOARDS[number % len(_BOARDS)]
    distance = scene["objects"][0]["pose"]["position_mm"][2]
    square = round(40 * distance / scene["camera"]["focal_length_px"], 2)
    board: Any = kind
    if kind == "charuco":
        board = {"kind": kind, "squares": [8, 6], "square_mm": square, "marker_mm": round(0.74 * square, 2)}
        board["dictionary"] = "4X4_250"
    sets = number % 4
    settings = {
        "board": board, "poses": 8, "dark": 8, "flat": (16, 16, 0, 0)[sets], "static": (0, 4, 8, 0)[sets],
        "exposures": ((), (0.5, 1.0), (), ())[sets],
        "strip": number % 10 in (3, 8),
    }  # fmt: skip
    return Rig(number, scene, settings)


def make_rig(rig: Rig, folder: Path) -> Path:
    """Return the folder of the capture of a rig, which is simulated once."""
    return simulate_capture(rig.scene, folder / f"rig{rig.number:03d}", **rig.settings)


class Lab:
    """A copy of a capture, in which a mistake is planted."""

    def __init__(self, source: Path, folder: Path, rig: Rig, number: int) -> None:
        shutil.copytree(source, folder, ignore=shutil.ignore_patterns("*.zarr", "points.npz"))
        self.folder, self.rig, self.number = folder, rig, number
        self.plain: dict[str, Any] = yaml.safe_load((folder / "capture.yaml").read_text())
        self.truth: dict[str, Any] = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text())
        shutil.rmtree(folder / "truth")
        self.generator = np.random.default_rng([rig.number, number, 3])
        effects = {each["kind"]: each for each in self.truth["sensor"]["effects"]}
        self.gain = float(effects["gain"]["gain_dn_per_e"])
        self.black = float(self.plain["camera"]["black_level_dn"])
        self.full = 2 ** self.plain["camera"]["bit_depth"] - 1

    def write(self) -> None:
        (self.folder / "capture.yaml").write_text(yaml.safe_dump(self.plain, sort_keys=False))

    def files(self, *sets: str) -> list[Path]:
        return sorted(file for name in sets for file in (self.folder / name).glob("*.tif"))

    def change(self, files: list[Path], function: Callable[[Floats], Floats], **tags: Any) -> None:
        for file in files:
            values = tifffile.imread(file)
            changed = np.clip(np.rint(function(values.astype(np.float64))), 0, self.full)
            tifffile.imwrite(file, np.ascontiguousarray(changed.astype(values.dtype)), **tags)

    def noisy(self, values: Floats) -> Floats:
        """Return values without noise with shot noise of the sensor."""
        noise = np.sqrt(self.gain * np.maximum(values - self.black, 0.0) + 1.0)
        return np.asarray(values + noise * self.generator.standard_normal(values.shape))

    def rename(self, files: list[Path], name: Callable[[str], str]) -> None:
        temporary = [(file.rename(file.with_suffix(".moved")), name(file.name)) for file in files]
        for file, new in temporary:
            file.rename(file.with_name(new))


ALL = ("images", "board", "dark", "flat", "static")


def _scale_board(lab: Lab, factor: float) -> None:
    for name in ("square_mm", "marker_mm", "spacing_mm", "diameter_mm"):
        if name in lab.plain["board"]:
            lab.plain["board"][name] *= factor


def plant_square_size(lab: Lab) -> None:
    _scale_board(lab, (1.05, 0.95)[lab.number % 2])


def plant_axis_swapped(lab: Lab) -> None:
    """The stage moves along the rows of pixels that the file calls columns: every image has a quarter of a turn."""
    lab.change(lab.files(*ALL), lambda values: np.rot90(values, 1 + 2 * (lab.number % 2)))
    camera = lab.plain["camera"]
    camera["width"], camera["height"] = camera["height"], camera["width"]


def plant_reversed(lab: Lab) -> None:
    """All images, or those of the measurement only, are numbered against the direction of the stage."""

    def name(text: str) -> str:
        return re.sub(r"s([+-]\d+)", lambda found: f"s{-int(found[1]):+d}", text)

    lab.rename(lab.files("board") if lab.number % 2 == 0 else [], name)
    lab.rename(lab.files("images"), name)


def plant_unit(lab: Lab) -> None:
    if lab.number % 2:
        _scale_board(lab, 1e-3)
    else:
        lab.plain["stage"]["baseline_mm"] *= 1e-3


def plant_legacy(lab: Lab) -> None:
    lab.plain["board"]["legacy"] = True


def plant_turned(lab: Lab) -> None:
    """A tag in all images; a tag in some; boards turned by half a turn; images of the measurement likewise."""
    variant = lab.number % 4
    tag = {"extratags": [(274, "H", 1, 8, False)]}
    if variant == 0:
        lab.change(lab.files("images", "board"), lambda values: values, **tag)
    elif variant == 1:
        lab.change(lab.files("images")[::4], lambda values: np.rot90(values), **{})
    elif variant == 2:
        lab.change(lab.files(*ALL), lambda values: values[::-1, ::-1])
    else:
        lab.change(lab.files("images"), lambda values: values[::-1, ::-1])


def plant_gamma(lab: Lab) -> None:
    exponent = (0.45, 0.6, 1 / 2.2, 0.45)[lab.number % 4]

    def encode(values: Floats) -> Floats:
        share = values / lab.full
        if lab.number % 4 == 2:
            return np.asarray(lab.full * np.where(share < 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055))
        return np.asarray(lab.full * share**exponent)

    lab.change(lab.files(*ALL), encode)


def plant_saturated(lab: Lab) -> None:
    """The light is as strong as saturates 5 % of the pixels of the measurement, or the white of the board."""
    files = lab.files(("images", "board")[lab.number % 2])
    bright = max(float(np.percentile(tifffile.imread(file), 95)) for file in files)
    factor = 1.1 * (lab.full - lab.black) / (bright - lab.black)
    lab.change(files, lambda values: lab.black + factor * (values - lab.black))


def plant_blurred(lab: Lab) -> None:
    file = lab.files("board")[int(lab.generator.integers(len(lab.files("board"))))]
    width = (1.5, 2.5)[lab.number % 2]
    lab.change([file], lambda values: lab.noisy(gaussian_filter(values, width)))


def plant_misplaced(lab: Lab) -> None:
    """An image is missing (of the measurement, of the board), or two images of one pose or frame are exchanged."""
    variant = lab.number % 4
    files = lab.files("images" if variant in (0, 3) else "board")
    if variant < 2:
        files[int(lab.generator.integers(len(files)))].unlink()
        return
    pattern = "*_t+0.tif" if variant == 3 else f"p{int(lab.generator.integers(8)):02d}_*.tif"
    chosen = sorted((lab.folder / ("images" if variant == 3 else "board")).glob(pattern))
    pair = [chosen[0], chosen[1]]
    lab.rename(pair, lambda name: pair[1].name if name == pair[0].name else pair[0].name)


def plant_dark(lab: Lab) -> None:
    """Light in the dark frames; another exposure; another camera of this type; another black level."""
    files, variant = lab.files("dark"), lab.number % 4
    if variant == 0:
        lab.change(files, lambda values: lab.noisy(values + 0.05 * (lab.full - lab.black)))
    elif variant == 1:
        time_s = lab.plain["camera"].get("exposure_time_s", 0.01)
        lab.plain["files"].pop("exposure_times_s", None)
        tag = {"extratags": [(33434, 5, 1, (round(4e6 * time_s), 1_000_000), False)]}
        lab.change(files, lambda values: values, **tag)
    elif variant == 2:
        other = draw_rig(lab.rig.number)
        other.scene["seed"] += 77
        with tempfile.TemporaryDirectory() as scratch:
            source = simulate_capture(
                other.scene, Path(scratch) / "lab", **{**lab.rig.settings, "poses": 0, "static": 0, "strip": False},
            )  # fmt: skip
            for file in files:
                shutil.copy(source / "dark" / file.name, file)
    else:
        lab.change(files, lambda values: values + 0.4 * lab.black + 3)


def plant_knock(lab: Lab) -> None:
    """The camera is turned by some 5 mrad on its carriage and by 10 mrad about its axis before the measurement.

    With a strip, by 1 and 4 mrad, so that its dots remain in the images.
    """
    camera = lab.truth["camera"]
    f, (c_x, c_y) = camera["focal_length_px"], camera["principal_point_px"]
    k = np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1]])
    size = [1e-3, 1e-3, 4e-3] if lab.rig.settings["strip"] else [5e-3, 5e-3, 1e-2]
    angles = lab.generator.choice([-1, 1], 3) * size * lab.generator.uniform(0.8, 1.3, 3)
    warp = k @ Rotation.from_rotvec(angles).as_matrix() @ np.linalg.inv(k)
    # The scene turns, not the fixed pattern of the sensor.
    dark = np.mean([tifffile.imread(file) for file in lab.files("dark")], axis=0)

    def turn(values: Floats) -> Floats:
        rows, columns = np.indices(values.shape)
        seen = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ warp.T
        where = [seen[..., 1] / seen[..., 2], seen[..., 0] / seen[..., 2]]
        return np.asarray(map_coordinates(values - dark, where, order=3, mode="nearest") + dark)

    lab.change(lab.files("images"), turn)


def plant_exchanged_sets(lab: Lab) -> None:
    lab.plain["files"]["dark"], lab.plain["files"]["flat"] = (lab.plain["files"][name] for name in ("flat", "dark"))


def plant_refocus(lab: Lab) -> None:
    """The focal length is 0.4 % larger in the last four poses."""
    c_x, c_y = lab.truth["camera"]["principal_point_px"]

    def enlarge(values: Floats) -> Floats:
        rows, columns = np.indices(values.shape)
        where = [c_y + (rows - c_y) / 1.004, c_x + (columns - c_x) / 1.004]
        return np.asarray(map_coordinates(values, where, order=3, mode="nearest"))

    lab.change([file for file in lab.files("board") if int(file.name[1:3]) >= 4], enlarge)


def plant_bit_depth(lab: Lab) -> None:
    lab.plain["camera"]["bit_depth"] += (-2, 2)[lab.number % 2] if lab.full < 2**14 else -2


def plant_mirrored(lab: Lab) -> None:
    lab.change(lab.files(*ALL), lambda values: values[:, ::-1])


def plant_second_board(lab: Lab) -> None:
    """One board image shows a second board of the same kind: the left half is that of another pose."""
    one, other = lab.files("board")[0], lab.files("board")[-1]
    second = tifffile.imread(other).astype(np.float64)

    def join(values: Floats) -> Floats:
        return np.concatenate([second[:, : second.shape[1] // 2], values[:, values.shape[1] // 2 :]], axis=1)

    lab.change([one], join)


@dataclass(frozen=True)
class Mistake:
    """A mistake: how it is planted, and by which words it is named."""

    name: str
    plant: Callable[[Lab], None]
    cause: str
    remedy: str
    applies: Callable[[Rig], bool] = lambda rig: True


def _is_charuco(rig: Rig) -> bool:
    board = rig.settings["board"]
    return (board if isinstance(board, str) else board["kind"]) == "charuco"


TWELVE = (
    Mistake("square size 5 %", plant_square_size, "times as long as stated|board scale",
            "square size|size of the squares"),
    Mistake("axis swapped", plant_axis_swapped, "along Y", "axis of the stage|turn of the images",
            lambda rig: not rig.settings["strip"]),
    Mistake("positions reversed", plant_reversed, "against the stated direction|opposite",
            "reverse the positions", lambda rig: not rig.settings["strip"]),
    Mistake("mm and m", plant_unit, "times as long|baseline", "check mm and m|in m\\b"),
    Mistake("legacy pattern", plant_legacy, "other pattern", "set board.legacy", _is_charuco),
    Mistake("turned images", plant_turned, "orientation|exchanged|against the stated direction|opposite",
            "Remove|turn|expected", lambda rig: not rig.settings["strip"]),
    Mistake("gamma", plant_gamma, "exponent|power|gamma|response", "switch off gamma|camera.encoding"),
    Mistake("saturated", plant_saturated, "saturat", "shorten"),
    Mistake("one blurred image", plant_blurred, "blur|sharp|residuals are", "sharp|focus|repeat"),
    Mistake("missing or misplaced image", plant_misplaced, "missing|contradict|from its position", "missing|position"),
    Mistake("wrong dark frames", plant_dark, "dark", "take new dark frames"),
    Mistake("knocked camera", plant_knock, "knock|moved", "calibrat"),
)  # fmt: skip
MORE = (
    Mistake("dark and flat exchanged", plant_exchanged_sets, "exchanged|not brighter|darker", "exchange|take new",
            lambda rig: rig.settings["flat"] > 0),
    Mistake("refocus half-way", plant_refocus, "refocus|halves", "fixed focus|focal"),
    Mistake("bit depth", plant_bit_depth, "bit", "bit_depth"),
    Mistake("mirrored images", plant_mirrored, "mirror", "flip|turn", lambda rig: not rig.settings["strip"]),
    Mistake("two boards in an image", plant_second_board, "p00", "one board|one grid"),
)  # fmt: skip


def inspect(folder: Path) -> tuple[list[str], list[str]]:
    """Return errors and warnings, as the check and the calibration state them, and all notes of the check."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            report = check_capture(folder)
        except (ScenetruthError, ValueError) as error:
            return [f"check: {problem}" for problem in getattr(error, "problems", [error])], []
        found = [f"check: {one}" for one in report.findings if one.severity != "note"]
        notes = [str(one) for one in report.findings if one.severity == "note"]
        if report.usable:
            try:
                found += [f"calibrate: {text}" for text in calibrate_capture(folder).warnings]
            except (ScenetruthError, ValueError) as error:
                found += [f"calibrate: {problem}" for problem in getattr(error, "problems", [error])]
    return found + [f"warning: {one.message}" for one in caught], notes


def run_mistake(mistake: Mistake, rigs: list[Rig], folder: Path, *, loud: bool) -> tuple[int, int]:
    """Return how often a mistake was named, and of how many."""
    named = 0
    for number, rig in enumerate(rigs):
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            lab = Lab(make_rig(rig, folder), Path(scratch) / "lab", rig, number)
            mistake.plant(lab)
            lab.write()
            found, _ = inspect(lab.folder)
        good = [text for text in found if re.search(mistake.cause, text) and re.search(mistake.remedy, text)]
        named += bool(good)
        if loud or not good:
            print(f"  {mistake.name}, rig {rig.number}, variant {number}: {'named' if good else 'NOT NAMED'}")
            for text in found[:6]:
                print(f"    {'*' if text in good else '-'} {text[:300]}")
            if len(found) > 6:
                print(f"    ... {len(found)} messages")
    return named, len(rigs)


def count_alarms(rigs: list[Rig], folder: Path) -> str:
    """Print the messages of clean captures and return how many captures have any."""
    alarms = 0
    for rig in rigs:
        found, _ = inspect(make_rig(rig, folder))
        alarms += bool(found)
        for text in found:
            print(f"  false alarm, rig {rig.number}: {text[:400]}", flush=True)
    return f"clean captures with a message: {alarms} of {len(rigs)} from rig {rigs[0].number}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--held-out", action="store_true", help="rigs that have not been used in development")
    parser.add_argument("--fresh", type=int, metavar="FIRST", help="number of the first of ten clean rigs; no mistakes")
    parser.add_argument("--only", nargs="+", help="names of mistakes, or clean")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "capture_mistakes")
    parser.add_argument("--loud", action="store_true", help="print every message")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    if given.fresh is not None:
        print(count_alarms([draw_rig(given.fresh + number) for number in range(_FRESH)], given.folder))
        return
    first = _FIRST_HELD_OUT if given.held_out else 0
    rigs = [draw_rig(first + number) for number in range(_CLEAN)]
    count = _HELD_OUT if given.held_out else _OPEN
    rows = []
    for mistake in (*TWELVE, *MORE):
        if given.only and not any(word in mistake.name for word in given.only):
            continue
        begin = time.process_time()
        chosen = [rig for rig in rigs if mistake.applies(rig)][:count]
        named, total = run_mistake(mistake, chosen, given.folder, loud=given.loud)
        rows.append(f"{mistake.name:28} {named} of {total} ({time.process_time() - begin:.0f} s)")
        print(rows[-1], flush=True)
    if not given.only or "clean" in given.only:
        rows.append(count_alarms(rigs, given.folder))
    print("\n".join(["", *rows]))


if __name__ == "__main__":
    main()
