"""Light at the pixel centres: radiance, its shares by origin, and the fraction of the lamps' light that arrives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast import Hits, RayCaster
from scenetruth.render.raycast_backend import visible_uv
from scenetruth.render.reflection import ReflectionTables, pack_materials
from scenetruth.render.shading import Shader
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lighting

__all__ = ["LightMaps", "LightOfBands", "LightOfScene"]

Map = NDArray[np.float64]

# Columns of `ReflectionTables.values`.
_INDEX, _METALLIC, _TRANSMITTANCE, _REFLECTANCE = 0, 3, 4, 9


@dataclass(frozen=True, eq=False)
class LightOfScene:
    """Light of a scene with its lamps, for `LightMaps` at any time."""

    lighting: Lighting
    world: BuiltScene

    def __call__(self, caster: RayCaster, t: float) -> LightMaps:
        """Return the light on the surfaces at time t (in frames), whose mesh is that of the ray caster."""
        return LightMaps(self, caster, t)

    @cached_property
    def optics(self) -> dict[str, ReflectionTables]:
        """Parameters of the materials of which a part is omitted, or replaced.

        ``mirror``: Without scattered light; ``diffuse`` and ``sheet``: with scattered light of one side in addition;
        ``white``: matt surfaces that scatter all light, in sheets from both sides.
        """
        values, tables = pack_materials([material for material, _ in self.world.materials])
        found = {}
        for name, reflects, transmits in (("mirror", 0, 0), ("diffuse", 1, 0), ("sheet", 0, 1)):
            part = values.copy()
            part[:, _REFLECTANCE] *= reflects
            part[:, _TRANSMITTANCE] *= transmits
            found[name] = ReflectionTables(part, tables)
        white = values.copy()
        white[:, _INDEX], white[:, _METALLIC], white[:, _REFLECTANCE] = 1.0, 0.0, 1.0
        white[:, _TRANSMITTANCE] = values[:, _TRANSMITTANCE] > 0
        return found | {"white": ReflectionTables(white, tables)}


@dataclass(frozen=True, eq=False)
class LightOfBands:
    """Light of a scene in bands: that of one scene for each band."""

    scenes: tuple[LightOfScene, ...]

    def __call__(self, caster: RayCaster, t: float) -> MapsOfBands:
        """Return the light on the surfaces at time t (in frames), as `LightOfScene`."""
        return MapsOfBands(tuple(LightMaps(scene, caster, t) for scene in self.scenes))


@dataclass(frozen=True, eq=False)
class MapsOfBands:
    """Light that surface points send to a camera in each band."""

    bands: tuple[LightMaps, ...]

    def on_hits(self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], hits: Hits) -> dict[str, Map]:
        """Return the light at ray hits as `LightMaps.on_hits`, in maps of the shape (bands, n)."""
        found = [each.on_hits(origin_mm, directions, hits) for each in self.bands]
        return {name: np.stack([each[name] for each in found]) for name in found[0]}


class LightMaps:
    """Light that surface points send to a camera, by its origin, at one time.

    Points are shaded one by one, as those of the rendered images, but neither averaged over pixels nor interpolated.
    """

    def __init__(self, of: LightOfScene, caster: RayCaster, t: float) -> None:
        self._of, self._caster, self._t = of, caster, t
        self._all = Shader(of.lighting, of.world)
        self._without_lamps = Shader(of.lighting.model_copy(update={"lights": ()}), of.world)
        self._without_shadows = Shader(of.lighting.model_copy(update={"shadows": False}), of.world)

    def on_hits(self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], hits: Hits) -> dict[str, Map]:
        """Return the light at ray hits, by the names of the maps in a ground truth (`scenetruth.schema.VARIABLES`).

        ``directions``: Directions of the rays in the world, shape (n, 3). Maps have the shape (n,), NaN without a hit.
        """
        lighting, count = self._of.lighting, len(directions)
        albedo = self._albedo(origin_mm, hits)
        rays = (self._caster, self._t, np.asarray(origin_mm, dtype=np.float64), directions, hits)
        parts = {name: np.zeros(count) for name in ("diffuse", "specular", "transmitted", "ambient")}
        lit = np.full(count, np.nan)
        if not lighting.lit:
            parts["ambient"] = albedo
        else:
            parts["ambient"] = _radiance(albedo, self._without_lamps, rays)
            if self._all.simple:
                arriving = self._by_lamps(rays, None)[0]
                parts["diffuse"] = albedo * arriving
            else:
                factors, gloss = self._by_lamps(rays, "mirror")
                parts["specular"] = albedo * factors + gloss
                parts["diffuse"] = albedo * (self._by_lamps(rays, "diffuse")[0] - factors)
                parts["transmitted"] = albedo * (self._by_lamps(rays, "sheet")[0] - factors)
                arriving = self._by_lamps(rays, "white")[0]
            unhidden = self._by_lamps(rays, None if self._all.simple else "white", self._without_shadows)[0]
            with np.errstate(divide="ignore", invalid="ignore"):
                lit = np.where(unhidden > 0, arriving / unhidden, np.nan)
        parts = {name: np.maximum(values, 0.0) for name, values in parts.items()}
        total = sum(parts.values(), np.zeros(count))
        with np.errstate(divide="ignore", invalid="ignore"):
            found = {f"{name}_share": values / total for name, values in parts.items()}
        found = {"surface_radiance": total * lighting.brightness(self._t), **found, "lit_fraction": lit}
        for values in found.values():
            values[hits.face < 0] = np.nan
        return found

    def _by_lamps(self, rays: Rays, optics: str | None, shader: Shader | None = None) -> tuple[Map, Map]:
        """Return factors of the texture and gloss, see `shading.Arrived`, by the lamps alone, with `optics`."""
        chosen = None if optics is None else self._of.optics[optics]
        found, ambient = ((item.arrived(*rays, optics=chosen)) for item in (shader or self._all, self._without_lamps))
        factors = found.factors - ambient.factors
        if found.gloss is None or ambient.gloss is None:
            return factors, np.zeros_like(factors)
        return factors, found.gloss - ambient.gloss

    def _albedo(self, origin_mm: NDArray[np.float64], hits: Hits) -> Map:
        """Return the texture at the hits, NaN without a hit, shape (n,)."""
        world = self._of.world
        uv = hits.interpolate_corners(visible_uv(world, self._caster, origin_mm))
        body = np.where(hits.face >= 0, world.face_body[hits.face], -1)
        albedo = np.full(len(body), np.nan)
        for index, item in enumerate(world.bodies):
            chosen = body == index
            if chosen.any():
                albedo[chosen] = item.texture.radiance(uv[chosen])
        return albedo


Rays = tuple[RayCaster, float, NDArray[np.float64], NDArray[np.float64], Hits]
"""Mesh and time of the points, and the arguments of `LightMaps.on_hits`."""


def _radiance(albedo: Map, shader: Shader, rays: Rays) -> Map:
    """Return the radiance of surface points, in float64."""
    found = shader.arrived(*rays)
    lit: Map = albedo * found.factors
    return lit if found.gloss is None else lit + found.gloss
