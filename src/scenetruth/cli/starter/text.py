"""The text of a scene file to start from: the blocks that all scenes have, around the objects of one."""

from __future__ import annotations

import json
from dataclasses import dataclass
from textwrap import indent

from scenetruth.errors import visible

__all__ = ["Start", "scene_text"]


@dataclass(frozen=True)
class Start:
    """What distinguishes one scene to start from among others.

    Parameters
    ----------
    summary
        What the scene shows, in one line.
    first
        What to change first, a line each.
    objects
        The list of objects, in YAML with comments.
    focal_length_px, focal_note
        Focal length of the camera in px, and what that makes of the scene.
    baseline_mm, baseline_note
        Way of the stage from position to position in mm, and what that makes of the scene.
    frame_interval_s
        Time from frame to frame in s.
    blocks
        Further blocks, in YAML with comments.
    sensor, estimate
        Fields of the sensor and of the method, in YAML.
    """

    summary: str
    first: tuple[str, ...]
    objects: str
    focal_length_px: float
    focal_note: str
    baseline_mm: float
    baseline_note: str
    frame_interval_s: float = 1.0
    blocks: str = ""
    sensor: str = "bit_depth: 8\nnoise_std: 0.01"
    estimate: str = "method: structure_tensor"


_TEXT = """\
{schema}
# {summary}
#
# Lengths are in mm, times in s, images in px. X points to the right, Y down, Z away from the camera, which looks along
# +Z from the origin. All fields with their defaults: scenetruth schema. Scenes to copy from: scenetruth scenes.
#
# What to change first:
{first}
#
#     scenetruth check {file}                        what will be made of it, and what that takes
#     scenetruth run {file} -o outputs/first         images, truth, estimate, score, report

# What the scene is for, in one line; pages show it.
description: {description}

# The camera: size of the images in px, and focal length in px, which is the one in mm divided by the distance of two
# pixels on the sensor in mm: 25 mm and 3.45 um are 7246 px.
camera:
  width: 640
  height: 480
  focal_length_px: {focal_length_px:g}        # {focal_note}

# The stage carries the camera along X: so many images of every frame, so many mm from one to the next. A longer way
# tells depth better, as far as all images still show the same.
stage:
  positions: 5
  baseline_mm: {baseline_mm:g}        # {baseline_note}

# Frames: how often the stage takes its images, and how many seconds pass from one frame to the next. Motions are told
# per frame, growth per hour.
frames:
  count: 9
  frame_interval_s: {frame_interval_s:g}

# What stands before the camera. Each object has a name, a mesh (its shape), a texture (what is seen on it: radiance
# from 0 to 1), a pose (where it stands at the reference frame, t = 0, the middle one), and may deform and move.
objects:
{objects}
{blocks}
# The sensor: bits of a digital number, and the noise of a grey value as a fraction of full scale.
# `sensor: ideal` has neither.
sensor:
{sensor}

# How images are made: OpenGL where it runs, else ray casting; every pixel is a mean of 4 x 4 samples.
render:
  backend: auto
  supersampling: 4

# How depth and motion are estimated from the images: any of `scenetruth methods`, with its settings.
estimate:
{estimate}

# Scores of the interior leave out what is nearer to an edge than this, in px.
score:
  interior_margin_px: 20

# All random numbers, of textures and noise, follow from this one.
seed: 1
"""

_SCHEMA = "# yaml-language-server: $schema={}"
_NO_SCHEMA = """\
# Editors complete and check this file if a line `# yaml-language-server: $schema=scene.schema.json` stands above all
# others (not behind this text), and that file lies beside it: scenetruth schema > scene.schema.json"""


def scene_text(start: Start, file: str, schema: str = "") -> str:
    """Return the text of a scene file.

    Parameters
    ----------
    start
        What is in it.
    file
        How the file is called, for the commands that it names.
    schema
        Where editors find the schema of scene files, as seen from the file; empty if nowhere.

    Returns
    -------
    str
        YAML with comments.
    """
    return _TEXT.format(
        schema=_SCHEMA.format(schema) if schema else _NO_SCHEMA,
        summary=start.summary,
        # Names of files may hold what YAML takes for something else.
        description=json.dumps(start.summary, ensure_ascii=False),
        first="\n".join(f"# - {line}" for line in start.first),
        file=visible(file, lines=False),
        sensor=indent(start.sensor, "  "),
        estimate=indent(start.estimate, "  "),
        objects=indent(start.objects.strip("\n"), "  "),
        focal_length_px=start.focal_length_px,
        focal_note=start.focal_note,
        baseline_mm=start.baseline_mm,
        baseline_note=start.baseline_note,
        frame_interval_s=start.frame_interval_s,
        blocks=f"\n{start.blocks.strip()}\n" if start.blocks else "",
    )
