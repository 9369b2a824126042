"""The preview of a recipe: thumbnails of draws, distributions of values, and rejections."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.dataset.pages.figures import (
    MOST_CHARTS,
    ON_A_SHEET,
    THUMBNAIL_PX,
    collect_quantities,
    draw_contact_sheet,
    draw_histograms,
    draw_pairs,
    select_paired,
    to_display_grey,
)
from scenetruth.dataset.pages.page_text import (
    describe_criterion,
    describe_splits,
    render_html,
    tabulate_distributions,
    tabulate_paired_factors,
    tabulate_rejections,
)
from scenetruth.dataset.recipe_loader import RecipeLike, load_recipe
from scenetruth.dataset.recipe_validation import AcceptedDraws, draw_samples
from scenetruth.dataset.sampler import Draw, Sampler
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.jobs.executors import ordered_map, resolve_workers
from scenetruth.output import check_output, claim_folder, write_atomically
from scenetruth.progress import Progress
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import Overrides, Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.leaf.texture_synthesis import LeafTexture
from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.scene_object import SceneObject
from scenetruth.scene.texture import TextureModel
from scenetruth.scene.texture.procedural_textures import NoiseTexture, UniformTexture

__all__ = ["PAGE", "SIMPLIFIED", "preview_dataset", "render_thumbnail", "simplify_scene"]


SIMPLIFIED = (
    "Simplified previews of the samples: reference camera at t = 0, linear, without lens and sensor. Shapes, poses "
    "and illumination equal those of the samples, on coarse meshes without fine noise and leaf veins."
)
"""Caption of the thumbnails."""
_WAVE_PX = 3.0
"""Shortest wavelength in a thumbnail, in its pixels."""
_FACET_PX = 1.5
"""Smallest facets in a thumbnail, in its pixels."""
_FACETS_OF_A_SIDE = 12
_PLAIN_TEXELS = 1_000_000
"""Raster textures that are rendered unchanged."""


def render_thumbnail(scene: Scene) -> NDArray[np.float32]:
    """Return a thumbnail: a linear image of the reference camera at the reference frame, in the middle of its bands."""
    scenes = scene.band_scenes()
    scene = scenes[len(scenes) // 2]
    small = simplify_scene(scene)
    with warnings.catch_warnings():
        # These warnings are issued when the sample is generated.
        warnings.simplefilter("ignore")
        try:
            world = build_scene(small)
        except SceneError:
            # Simplification itself may fail; an error of the scene is raised again here.
            small = _small(scene, scene.parts)
            world = build_scene(small)
        with RaycastRenderer(world, small.camera, small.background, 1, small.lighting) as renderer:
            return renderer.render(0.0, Viewpoint.on_axis(0.0))


def simplify_scene(scene: Scene) -> Scene:
    """Return a simplified scene that is similar in few pixels and is rendered quickly."""
    focal_px = scene.camera.shrunk_to(THUMBNAIL_PX).focal_px
    return _small(scene, [(path, _coarse(item, focal_px)) for path, item in scene.parts])


def _small(scene: Scene, parts: tuple[tuple[str, SceneObject], ...] | list[tuple[str, SceneObject]]) -> Scene:
    items = tuple(item for _, item in parts)
    small = scene.shrunk_to(THUMBNAIL_PX).model_copy(update={"objects": items, "plants": ()})
    # Copies share the cached properties of the scene.
    small.__dict__.pop("parts", None)
    return small


def _coarse(item: SceneObject, focal_px: float) -> SceneObject:
    pixel_mm = max(item.pose.position_mm[2], 1.0) / focal_px
    mesh = _coarse_mesh(item.mesh, pixel_mm)
    return item.model_copy(update={"mesh": mesh, "texture": _coarse_texture(item, pixel_mm)})


def _coarse_mesh(mesh: MeshModel, pixel_mm: float) -> MeshModel:
    """Return a mesh with facets of about a pixel, with a lower limit that preserves its shape."""
    given = getattr(mesh, "resolution_mm", None)
    if given is None:
        return mesh
    sizes = [getattr(mesh, name, None) for name in ("width_mm", "length_mm", "radius_mm")]
    own = [size / _FACETS_OF_A_SIDE for size in sizes if isinstance(size, float | int)]
    return mesh.model_copy(update={"resolution_mm": max(given, min([_FACET_PX * pixel_mm, *own]))})


def _coarse_texture(item: SceneObject, pixel_mm: float) -> TextureModel:
    texture = item.texture
    if isinstance(texture, LeafTexture):
        return UniformTexture(kind="uniform", radiance=texture.settings["mean"])
    if isinstance(texture, NoiseTexture):
        return _coarse_noise(texture, _WAVE_PX * pixel_mm)
    sketch = item.mesh.sketch(Path(), 100)
    try:
        texels = math.inf if sketch is None else math.prod(texture.raster_shape(sketch, Path()))
    except (SceneError, OSError):
        return texture
    return texture if texels <= _PLAIN_TEXELS else UniformTexture(kind="uniform")


def _coarse_noise(texture: NoiseTexture, finest_mm: float) -> TextureModel:
    """Return noise without wavelengths below a limit; the remaining band keeps its power."""
    low, high = texture.wavelength_mm
    if finest_mm <= low:
        return texture
    if finest_mm >= _ALMOST * high:
        return UniformTexture(kind="uniform", radiance=texture.mean)
    share = _power(finest_mm, high, texture.spectrum_exponent) / _power(low, high, texture.spectrum_exponent)
    contrast = texture.rms_contrast * math.sqrt(share)
    return texture.model_copy(update={"wavelength_mm": (finest_mm, high), "rms_contrast": contrast})


_ALMOST = 0.9


def _power(low: float, high: float, exponent: float) -> float:
    order = exponent + 2
    if abs(order) < _ALMOST_ZERO:
        return math.log(high / low)
    return float(((high / low) ** order - 1) / order * high**-order)


_ALMOST_ZERO = 1e-9


PAGE = "preview.html"
_MAX_LISTED, _LONGEST = 20, 400
SHEET, VALUES, PAIRS = "contact_sheet.png", "values.png", "pairs.png"


def preview_dataset(
    recipe: RecipeLike,
    *,
    overrides: Overrides = (),
    samples: int | None = None,
    output: str | Path,
    overwrite: bool = False,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a page with samples of a recipe: values, thumbnails of simplified surfaces, and reasons for rejections.

    Parameters
    ----------
    recipe
        The recipe, its values, its file, or the name of a bundled recipe.
    overrides
        Changed fields, as for `scenetruth.load_scene`.
    samples
        Number of samples; default: enough to show the distributions, or all of a small data set.
    output
        Directory of the page ``preview.html``.
    overwrite
        Whether an existing preview may be replaced.
    workers, scheduler
        As for `run_dataset`.
    progress
        Called with (what, done, total).

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    RecipeError
        If the recipe is invalid, or no sample can be drawn; lists all problems.
    OutputExistsError
        If the directory exists and ``overwrite`` is false.

    See Also
    --------
    check_recipe : Validates the recipe and predicts the resources.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.dataset import preview_dataset
    >>> with TemporaryDirectory() as folder:
    ...     preview_dataset("cubes", samples=2, output=f"{folder}/preview").name
    'preview.html'
    """
    sampler = load_recipe(recipe, overrides=overrides).sampler()
    folder = Path(output)
    resolve_workers(workers)
    claim = claim_folder(PAGE)
    check_output(folder, overwrite=overwrite, claim=claim)
    drawn = draw_samples(sampler, samples, progress, workers, scheduler)
    if not drawn.draws:
        raise RecipeError(drawn.trial.problems)
    with write_atomically(folder, overwrite=overwrite, claim=claim) as partial:
        partial.mkdir()
        _draw_sheet(drawn.draws, partial / SHEET, workers, scheduler, progress)
        content = _content(sampler, drawn, partial)
        (partial / PAGE).write_text(render_html("preview.html.j2", **content), encoding="utf-8")
    return folder / PAGE


def _content(sampler: Sampler, drawn: AcceptedDraws, folder: Path) -> dict[str, Any]:
    recipe = sampler.recipe
    quantities = collect_quantities(sampler, drawn.values())
    paired = select_paired(quantities)
    if quantities:
        draw_histograms(quantities, folder / VALUES)
    if paired:
        draw_pairs(paired, folder / PAIRS)
    splits = Counter(draw.split for draw in drawn.draws)
    return {
        "recipe": recipe,
        "bases": [str(base) for base in sampler.bases],
        "trial": drawn.trial,
        "problems": [f"{one}"[:_LONGEST] for one in drawn.trial.problems[:_MAX_LISTED]],
        "reasons": tabulate_rejections(drawn.trial.reasons),
        "shown": len(drawn.draws),
        "varied": tabulate_distributions(sampler),
        "ladders": tabulate_paired_factors(sampler),
        "bounds": [describe_criterion(bound) for bound in recipe.acceptance],
        "splits": [(name, words, splits[name]) for name, words in describe_splits(sampler).items()],
        "sheet": SHEET,
        "simplified": SIMPLIFIED,
        "values": VALUES if quantities else "",
        "left_out": max(len(quantities) - MOST_CHARTS, 0),
        "pairs": PAIRS if paired else "",
    }


def _draw_sheet(
    draws: Sequence[Draw], path: Path, workers: int, scheduler: str | None, progress: Progress | None
) -> None:
    chosen = [draws[number * len(draws) // ON_A_SHEET] for number in range(ON_A_SHEET)]
    chosen = list({draw.number: draw for draw in chosen}.values())
    images: list[NDArray[np.float32]] = []
    found = ordered_map(_thumbnail, None, [draw.plain for draw in chosen], workers, scheduler)
    for done, (draw, image) in enumerate(zip(chosen, found, strict=True)):
        if progress is not None:
            progress("thumbnails", done, len(chosen))
        if isinstance(image, SceneError):
            values = [
                Problem(one.path, f"{one.message} (in sample {draw.number})", one.value) for one in image.problems
            ]
            raise RecipeError(values)
        images.append(image)
    if progress is not None:
        progress("thumbnails", len(chosen), len(chosen))
    captions = [f"{draw.number}" + (f" · {draw.split}" if draw.split else "") for draw in chosen]
    draw_contact_sheet(list(zip(captions, to_display_grey(images), strict=True)), SIMPLIFIED, path)


def _thumbnail(_: None, plain: Mapping[str, Any]) -> NDArray[np.float32] | SceneError:
    try:
        return render_thumbnail(Scene.from_dict(plain))
    except SceneError as error:
        return error
