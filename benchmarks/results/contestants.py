"""The methods of the results page: built-in ones, OpenCV, and programs of others."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from typing import Any

from benchmarks.peers import few_images
from benchmarks.peers.catalogue import PEERS, requirements_of
from scenetruth.benchmark.benchmark_report import describe_method
from scenetruth.errors import ArgumentError, Problem
from scenetruth.estimators import MethodSpec
from scenetruth.estimators.external import CommandMethod
from scenetruth.estimators.method_specs import parse_method
from scenetruth.provenance import own_release

__all__ = ["BUILT_IN", "CONTESTANTS", "OPENCV", "PROGRAM", "SUBMITTED", "Contestant", "submitted", "version_of"]

BUILT_IN, OPENCV, PROGRAM, SUBMITTED = "built-in", "OpenCV", "program", "submitted"


@dataclass(frozen=True)
class Contestant:
    """A row of the results page.

    Parameters
    ----------
    key
        Name of its files.
    title
        Name in tables.
    group
        One of `BUILT_IN`, `OPENCV`, `PROGRAM`, `SUBMITTED`.
    images
        Images that it uses: ``all``, ``4``, or ``2``.
    method
        The method; of a program, None.
    settings
        Settings of the method.
    packages
        Packages whose versions are stated.
    how
        Its settings in words.
    approach
        Its algorithm in one line, of programs; that of other methods is in their docstrings.
    link
        Address of its code.
    spelled
        A submitted method, as the command line spells it.
    version
        Version of a submitted method.
    """

    key: str
    title: str
    group: str
    images: str
    method: Any = None
    settings: dict[str, Any] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    how: str = ""
    approach: str = ""
    link: str = ""
    spelled: str = ""
    version: str = ""

    @cached_property
    def spec(self) -> MethodSpec:
        """The method with its settings and label."""
        return MethodSpec(self.method, self.settings, label=self.key)

    @property
    def description(self) -> str:
        """Its algorithm in one line, without a full stop."""
        return (self.approach or ("" if self.method is None else describe_method(self.method))).removesuffix(".")


_SAME = "the four images of the stereo programs, window of 8 px (averages noise as subsets of 28 px)"
CONTESTANTS: Sequence[Contestant] = (
    Contestant("refined", "refined", BUILT_IN, "all", "refined", how="defaults"),
    Contestant("structure_tensor", "structure tensor", BUILT_IN, "all", "structure_tensor", how="defaults"),
    Contestant("plane_sweep", "plane sweep", BUILT_IN, "all", "plane_sweep", how="defaults"),
    Contestant(
        "refined_4", "refined, 4 images", BUILT_IN, "4", few_images.refined_of_four, how=_SAME, approach="As `refined`"
    ),
    Contestant(
        "structure_tensor_4",
        "structure tensor, 4 images",
        BUILT_IN,
        "4",
        few_images.structure_tensor_of_four,
        how=_SAME,
        approach="As `structure_tensor`",
    ),
    Contestant(
        "opencv_farneback",
        "OpenCV: SGBM, Farnebäck",
        OPENCV,
        "2",
        "opencv_scene_flow",
        packages=("opencv-python-headless",),
        how="defaults of `opencv_scene_flow`",
    ),
    Contestant(
        "opencv_dis",
        "OpenCV: BM, DIS",
        OPENCV,
        "2",
        "opencv_scene_flow",
        {"stereo": "bm", "flow": "dis"},
        packages=("opencv-python-headless",),
        how="`opencv_scene_flow[stereo: bm, flow: dis]`",
    ),
    Contestant(
        "pyvale",
        "pyvale 2D",
        PROGRAM,
        "2",
        how="subsets of 29 px every 5 px, affine",
        approach="Subset correlation of two images at a time",
    ),
    Contestant(
        "pyvale_stereo",
        "pyvale stereo",
        PROGRAM,
        "4",
        how="subsets of 31 px every 5 px, affine",
        approach="Subset correlation of both cameras and frames together",
    ),
    Contestant(
        "al_dic_3d",
        "al-dic-3d",
        PROGRAM,
        "4",
        how="windows of 28 px every 8 px, global step",
        approach="Stereo correlation with the global step of the augmented Lagrangian",
    ),
    Contestant(
        "sun_dic",
        "SUN-DIC",
        PROGRAM,
        "2",
        how="subsets of 29 px every 5 px, affine",
        approach="Subset correlation of two images at a time, inverse compositional Gauss-Newton",
    ),
    Contestant(
        "pyxel",
        "pyxel",
        PROGRAM,
        "2",
        how="quadrilaterals of 24 px",
        approach="Finite-element correlation of two images at a time",
    ),
    Contestant(
        "mudic",
        "muDIC",
        PROGRAM,
        "2",
        how="quadrilaterals of 24 px, one rectangle",
        approach="Finite-element correlation of two images at a time",
    ),
)


COMMAND = "command:"
"""Begins the notation of a submitted external program."""
TIMEOUT_S = 600.0


def submitted(spelled: str, link: str = "", version: str = "") -> Contestant:
    """Return a submitted method.

    Parameters
    ----------
    spelled
        ``LABEL=MODULE:FUNCTION[SETTINGS]``, or ``command:LABEL=WORDS`` for an external program.
    link
        Address of its code.
    version
        Its version.
    """
    if spelled.startswith(COMMAND):
        label, _, words = spelled.removeprefix(COMMAND).partition("=")
        method: Any = CommandMethod(words.strip(), label.strip(), timeout_s=TIMEOUT_S)
        settings, how = {}, f"`{words.strip()}`"
    else:
        spec = parse_method(spelled)
        label, method, settings = spec.label, spec.method, dict(spec.settings)
        how = f"`{spec.spelled.removeprefix(f'{label}=')}`"
    label = label.strip()
    key = re.sub(r"\W+", "_", label)
    if any(key == one.key or label == one.title for one in CONTESTANTS):
        taken = ", ".join(one.key for one in CONTESTANTS)
        raise ArgumentError([Problem("--add", f"must have a label of its own, LABEL=METHOD, none of {taken}", label)])
    return Contestant(
        *(key, label, SUBMITTED, "all", method, settings),
        how=how,
        link=link,
        spelled=spelled,
        version=version,
    )


def version_of(contestant: Contestant) -> str:
    """Return the version of what a method computes with."""
    if contestant.group == PROGRAM:
        return requirements_of(PEERS[contestant.key].environment)[0]
    if contestant.packages:
        return ", ".join(f"{name} {version(name)}" for name in contestant.packages)
    return contestant.version if contestant.group == SUBMITTED else f"scenetruth {own_release()}"
