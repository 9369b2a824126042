"""A commented capture file, written from the names and headers of the images of a folder."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenetruth.capture.capture_file import CAPTURE_FILE, Capture
from scenetruth.capture.file_patterns import (
    IMAGE_SUFFIXES,
    GuessedPattern,
    expected_indices,
    guess_patterns,
    list_names,
    missing_names,
    read_pattern,
)
from scenetruth.capture.image_reading import ImageHeader, read_header, read_pixels
from scenetruth.capture.ingest import list_missing
from scenetruth.errors import CaptureError, Problem
from scenetruth.scene.picture_file import PictureFileError
from scenetruth.scene.yaml_reader import read_yaml

__all__ = ["capture_text", "write_capture_file"]

_GROUPS: Mapping[str, str] = {
    "dark": r"dark|bias|black|offset",
    "flat": r"flat|white|ff",
    "static": r"static|still|noise",
    "board": r"board|calib\w*|chess\w*|charuco|checker\w*|target|dots",
    "mask": r"mask",
}
_DEPTHS = (8, 10, 12, 14, 16)
_MOST_READ = 3

_TEXT = """\
# Capture: a folder of real images, with its camera and stage. All fields: scenetruth schema capture.
#
#     scenetruth capture check {folder}             look for mistakes that the files show
#     scenetruth capture import {folder} -o RUN     read the images as a recording
#
# Lengths are in mm, times in s, images in px. X points to the right, Y down, Z away from the camera.
# Fill in what ends in a colon, and correct what is marked with CHECK.

format: 1
description: ""

# The camera. Digital numbers must be proportional to light: switch off gamma, sharpening and automatic exposure.
camera:
  width: {width}
  height: {height}
  bit_depth: {bit_depth}        # {bit_note}
  encoding: linear        # or srgb, gamma
  # black_level_dn: 16        # digital number without light; dark frames replace it
  # bayer: rggb        # colours of a mosaic; `plane: green` takes one colour at half the resolution
{exposure}{focal}
# The stage moves the camera along X; positions s of the file names increase to the right. A list `positions_mm` stands
# for positions that are not equidistant; its middle is 0.
stage:
  positions: {positions}        # CHECK: from the file names{position_note}
  baseline_mm: {baseline}
  scan: unidirectional        # or bidirectional
  time_per_position_s: 0        # time from one position to the next; 0 for simultaneous images
  step_std: 1.0e-4        # relative standard deviation of the step length
  # errors: {{preset: screw_stage}}        # tolerances of the stage: screw_stage, air_bearing, or single values

# Frames t: scans of the stage.
frames:
  count: {frames}        # CHECK: from the file names{frame_note}
  frame_interval_s: {interval}        # {interval_note}

# File names: {{s}} position, {{t}} frame, {{pose}} pose of the board, {{level}} exposure; {{s:+d}}, {{t:03d}}: numbers
# of this form; * and ? any text.
files:
  images: {images}        # {image_count} files{doubts}
{sets}{others}{board}
# Distance of the surface from the camera, measured with a ruler: a check of units.
# distance_mm: 660
"""

_BOARD = """
# The calibration board. CHECK all values.
board:
  kind: charuco        # or checkerboard, dots, asymmetric_dots
  squares: [12, 9]        # columns and rows
  square_mm:
  marker_mm:
  dictionary: 4X4_250
  scale_std: 1.0e-3        # relative: 1e-3 printed, 1e-4 measured
  warp_mm: 0.2        # 0.02 glass, 0.2 paper on a plate
"""


@dataclass(frozen=True)
class _Groups:
    """Guessed patterns of a folder by their purpose; ``others`` are the rest."""

    images: GuessedPattern
    sets: Mapping[str, GuessedPattern]
    others: tuple[GuessedPattern, ...]


def capture_text(folder: str | Path, *, focal_length_px: float | None = None, baseline_mm: float | None = None) -> str:
    """Return a commented capture file for a folder, guessed from the names of its image files.

    Parameters
    ----------
    folder
        Folder of the images, in any arrangement of folders below it.
    focal_length_px
        Focal length in px; default: to be filled in.
    baseline_mm
        Displacement between consecutive positions in mm; default: to be filled in.

    Returns
    -------
    str
        Text in YAML. Values that the files do not show are empty.

    Raises
    ------
    CaptureError
        If the folder has no images, or their names have no numbers; lists every problem.

    See Also
    --------
    write_capture_file : Writes it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> with TemporaryDirectory() as folder:
    ...     for s in range(5):
    ...         for t in range(3):
    ...             imageio.imwrite(f"{folder}/pos{s}_t{t:03d}.png", np.full((30, 40), 50, dtype=np.uint8))
    ...     text = capture_text(folder, baseline_mm=5)
    >>> [line.split("#")[0].strip() for line in text.splitlines() if "images: " in line or "positions: " in line]
    ['positions: 5', 'images: "pos{s}_t{t:03d}.png"']
    """
    place = Path(folder)
    problems = [
        Problem(name, "must be positive", value)
        for name, value in (("focal_length_px", focal_length_px), ("baseline_mm", baseline_mm))
        if value is not None and (value == 0 if name == "baseline_mm" else value <= 0)
    ]
    if problems:
        raise CaptureError(problems)
    groups = _find_groups(place)
    header, exposures, times = _headers(place, groups.images)
    pattern = read_pattern(groups.images.text)
    matched = pattern.matches(groups.images.names)
    counts, notes, expected = dict[str, int](), dict[str, str](), dict[str, list[int]]()
    for name in ("s", "t", "row"):
        values = {one.indices[name] for one in matched if name in one.indices}
        expected[name], _ = expected_indices(values or {0}, None)
        counts[name] = len(expected[name])
        notes[name] = f", {min(values)} to {max(values)}" if values else ""
    present: dict[str, list[int]] = {name: expected[name] for name in ("row", "s", "t") if name in pattern.fields}
    missing = missing_names(pattern, present, matched)
    bits, bit_note = _bit_depth(place, groups.images.names, header)
    interval, interval_note = _interval(times, {one.name: one.indices.get("t", 0) for one in matched})
    doubts = f"; CHECK the meaning of {', '.join(groups.images.doubts)}" if groups.images.doubts else ""
    doubts += f"; missing: {list_missing(missing)}" if missing else ""
    sets = "".join(
        f"  {name}: {json.dumps(guess.text)}        # {len(guess.names):,} files\n"
        for name, guess in groups.sets.items()
    )
    others = "".join(f"  # other files: {guess.describe()}\n" for guess in groups.others)
    text = _TEXT.format(
        folder=place,
        width=header.width,
        height=header.height,
        bit_depth=bits,
        bit_note=bit_note,
        exposure=f"  exposure_time_s: {exposures.pop():g}        # from the files\n" if len(exposures) == 1 else "",
        focal=f"  focal_length_px: {focal_length_px:g}\n" if focal_length_px else _NO_FOCAL,
        positions=counts["s"],
        position_note=notes["s"],
        baseline=f"{baseline_mm:g}" if baseline_mm else "       # distance of neighbouring positions in mm",
        frames=counts["t"],
        frame_note=notes["t"],
        interval=interval,
        interval_note=interval_note,
        images=json.dumps(groups.images.text),
        image_count=f"{len(groups.images.names):,}",
        doubts=doubts,
        sets=sets,
        others=others,
        board=_BOARD if "board" in groups.sets else "",
    )
    if counts["row"] > 1:
        text = text.replace("  scan: ", f"  rows: {counts['row']}\n  row_spacing_mm:       # CHECK\n  scan: ", 1)
    return text


_NO_FOCAL = """\
  # focal_length_px: 5000        # focal length in mm divided by the pixel pitch in mm, or from a calibration
"""


def write_capture_file(
    folder: str | Path, *, focal_length_px: float | None = None, baseline_mm: float | None = None
) -> Path:
    """Write ``capture.yaml`` into a folder of images, see `capture_text`.

    Parameters
    ----------
    folder
        Folder of the images.
    focal_length_px, baseline_mm
        As for `capture_text`.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    CaptureError
        If there is a capture file already, or the folder has no images.

    See Also
    --------
    load_capture : Loads the file, after its empty fields were filled in.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> with TemporaryDirectory() as folder:
    ...     for s in range(3):
    ...         imageio.imwrite(f"{folder}/s{s}.png", np.full((30, 40), 50, dtype=np.uint8))
    ...     write_capture_file(folder, baseline_mm=5).name
    'capture.yaml'
    """
    file = Path(folder) / CAPTURE_FILE
    if file.exists() or file.is_symlink():
        raise CaptureError([Problem("FOLDER", f"has a {CAPTURE_FILE} already; move it, or edit it", str(folder))])
    text = capture_text(folder, focal_length_px=focal_length_px, baseline_mm=baseline_mm)
    # With every empty field filled in, the file is valid.
    filled = re.sub(r"^(\s+(?:baseline|square|row_spacing)_mm:)(?=\s*(?:#|$))", r"\1 5 ", text, flags=re.MULTILINE)
    filled = re.sub(r"^(\s+marker_mm:)(?=\s*(?:#|$))", r"\1 4 ", filled, flags=re.MULTILINE)
    plain, problems = read_yaml(filled)
    if problems:
        raise CaptureError(problems, source=file)
    Capture.from_dict(plain, source=file, folder=Path(folder))
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        raise CaptureError([Problem("FOLDER", f"cannot be written: {error.strerror or error}", str(file))]) from error
    return file


def _find_groups(folder: Path) -> _Groups:
    """Return the patterns of a folder by purpose; raises `CaptureError` if there are no images."""
    if not folder.is_dir():
        raise CaptureError([Problem("FOLDER", "is not a directory; specify the directory of your images", str(folder))])
    try:
        names = list_names(folder, suffixes=IMAGE_SUFFIXES)
    except (OSError, ValueError) as error:
        raise CaptureError([Problem("FOLDER", f"cannot be used: {error}", str(folder))]) from error
    if not names:
        raise CaptureError([Problem("FOLDER", f"has no images ({', '.join(IMAGE_SUFFIXES)})", str(folder))])
    by_purpose: dict[str, list[str]] = {}
    for name in names:
        by_purpose.setdefault(_purpose(name), []).append(name)
    if "images" not in by_purpose:
        held = ", ".join(f"{len(files):,} of {purpose}" for purpose, files in by_purpose.items())
        raise CaptureError([Problem("FOLDER", f"has no images of a measurement, only {held}", str(folder))])
    guesses = guess_patterns(by_purpose.pop("images"), ("s", "t", "row"))
    images, *others = guesses
    if not read_pattern(images.text).fields and len(images.names) == 1 and len(guesses) > 1:
        shown = list_missing([guess.names[0] for guess in guesses])
        message = f"has images whose names differ in more than numbers: {shown}; rename them, such as s0_t000.png"
        raise CaptureError([Problem("FOLDER", message, str(folder))])
    sets: dict[str, GuessedPattern] = {}
    for purpose, files in by_purpose.items():
        if purpose == "board":
            found = guess_patterns(files, ("pose", "s", "row"))
            first = found[0]
            if "pose" not in read_pattern(first.text).fields:
                first = GuessedPattern(first.text.replace("{s", "{pose", 1), first.names, ("pose",))
            if "{pose" in first.text:
                sets[purpose] = first
                others += found[1:]
            else:
                others += found
        elif purpose == "mask":
            sets[purpose] = GuessedPattern(files[0], (files[0],))
            others += guess_patterns(files[1:], ())
        else:
            sets[purpose], more = _frames_pattern(files)
            others += more
    return _Groups(images, sets, tuple(others))


def _purpose(name: str) -> str:
    """Return the purpose of a file by the words of its folders and its name."""
    for word in re.split(r"[/_\-. \d]+", name.lower()):
        for purpose, expression in _GROUPS.items():
            if re.fullmatch(rf"(?:{expression})(?:s|frames?|fields?|images?)?", word):
                return purpose
    return "images"


def _frames_pattern(files: Sequence[str]) -> tuple[GuessedPattern, list[GuessedPattern]]:
    """Return the pattern of repeated frames, in which numbers but those of an exposure level are wildcards."""
    found = guess_patterns(files, ("level",))
    first = found[0]
    if "level" in first.doubts:
        first = GuessedPattern(re.sub(r"\{level[^}]*\}", "*", first.text), first.names)
    return first, found[1:]


def _headers(folder: Path, images: GuessedPattern) -> tuple[ImageHeader, set[float], dict[str, float]]:
    """Return the header of the first image, the exposure times and the time stamps of all."""
    header, exposures, times = None, set[float](), dict[str, float]()
    problems = []
    for name in images.names:
        try:
            found = read_header(folder / name)
        except PictureFileError as error:
            problems.append(Problem(name, str(error)))
            continue
        header = header or found
        if found.exposure_time_s is not None:
            exposures.add(found.exposure_time_s)
        if found.taken_s is not None:
            times[name] = found.taken_s
    if problems or header is None:
        raise CaptureError(problems[:50], source=folder)
    return header, exposures, times


def _bit_depth(folder: Path, names: Sequence[str], header: ImageHeader) -> tuple[int, str]:
    """Return the bit depth of the camera and where it comes from."""
    if header.bits <= 8:
        return 8, "bits of the files"
    used = 0
    for name in names[:: max(len(names) // _MOST_READ, 1)][:_MOST_READ]:
        try:
            used |= int(np.bitwise_or.reduce(read_pixels(folder / name), axis=None))
        except PictureFileError as error:
            raise CaptureError([Problem(name, str(error))], source=folder) from error
    depth = next(bits for bits in _DEPTHS if used.bit_length() <= bits)
    return depth, f"CHECK: the files have {header.bits} bits, of which values use {max(used.bit_length(), 1)}"


def _interval(times: Mapping[str, float], frames: Mapping[str, int]) -> tuple[str, str]:
    """Return the time between frames and where it comes from."""
    by_frame: dict[int, list[float]] = {}
    for name, time in times.items():
        by_frame.setdefault(frames[name], []).append(time)
    if len(by_frame) > 1:
        numbers = sorted(by_frame)
        means = [float(np.mean(by_frame[number])) for number in numbers]
        interval = float(np.median(np.diff(means) / np.diff(numbers)))
        if interval > 0:
            return f"{interval:.6g}", "CHECK: from the time stamps of the files"
    return "1", "CHECK: time between consecutive frames in s; not stated in the files"
