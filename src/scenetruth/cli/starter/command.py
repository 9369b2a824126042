"""The command that writes a scene to start from: init."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from scenetruth.cli.starter.mesh import Measured
    from scenetruth.cli.starter.text import Start
    from scenetruth.errors import Problem

__all__ = ["register"]

_BESIDE = "scene.schema.json"
_SMALL_MM = 1.0
"""What is smaller, in a file whose unit was not given, is most likely in metres, as glTF is."""
_NO_UV = (
    "the mesh has no UV coordinates, by which an image is laid on it; OBJ, PLY and GLB (glTF) can carry them, STL and "
    "OFF never do: export it with them, or leave out --texture for noise, which needs none"
)


class Kind(StrEnum):
    """Scenes to start from."""

    cube = "cube"
    leaf = "leaf"
    mesh = "mesh"


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(init)


def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Scene file to write (YAML).")] = Path("scene.yaml"),
    kind: Annotated[
        Kind | None,
        typer.Option("--kind", help="What it shows: cube if not given, mesh with --mesh.", show_default=False),
    ] = None,
    mesh: Annotated[
        Path | None,
        typer.Option("--mesh", metavar="FILE", help="Mesh that it shows: OBJ, PLY, GLB, STL, OFF.", show_default=False),
    ] = None,
    texture: Annotated[
        Path | None,
        typer.Option("--texture", metavar="FILE", help="Image on the cube, or on a mesh with UVs.", show_default=False),
    ] = None,
    *,
    unit_mm: Annotated[
        float | None, typer.Option("--unit-mm", help="Length of the mesh's unit in mm.", show_default="1.0")
    ] = None,
    distance_mm: Annotated[
        float | None,
        typer.Option(
            "--distance-mm",
            help="Distance of the mesh's nearest point in mm; ten times its size if not given.",
            show_default=False,
        ),
    ] = None,
    schema: Annotated[
        Path | None,
        typer.Option(
            "--schema",
            metavar="FILE",
            help="Schema that editors check it by, made with `scenetruth schema > FILE`; scene.schema.json beside it "
            "if there is one.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a scene to start from, with a sentence on every block and what to change first."""
    from scenetruth.cli.console import print_warning
    from scenetruth.cli.starter.kinds import cube, leaf
    from scenetruth.cli.starter.mesh import mesh_start, place_mesh
    from scenetruth.errors import Problem, SceneError, visible

    chosen = kind or (Kind.mesh if mesh is not None else Kind.cube)
    problems = _problems(file, chosen, mesh, texture, unit_mm, distance_mm, schema)
    found: Measured | None = None
    if chosen is Kind.mesh and mesh is not None and not {one.path for one in problems} & {"--unit-mm", "--distance-mm"}:
        try:
            found = place_mesh(mesh, unit_mm or 1.0, distance_mm)
        except SceneError as error:
            problems += [_of_option("--mesh", one) for one in error.problems]
        else:
            if texture is not None and not found.has_uv:
                problems.append(Problem("--texture", _NO_UV, str(texture)))
    if problems:
        raise SceneError(problems)
    image = "" if texture is None else _seen_from(file, texture)
    if found is not None and mesh is not None:
        start = mesh_start(found, _seen_from(file, mesh), unit_mm or 1.0, image)
    else:
        start = leaf() if chosen is Kind.leaf else cube(image)
    _write(start, file, schema)
    if found is not None:
        typer.echo(visible(f"mesh: {found.words}"))
        if max(found.size_mm) < _SMALL_MM and unit_mm is None:
            print_warning(f"the mesh is less than {_SMALL_MM:g} mm wide; if its unit is metres: --unit-mm 1000")
    typer.echo(visible(f"written: {file}; what will be made of it: scenetruth check {file}"))


def _problems(
    file: Path,
    kind: Kind,
    mesh: Path | None,
    texture: Path | None,
    unit_mm: float | None,
    distance_mm: float | None,
    schema: Path | None,
) -> list[Problem]:
    """Return all that is wrong with the command, before anything is read or written."""
    from scenetruth.errors import Problem

    found = []
    if file.suffix not in (".yaml", ".yml"):
        found.append(Problem("FILE", "must end in .yaml", str(file)))
    elif os.path.lexists(file):
        found.append(Problem("FILE", "exists already; give another name, or put it away", str(file)))
    elif not file.absolute().parent.is_dir():
        found.append(Problem("FILE", "its folder does not exist", str(file)))
    if kind is Kind.mesh and mesh is None:
        found.append(Problem("--mesh", "is missing: the mesh file that the scene shows"))
    if kind is not Kind.mesh and mesh is not None:
        found.append(Problem("--mesh", f"goes with --kind mesh, not with --kind {kind.value}", str(mesh)))
    if texture is not None:
        found += _texture_problems(kind, texture)
    for name, value in (("--unit-mm", unit_mm), ("--distance-mm", distance_mm)):
        if value is not None and kind is not Kind.mesh:
            message = (
                f"belongs to a mesh; --kind {kind.value} has a size and a place of its own: leave it out, and change"
            )
            found.append(Problem(name, f"{message} objects in the file that is written", value))
        elif value is not None and not 0 < value < float("inf"):
            found.append(Problem(name, "must be a positive number of mm", value))
    if schema is not None and not schema.is_file():
        found.append(Problem("--schema", f"no such file; make it: scenetruth schema > {schema}", str(schema)))
    return found


def _texture_problems(kind: Kind, texture: Path) -> list[Problem]:
    from scenetruth.errors import Problem, SceneError
    from scenetruth.scene.texture.image import header_of

    if kind is Kind.leaf:
        return [Problem("--texture", "a leaf has its own texture; give an image with a cube or a mesh", str(texture))]
    try:
        header_of(texture)
    except SceneError as error:
        return [_of_option("--texture", one) for one in error.problems]
    return []


def _of_option(option: str, problem: Problem) -> Problem:
    from scenetruth.errors import Problem

    return Problem(option, problem.message, problem.value)


def _seen_from(file: Path, other: Path) -> str:
    """Return the path of another file as it is seen from the folder of a file."""
    return Path(os.path.relpath(other.resolve(), file.absolute().parent.resolve())).as_posix()


def _write(start: Start, file: Path, schema: Path | None) -> None:
    """Write the scene if it is one, and only where nothing is."""
    import yaml

    from scenetruth.cli.starter.text import scene_text
    from scenetruth.scene import scene_from_plain

    beside = file.absolute().parent / _BESIDE
    pointed = schema if schema is not None else beside if beside.is_file() else None
    # Editors take the path up to the first space.
    place = "" if pointed is None else _seen_from(file, pointed).replace(" ", "%20")
    text = scene_text(start, str(file), place)
    scene_from_plain(yaml.safe_load(text), source=file, folder=file.absolute().parent)
    with file.open("x", encoding="utf-8") as stream:
        stream.write(text)
