"""The checks of `scenetruth doctor`: Python, packages, rendering, machine, caches and terminal, each with a remedy."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scenetruth import __version__
from scenetruth.cli.render_probe import ANSWER

if TYPE_CHECKING:
    from packaging.requirements import Requirement

__all__ = [
    "EXTRAS",
    "RENDERERS",
    "DoctorCheck",
    "check_caches",
    "check_extras",
    "check_machine",
    "check_packages",
    "check_rendering",
    "check_terminal",
    "checks_to_json",
    "is_fit",
    "print_checks",
    "render_alone",
    "run_checks",
]


CheckState = Literal["ok", "missing", "broken"]
"""``missing`` is what something could be had by; ``broken`` is there, or needed, and does not work."""


@dataclass(frozen=True)
class DoctorCheck:
    """One thing that was looked at.

    ``group``: What it belongs to: rendering, packages, ...
    ``name``: What it is.
    ``state``: How it is.
    ``told``: What was found.
    ``remedy``: What to do about it; empty if nothing.
    ``needed``: Whether `scenetruth run` needs it.
    """

    group: str
    name: str
    state: CheckState
    told: str
    remedy: str = ""
    needed: bool = False


def is_fit(findings: Sequence[DoctorCheck]) -> bool:
    """Tell whether nothing that `scenetruth run` needs is missing or broken."""
    return not any(one.needed and one.state != "ok" for one in findings)


EXTRAS = {
    "opengl": "images by OpenGL (backend pyrender)",
    "opencv": "the methods opencv_stereo, opencv_flow and opencv_scene_flow",
    "formats": "export to KITTI, Spring, OpenEXR and PLY",
    "design": "search and sensitivity of `scenetruth design optimise`",
    "cluster": "data sets made by the workers of a Dask cluster",
    "browser": "tests of pages in a browser",
}
"""Extras, and what each brings."""


def check_packages() -> list[DoctorCheck]:
    """Return whether all packages are there that nothing works without, and each that is not."""
    needed = _requirements("")
    if not needed:
        told = "nothing is known of what it needs, as it is not installed: it is run from its sources"
        return [DoctorCheck("packages", "needed", "missing", told, "pip install . or make setup")]
    wrong = [(one, problem) for one in needed if (problem := _problem_of(one))]
    found = [
        DoctorCheck("packages", one.name, "broken", problem, f"pip install '{one.name}{one.specifier}'", needed=True)
        for one, problem in wrong
    ]
    told = f"{len(needed) - len(wrong)} of {len(needed)} are there"
    return [DoctorCheck("packages", "needed", "broken" if wrong else "ok", told, needed=True), *found]


def check_extras() -> list[DoctorCheck]:
    """Return which extras are there, with versions and what each brings."""
    found = []
    for extra, brings in EXTRAS.items():
        wanted = _requirements(extra)
        problems = [problem for one in wanted if (problem := _problem_of(one))]
        there = [f"{one.name} {version}" for one in wanted if (version := _version(one.name))]
        missing = bool(problems) or not wanted
        told = f"{brings}: {', '.join([*problems, *([] if problems else there)])}"
        remedy = f"pip install 'scenetruth[{extra}]'" if missing else ""
        found.append(DoctorCheck("extras", extra, "missing" if missing else "ok", told, remedy))
    return found


def installed_versions() -> dict[str, str]:
    """Return the versions of all packages that are there, of those that scenetruth or an extra of it needs."""
    names = {one.name for extra in ("", *EXTRAS) for one in _requirements(extra)} | {"llvmlite", "scenetruth"}
    return {name: version for name in sorted(names, key=str.lower) if (version := _version(name))}


def _requirements(extra: str) -> list[Requirement]:
    """Return what an extra needs beyond what is needed anyway; that of no name is what is needed anyway."""
    from packaging.requirements import Requirement

    try:
        lines = metadata.requires("scenetruth") or []
    except metadata.PackageNotFoundError:
        return []
    return [one for one in map(Requirement, lines) if extra in _extras_of(one)]


def _extras_of(requirement: Requirement) -> Iterator[str]:
    """Yield the extras that a requirement belongs to; the empty name if to none."""
    marker = requirement.marker
    for extra in ("", *EXTRAS):
        if (marker is None or marker.evaluate({"extra": extra})) and (not extra or "extra" in str(marker)):
            yield extra


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _problem_of(requirement: Requirement) -> str:
    """Return what is wrong with a package; empty if nothing."""
    version = _version(requirement.name)
    if not version:
        return f"{requirement.name} is not installed"
    if not requirement.specifier.contains(version, prereleases=True):
        return f"{requirement.name} {version} is there, and {requirement.specifier} is needed"
    return ""


_PACKAGE = Path(__file__).resolve().parents[1]


def check_caches() -> list[DoctorCheck]:
    """Return how the cache of compiled code and that of textures are."""
    return [_compiled(), _textures()]


def _compiled() -> DoctorCheck:
    """Look where numba keeps code, which it does beside the modules if it can."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    beside = os.access(_PACKAGE, os.W_OK)
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    place = Path(given) if given else _PACKAGE if beside else Path(base) / "numba"
    tag = f".py{sys.version_info.major}{sys.version_info.minor}"
    indices = [file for file in _files(place, "*.nbi") if tag in file.name]
    current = [file for file in indices if not _is_older(file)]
    size = sum(_size(file) for file in _files(place, "*.nbc"))
    where = "beside the package, in __pycache__" if place == _PACKAGE else str(place)
    told = f"{where}: {len(current)} kernels, {size / 1e6:.0f} MB"
    if not _can_be_written(place):
        return DoctorCheck(
            "caches", "compiled code", "broken", f"{told}; cannot be written", "set NUMBA_CACHE_DIR elsewhere"
        )
    if not current:
        return DoctorCheck("caches", "compiled code", "missing", told, "run `scenetruth precompile` (1 to 2 min, once)")
    return DoctorCheck("caches", "compiled code", "ok", told)


def _is_older(index: Path) -> bool:
    """Whether code was compiled from a module, if that lies beside it, that has changed since."""
    source = index.parents[1] / f"{index.name.partition('.')[0]}.py"
    try:
        return source.stat().st_mtime > index.stat().st_mtime
    except OSError:
        return False


def _textures() -> DoctorCheck:
    from scenetruth.cache import cache_folder

    folder = cache_folder()
    if folder is None:
        return DoctorCheck("caches", "textures", "ok", "off, or there is no home folder: each run makes its own")
    entries = list(_files(folder, "*.entry"))
    told = f"{folder}: {len(entries)} entries, {sum(map(_size, entries)) / 1e6:.0f} MB"
    if _can_be_written(folder):
        return DoctorCheck("caches", "textures", "ok", told)
    remedy = "set SCENETRUTH_CACHE to a folder that can be written, or to off"
    return DoctorCheck("caches", "textures", "broken", f"{told}; cannot be written", remedy)


def _files(folder: Path, pattern: str) -> Iterable[Path]:
    return folder.rglob(pattern) if folder.is_dir() else ()


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _can_be_written(folder: Path) -> bool:
    """Whether files can be put into a folder, or it can be made."""
    near = next((place for place in (folder, *folder.absolute().parents) if os.path.exists(place)), folder)
    try:
        # What the rights say is not all: some file systems take no files from anybody.
        with tempfile.TemporaryFile(dir=near):
            return True
    except OSError:
        return False


_LEAST_PYTHON = (3, 11)
_LEAST_BYTES = 1e9
"""Memory, and disk space, below which little can be made: a run of the noise cube takes some hundred megabytes."""


def check_python() -> list[DoctorCheck]:
    """Return the versions of scenetruth and of Python, and the system."""
    package = Path(__file__).resolve().parents[1]
    new_enough = sys.version_info >= _LEAST_PYTHON
    least = ".".join(map(str, _LEAST_PYTHON))
    linux = sys.platform == "linux"
    return [
        DoctorCheck("python", "scenetruth", "ok", f"{__version__}, in {package}"),
        DoctorCheck(
            "python",
            "python",
            "ok" if new_enough else "broken",
            f"{platform.python_version()}, {sys.executable}",
            "" if new_enough else f"install Python {least} or newer",
            needed=True,
        ),
        DoctorCheck(
            "python",
            "platform",
            "ok" if linux else "missing",
            platform.platform(),
            "" if linux else "use Linux, which alone is tested",
        ),
    ]


def check_machine() -> list[DoctorCheck]:
    """Return processors, memory and disk space, as far as this process may have them."""
    try:
        from scenetruth.cache import cache_folder
        from scenetruth.resources import inspect_machine
        from scenetruth.resources.system import free_disk_bytes
    except Exception as error:  # whatever a library that cannot be loaded raises
        told = f"cannot be loaded: {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return [
            DoctorCheck("machine", "libraries", "broken", told, "pip install --force-reinstall scenetruth", needed=True)
        ]
    here, cache = Path(), cache_folder()
    machine = inspect_machine(here)
    found = [
        DoctorCheck("machine", "processors", "ok", f"{machine.processors} of {os.cpu_count()} for this process"),
        _amount("memory", machine.memory_bytes, "for this process, all limits counted", "end other programs"),
        _amount("disk", machine.disk_bytes, f"free at {here.absolute()}", "free some space, or work elsewhere"),
    ]
    if cache is not None:
        told = f"free at {cache}"
        found.append(_amount("disk of the cache", free_disk_bytes(cache), told, "set SCENETRUTH_CACHE elsewhere"))
    return found


def _amount(name: str, count: int | None, where: str, remedy: str) -> DoctorCheck:
    if count is None:
        return DoctorCheck("machine", name, "ok", f"unknown {where}")
    enough = count >= _LEAST_BYTES
    told = f"{count / 1e9:.1f} GB {where}"
    return DoctorCheck("machine", name, "ok" if enough else "missing", told, "" if enough else remedy)


def check_terminal() -> DoctorCheck:
    """Return whether the terminal shows all characters, and colours."""
    from rich.console import Console

    console = Console()
    encoding = (getattr(sys.stdout, "encoding", None) or "unknown").lower()
    full = encoding.replace("-", "") == "utf8"
    colours = console.color_system or "no"
    place = f"{colours} colours, {console.width} columns" if sys.stdout.isatty() else "no terminal"
    remedy = "" if full else "set LANG=C.UTF-8 or PYTHONUTF8=1; until then some characters are shown by their numbers"
    return DoctorCheck("terminal", "output", "ok" if full else "missing", f"{encoding}, {place}", remedy)


RENDERERS = ("osmesa", "egl", "raycast")
"""What renders: platforms of OpenGL, and ray casting."""

_SCRIPT = Path(__file__).with_name("render_probe.py")
_TIMEOUT_S = 20
_NEEDED_PACKAGES = {"raycast": ("embreex",), "osmesa": ("pyrender", "OpenGL"), "egl": ("pyrender", "OpenGL")}


def render_alone(name: str) -> tuple[bool, str]:
    """Render a triangle in a process of its own."""
    for package in _NEEDED_PACKAGES[name]:
        if find_spec(package) is None:
            return False, f"No module named '{package}'"
    # -P: without this folder, whose modules may have names of other packages.
    command = [sys.executable, "-P", str(_SCRIPT), name]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return False, f"it did not render within {_TIMEOUT_S} s"
    lines = [line.strip() for line in done.stdout.splitlines() if line.startswith(ANSWER)]
    if done.returncode == 0 and lines:
        return True, lines[-1].removeprefix(ANSWER).strip()
    errors = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return False, errors[-1] if errors else f"its process ended with code {done.returncode}"


def check_rendering(answers: Mapping[str, tuple[bool, str]]) -> list[DoctorCheck]:
    """Return what renders here, of what `render_alone` says of each renderer."""
    rendered, told = answers["raycast"]
    remedy = "" if rendered else "pip install --force-reinstall embreex"
    found = [DoctorCheck("rendering", "raycast", "ok" if rendered else "broken", told, remedy, needed=True)]
    opengl = [name for name in RENDERERS if name != "raycast"]
    for name in opengl:
        rendered, told = answers[name]
        others = [other for other in opengl if other != name and answers[other][0]]
        if not rendered:
            told += f"; not needed, as {others[0]} runs" if others else "; not needed, as raycast renders all scenes"
        remedy = "" if rendered or others else _remedy(name, told)
        label = f"pyrender ({name})"
        found.append(DoctorCheck("rendering", label, "ok" if rendered else "missing", told, remedy))
    return found


def _remedy(platform: str, told: str) -> str:
    from scenetruth.render.opengl import REMEDIES

    return "pip install 'scenetruth[opengl]'" if told.startswith("No module named") else REMEDIES[platform]


def run_checks() -> list[DoctorCheck]:
    """Return how everything is that scenetruth uses on this machine."""
    with ThreadPoolExecutor(len(RENDERERS)) as side:
        # In processes of their own, which render while this one loads libraries.
        rendered = {name: side.submit(render_alone, name) for name in RENDERERS}
        first = [*check_python(), *check_packages()]
        rest = [*check_machine(), *check_caches(), *check_extras(), check_terminal()]
        answers = {name: answer.result() for name, answer in rendered.items()}
    return [*first, *check_rendering(answers), *rest]


_STYLES = {"ok": "green", "missing": "yellow", "broken": "red"}


def print_checks(findings: Sequence[DoctorCheck]) -> None:
    """Print all findings, each with its remedy, and whether scenes can be run."""
    from rich.table import Table
    from rich.text import Text

    from scenetruth.cli.console import make_console
    from scenetruth.errors import visible

    table = Table(show_header=False, box=None, pad_edge=False)
    for _ in range(3):
        table.add_column(overflow="fold")
    group = ""
    for one in findings:
        if one.group != group:
            table.add_row(Text(one.group, style="bold"), "", "")
            group = one.group
        table.add_row(
            f"  {visible(one.name, lines=False)}",
            Text(one.state, style=_STYLES[one.state]),
            visible(one.told, lines=False),
        )
        if one.remedy:
            table.add_row("", "", Text(f"-> {visible(one.remedy, lines=False)}", style=_STYLES[one.state]))
    make_console().print(table)
    fit = is_fit(findings)
    make_console().print("scenes can be run here" if fit else "scenes cannot be run here: see what is broken above")


def checks_to_json(findings: Sequence[DoctorCheck]) -> str:
    """Return the findings and the versions of all packages as JSON."""
    told = {"fit": is_fit(findings), "findings": [asdict(one) for one in findings], "packages": installed_versions()}
    return json.dumps(told, indent=2)
