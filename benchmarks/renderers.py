"""Compare renderers and truth with riley-raster and Mitsuba 3 on the noise cube, and print tables in Markdown."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from imageio.v3 import imwrite
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.raycast import Topology
from scenetruth.render.adaptive_raycast import AdaptiveRenderer
from scenetruth.render.pyrender_backend import PyrenderRenderer
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import Scene, load_scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.texture import SurfaceTexture
from scenetruth.scene.texture.image_textures import Picture
from scenetruth.truth import GeometryPass, truth_maps

SCENES = Path(__file__).parents[1] / "scenes"
Map = NDArray[Any]
Row = tuple[str, str, str, str]

_MITSUBA_PROBE = """
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
import numpy as np
np.array(mi.render(mi.load_dict(mi.cornell_box()), spp=1))
"""


class Case:
    """A scene at t = 0 seen from the reference camera, with its truth."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.world: BuiltScene = build_scene(self.scene)
        self.topology = Topology.of(self.world.at(0).vertices_mm, self.world.faces)
        self.truth = self.make_truth()
        # What is no edge, nor beside one.
        edge = self.truth["mixed"] | ~np.isfinite(self.truth["depth"])
        grown = edge.copy()
        for shift in (-1, 1):
            for axis in (0, 1):
                grown |= np.roll(edge, shift, axis)
        self.interior = ~grown

    def make_truth(self) -> dict[str, Map]:
        """Return the truth, with the geometry made anew."""
        geometry = GeometryPass(self.world, self.topology, 0.0)
        return truth_maps(geometry, self.scene.camera, Viewpoint.on_axis(0.0), self.scene.stage.baseline_mm)

    def bilinear_world(self) -> BuiltScene:
        """Return the world with its textures as rasters that are interpolated as the other renderers do it."""
        bodies = [
            replace(body, texture=Picture(texels_of(body.texture), body.texture.tiled)) for body in self.world.bodies
        ]
        return BuiltScene(tuple(bodies))

    @property
    def corners_mm(self) -> NDArray[np.float64]:
        """Corners of all faces, each with a vertex of its own, shape (3 m, 3)."""
        return self.world.at(0).vertices_mm[self.world.faces].reshape(-1, 3)

    @property
    def uv(self) -> NDArray[np.float64]:
        """Texture coordinates of `corners_mm`."""
        return self.world.uv.reshape(-1, 2)

    def depth_error(self, depth: Map) -> str:
        """Return the largest and the median disagreement with the truth away from edges, in mm."""
        values = np.abs(depth - self.truth["depth"])[self.interior]
        return f"{np.nanmax(values):.1e} / {np.nanmedian(values):.1e}"

    def image_error(self, image: Map, reference: Map) -> str:
        """Return the rms and the largest disagreement with an image away from edges, in full scales."""
        values = (image - reference)[self.interior]
        return f"{np.sqrt(np.mean(values**2)):.1e} / {np.abs(values).max():.1e}"


def texels_of(texture: SurfaceTexture) -> NDArray[np.float32]:
    """Return the radiance at the texels of a texture's raster."""
    rows, columns = texture.raster().shape
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    return texture.radiance(np.column_stack([u.ravel(), v.ravel()])).reshape(rows, columns)


def relief(folder: Path) -> Scene:
    """Return a scene with a wavy sheet that is imported from a file, with its own texture coordinates and an image."""
    u, v = np.meshgrid(np.linspace(0, 1, 61), np.linspace(0, 1, 46))
    height = 3 * np.sin(2 * np.pi * 1.5 * u) * np.cos(2 * np.pi * v)
    corner = (np.arange(45)[:, None] * 61 + np.arange(60)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 62, 1], corner[:, None] + [0, 61, 62]])
    lines = [
        f"v {80 * (x - 0.5):.9f} {60 * (y - 0.5):.9f} {z:.9f}"
        for x, y, z in zip(u.flat, v.flat, height.flat, strict=True)
    ]
    lines += [f"vt {x:.9f} {1 - y:.9f}" for x, y in zip(u.flat, v.flat, strict=True)]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces + 1]
    (folder / "relief.obj").write_text("\n".join(lines))
    noise = gaussian_filter(np.random.default_rng(4).normal(size=(600, 800)), 1.5)
    imwrite(folder / "relief.png", np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8))
    return Scene.from_dict(
        {
            "camera": {"width": 640, "height": 480, "focal_length_px": 5016},
            "stage": {"positions": 1, "baseline_mm": 5},
            "frames": {"count": 1},
            "objects": [
                {
                    "name": "relief",
                    "mesh": {"kind": "file", "file": str(folder / "relief.obj")},
                    "texture": {"kind": "image", "file": str(folder / "relief.png")},
                    "pose": {"position_mm": [0, 0, 660]},
                }
            ],
        }
    )


def timed(function: Callable[[], Any], runs: int = 15) -> tuple[Any, str]:
    """Return a result and the median time of several runs in ms, after one to warm up."""
    result, seconds = function(), []
    for _ in range(runs):
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return result, f"{1e3 * float(np.median(seconds)):.1f}"


def own_rows(case: Case, reference: Map) -> list[Row]:
    """Measure the package's two backends and its truth."""
    scene, rows = case.scene, []
    for make in (RaycastRenderer, PyrenderRenderer):
        for samples in (1, 4):
            name = make.__name__.removesuffix("Renderer").lower()
            try:
                renderer = make(case.world, scene.camera, scene.background, samples)
            except BackendUnavailableError as error:
                rows.append((f"{name} {samples} x {samples}", f"does not run here: {error}", "", ""))
                continue
            with renderer as ready:
                image, each = timed(lambda ready=ready: ready.render(0.0, Viewpoint.on_axis(0.0)))
                rows.append((f"{name} {samples} x {samples}", each, "", case.image_error(image, reference)))
    with AdaptiveRenderer(case.world, scene.camera, scene.background) as ready:
        image, each = timed(lambda: ready.render(0.0, Viewpoint.on_axis(0.0)))
        rows.append(("raycast, auto", each, "", case.image_error(image, reference)))
    maps, each = timed(case.make_truth)
    rows.append(("truth, all maps", each, case.depth_error(maps["depth"]), ""))
    return rows


def riley_rows(case: Case, reference: Map) -> list[Row]:
    """Measure riley-raster: float64, so its depth is an independent reading of the truth."""
    if importlib.util.find_spec("riley") is None:
        return [("riley-raster", "not installed", "", "")]
    import riley

    camera, texture = case.scene.camera, case.world.bodies[0].texture
    # riley looks along -Z with Y up; a turn about X does not change the winding.
    coords = np.ascontiguousarray(case.corners_mm * [1, -1, -1])
    connect = np.arange(len(coords), dtype=np.int64).reshape(-1, 3)
    convention = riley.ConnectConvention(riley.EElemType.TRI3, riley.EConnectAxis.ROW, 0, riley.ENodeOrder.RILEY)
    raster = texels_of(texture)
    # u, v in 0..1 go to the centres of the first and last texel.
    size = np.array(raster.shape[::-1])
    uvs = (case.uv * size - 0.5) / (size - 1)
    shaders = {
        "depth": riley.NodalShader(field=np.ascontiguousarray(-coords[:, 2:]), scaling_type=riley.ScaleStrategy.none),
        "image": riley.TextureShader(
            uvs=np.ascontiguousarray(uvs),
            texture=np.ascontiguousarray(raster[None], dtype=np.float32),
            sample=riley.TextureSample.linear,
        ),
    }

    def draw(kind: str, samples: int) -> Callable[[], Map]:
        mesh = riley.create_mesh(
            convention=convention,
            mesh_type=riley.MeshType.tri3,
            coords=coords,
            connect=connect,
            shader=shaders[kind],
        )
        eye = riley.Camera(
            pixels_num=(camera.width, camera.height),
            pixels_size=(1e-3, 1e-3),
            pos_world=(0.0, 0.0, 0.0),
            rot_world=(0.0, 0.0, 0.0),
            roi_cent_world=(0.0, 0.0, -1.0),
            focal_length=camera.focal_px * 1e-3,
            sub_sample=samples,
            coord_sys=riley.CameraCoordSys.opengl,
        )
        config = riley.RasterConfig(
            save_strategy=riley.SaveStrategy.memory,
            image_save_mode=riley.ImageSaveMode.grey,
            report=riley.ReportMode.off,
        )
        return lambda: np.asarray(riley.raster(mesh, eye, config)).reshape(camera.height, camera.width)

    depth, each = timed(draw("depth", 1))
    rows = [("riley-raster, depth", each, case.depth_error(depth), "")]
    for samples in (1, 4):
        image, each = timed(draw("image", samples))
        name = f"riley-raster {samples} x {samples}, linear texture"
        rows.append((name, each, "", case.image_error(image, reference)))
    return rows


def mitsuba_rows(case: Case, reference: Map) -> list[Row]:
    """Measure Mitsuba 3, compiled by LLVM where that runs (it aborts the process with some versions of the library)."""
    if importlib.util.find_spec("mitsuba") is None:
        return [("Mitsuba 3", "not installed", "", "")]
    probe = subprocess.run([sys.executable, "-c", _MITSUBA_PROBE], capture_output=True, check=False)
    variant = "llvm_ad_rgb" if probe.returncode == 0 else "scalar_rgb"
    import mitsuba as mi

    mi.set_variant(variant)
    camera = case.scene.camera
    corners, uv = case.corners_mm, case.uv
    mesh = mi.Mesh("mesh", len(corners), len(corners) // 3, has_vertex_texcoords=True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = corners.ravel().astype(np.float32)
    values["vertex_texcoords"] = uv.ravel().astype(np.float32)
    values["faces"] = np.arange(len(corners), dtype=np.uint32)
    values.update()
    raster = np.repeat(texels_of(case.world.bodies[0].texture)[..., None], 3, axis=2)
    folder = Path(__file__).parents[1] / "outputs"
    file = folder / "mitsuba_mesh.ply"
    mesh.write_ply(str(file))
    shape = {
        "type": "ply",
        "filename": str(file),
        "face_normals": True,
        "emitter": {
            "type": "area",
            "radiance": {"type": "bitmap", "bitmap": mi.Bitmap(raster), "raw": True, "filter_type": "bilinear"},
        },
    }
    sensor = {
        "type": "perspective",
        "fov": float(np.rad2deg(2 * np.arctan(camera.width / 2 / camera.focal_px))),
        "fov_axis": "x",
        "near_clip": 1.0,
        # Its camera looks along +Z with X to the left and Y up.
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "luminance",
            "component_format": "float32",
        },
    }
    rows: list[Row] = []
    for name, samples, integrator in (
        ("position, one ray per pixel", 1, {"type": "aov", "aovs": "p:position"}),
        ("16 samples", 16, {"type": "direct"}),
    ):
        sampler = {"type": "stratified" if samples > 1 else "independent", "sample_count": samples}
        if samples > 1:
            sampler["jitter"] = False
        scene = mi.load_dict(
            {"type": "scene", "integrator": integrator, "sensor": {**sensor, "sampler": sampler}, "shape": shape}
        )
        values_, each = timed(lambda scene=scene, samples=samples: np.array(mi.render(scene, spp=samples)), runs=5)
        if samples > 1:
            rows.append((f"Mitsuba ({variant}), {name}", each, "", case.image_error(values_[..., 0], reference)))
        else:
            # Rays are jittered in their pixels: depth is held against the plane that the truth gives at their hit.
            rows.append((f"Mitsuba ({variant}), {name}", each, case.depth_error(_at_centres(case, values_)), ""))
    file.unlink()
    return rows


def _at_centres(case: Case, points: Map) -> Map:
    """Move depths of points met anywhere in their pixels to the pixel centres, along the truth's planes."""
    points, normal = points[..., -3:].astype(np.float64), np.moveaxis(case.truth["normal"], 0, -1)
    directions = case.scene.camera.ray_directions(case.scene.camera.pixel_grid())
    return np.asarray((points * normal).sum(axis=-1) / (directions * normal).sum(axis=-1))


def main() -> None:
    """Print a table for the cube, the plane, and a mesh from a file."""
    with TemporaryDirectory() as folder:
        cases = {
            name: Case(load_scene(SCENES / f"{name}.yaml", overrides=["sensor=ideal"])) for name in ("cube", "plane")
        }
        cases["imported relief"] = Case(relief(Path(folder)))
    for name, case in cases.items():
        with RaycastRenderer(case.bilinear_world(), case.scene.camera, case.scene.background, 4) as renderer:
            # With even samples, as the others have them.
            renderer._smooth = renderer._mixed
            reference = renderer.render(0.0, Viewpoint.on_axis(0.0))
        print(f"\n{name}, {case.scene.camera.width} x {case.scene.camera.height}, away from edges\n")
        print(
            "| renderer | ms per image | depth - truth, max / median, mm | image - bilinear raycast 4 x 4, rms / max |"
        )
        print("|---|---|---|---|")
        for row in (*own_rows(case, reference), *riley_rows(case, reference), *mitsuba_rows(case, reference)):
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
