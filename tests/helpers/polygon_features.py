"""Features of OBJ, PLY, STL and OFF files; the values are those of the figures that their numbers draw."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from tests.helpers.file_features import FileFeature

__all__ = ["POLYGON_FEATURES", "SQUARE", "UV", "UV_QUAD", "png"]

# An L of three unit squares, and a unit square at (3, 0).
L_SHAPE = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n"
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
QUAD = "f 1 2 3 4\n"
UV = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
UV_QUAD = "f 1/1 2/2 3/3 4/4\n"
RED = 0.2126
GREEN = 0.7152


def png(values: Any, form: str = "PNG", **options: Any) -> bytes:
    """Return a picture of grey values or colours."""
    out = io.BytesIO()
    Image.fromarray(np.asarray(values, dtype=np.uint8)).save(out, form, **options)
    return out.getvalue()


# Texel centres lie at a quarter and three quarters.
GREYS = png([[51, 102], [153, 204]])
LEFT_TOP, LEFT_BOTTOM, RIGHT_TOP = ((0.25, 0.75), 0.2), ((0.25, 0.25), 0.6), ((0.75, 0.75), 0.4)


def obj(name: str, text: str | bytes, occurs: str = "", **more: Any) -> FileFeature:
    """Return a feature of an OBJ file alone."""
    return FileFeature("OBJ", name, {"mesh.obj": text}, occurs, **more)


def mtl(
    name: str, library: str | bytes, occurs: str = "", files: dict[str, bytes] | None = None, **more: Any
) -> FileFeature:
    """Return a feature of the material library of a unit square."""
    text = f"mtllib my.mtl\n{SQUARE}{UV}usemtl leaf\n{UV_QUAD}"
    return FileFeature("MTL", name, {"mesh.obj": text, "my.mtl": library, **(files or {})}, occurs, **more)


def textured(name: str, statement: str, picture: str = "grey.png", occurs: str = "", **more: Any) -> FileFeature:
    """Return a feature of a picture statement."""
    more = {"area": 1.0, "shades": (LEFT_TOP, LEFT_BOTTOM, RIGHT_TOP), **more}
    return mtl(name, f"newmtl leaf\nKd 1 1 1\n{statement}\n", occurs, {picture: GREYS}, **more)


_OBJ = (
    obj("triangles", SQUARE + "f 1 2 3\nf 1 3 4\n", "assimp box.obj", area=1, polygons=2),
    obj("quadrilaterals", SQUARE + QUAD, area=1, polygons=1),
    obj("concave polygon", L_SHAPE + "f 1 2 3 4 5 6\n", "assimp concave_polygon.obj", area=3, polygons=1),
    obj("clockwise concave polygon", L_SHAPE + "f 6 5 4 3 2 1\n", area=3, polygons=1),
    obj(
        "polygon with a hole, joined by a seam",
        "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nv 1 1 0\nv 1 2 0\nv 2 2 0\nv 2 1 0\nf 1 2 3 4 1 5 6 7 8 5\n",
        "trimesh wallhole.obj",
        area=8,
        polygons=1,
    ),
    obj("collinear corners", "v 0 0 0\nv .5 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4 5\n", area=1, polygons=1),
    obj("corners that repeat the corner before", SQUARE + "f 1 1 2 3 3 4 1\n", area=1, polygons=1, note="1 components"),
    obj("polygon that intersects itself", SQUARE + "f 1 3 2 4\n", rejected="intersects itself"),
    obj(
        "polygon that is far from plane and concave",
        "v -5 0 5\nv 5 0 5\nv 5 0 -5\nv -5 0 -5\nv 0 5 -5\nf 1 2 3 4 5\n",
        "trimesh polygonfaces.obj",
        rejected="far from plane",
    ),
    obj(
        "negative indices after several blocks",
        SQUARE + "f -4 -3 -2 -1\nv 3 0 0\nv 5 0 0\nv 5 1 0\nf -1 -2 -3\n",
        "trimesh negative_indices.obj, issue 2364",
        area=2,
        polygons=2,
    ),
    obj("negative indices of texture coordinates", SQUARE + UV + "f -4/-4 -3/-3 -2/-2 -1/-1\n", area=1, polygons=1),
    obj("vertices after the faces that use them", QUAD + SQUARE, area=1, polygons=1),
    obj(
        "index 0",
        SQUARE + "f 0 1 2\nf 1 2 3\n",
        "tinyobjloader issue-140-zero-face-idx.obj",
        rejected="indices begin at 1",
    ),
    obj("index beyond the vertices", SQUARE + "f 1 2 5\n", rejected="there are 4"),
    obj(
        "negative index beyond the vertices before it",
        SQUARE + "f -5 -3 -2\n",
        "tinyobjloader invalid-relative-vertex-index.obj",
        rejected="there are 4 before it",
    ),
    obj("face of two corners", SQUARE + "f 1 2\n", "trimesh notenoughindices.obj", rejected="fewer than 3"),
    obj(
        "byte-order mark",
        b"\xef\xbb\xbf" + (SQUARE + QUAD).encode(),
        "tinyobjloader cube_w_BOM.obj",
        area=1,
        polygons=1,
    ),
    obj("UTF-16", (SQUARE + QUAD).encode("utf-16"), "assimp box_UTF16BE.obj", rejected="UTF-16"),
    obj(
        "tabs and indents",
        SQUARE.replace(" ", "\t").replace("v", "  v") + "\tf  1\t2 3   4\n",
        "assimp multiple_spaces.obj",
        area=1,
        polygons=1,
    ),
    obj(
        "comments behind numbers",
        SQUARE.replace(" 0\n", " 0 # a corner\n") + "f 1 2 3 4 # all\n",
        "tinyobjloader issue-389-comment.obj",
        area=1,
        polygons=1,
    ),
    obj("lines continued by a backslash", SQUARE + "f 1 2 \\\n3 \\\r\n4\n", "trimesh wallhole.obj", area=1, polygons=1),
    obj("line ends of Windows", (SQUARE + QUAD).replace("\n", "\r\n"), area=1, polygons=1),
    obj("last line without an end", SQUARE + QUAD.strip(), "assimp box_without_lineending.obj", area=1, polygons=1),
    obj(
        "numbers such as .5, +1 and 1e0",
        "v +.0 0. 0\nv 1e0 0 0\nv +1 1.0E+00 0\nv -0 1 0\n" + QUAD,
        "tinyobjloader leading-decimal-dot-issue-201.obj",
        area=1,
        polygons=1,
    ),
    obj("decimal commas", SQUARE.replace("1 ", "1,0 ") + QUAD, rejected="use a decimal point"),
    obj(
        "NaN in a vertex",
        SQUARE.replace("v 1 1 0", "v 1 nan 0") + QUAD,
        "tinyobjloader test-nan.obj",
        rejected="not finite",
    ),
    obj("weights of 1 behind the coordinates", SQUARE.replace(" 0\n", " 0 1\n") + QUAD, area=1, polygons=1),
    obj(
        "rational vertices",
        SQUARE.replace(" 0\n", " 0 2\n") + QUAD,
        "tinyobjloader cube-vertex-w-component.obj",
        rejected="rational",
    ),
    obj(
        "colours of vertices",
        "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 1 0 1 0 0\nv 0 1 0 1 0 0\n" + QUAD,
        "assimp cube_with_vertexcolors.obj",
        area=1,
        polygons=1,
        shades=(((0.5, 0.4), RED),),
    ),
    obj(
        "colours of some vertices only",
        SQUARE + "v 2 2 0 1 0 0\n" + QUAD,
        "assimp only_a_part_of_vertexcolors.obj",
        rejected="has 6 numbers, and the first has 3",
    ),
    obj(
        "a face in the name of a group",
        "g f 1 2 3\no v 1 1\n" + SQUARE + QUAD,
        "trimesh face_in_group_name.obj",
        area=1,
        polygons=1,
    ),
    obj("lines and points", SQUARE + "l 1 2\np 1\n" + QUAD, "assimp testmixed.obj", area=1, polygons=1, note="1 x l"),
    obj("lines and points alone", SQUARE + "l 1 2\np 1\n", "assimp testline.obj", rejected="no faces"),
    obj("empty file of comments", "# nothing\n", "trimesh empty.obj", rejected="no faces"),
    obj("free-form surfaces", SQUARE + "cstype bezier\ndeg 3\n", rejected="free-form"),
    obj(
        "references to normals that are missing",
        SQUARE + "f 1//1 2//1 3//1 4//1\n",
        "tinyobjloader smoothing-group-two-squares.obj",
        area=1,
        polygons=1,
        note="of which there are none",
    ),
    obj(
        "references to texture coordinates that are missing",
        SQUARE + "f 1/1 2/2 3/3 4/4\n",
        "trimesh cubevt.obj",
        rejected="texture coordinate 1",
    ),
    obj(
        "texture coordinates of three numbers",
        SQUARE + UV.replace("\n", " 0\n") + UV_QUAD,
        "tinyobjloader texcoord-w.obj",
        area=1,
        polygons=1,
    ),
    obj(
        "corners with and without references",
        SQUARE + UV + "f 1/1 2/2 3/3\nf 1 3 4\n",
        "tinyobjloader issue-161-inconsistent-f.obj",
        area=1,
        polygons=2,
    ),
    obj(
        "faces that stand twice, also reversed",
        SQUARE + QUAD + "f 4 3 2 1\n" + QUAD,
        "trimesh chair_model.obj",
        area=1,
        note="stand twice",
    ),
    obj("faces without an area", SQUARE + QUAD + "f 1 1 2\n", area=1, note="without area"),
)

_MTL = (
    textured("picture", "map_Kd grey.png", polygons=1),
    textured(
        "name with spaces", "map_Kd grey one.png", "grey one.png", "tinyobjloader texture-filename-with-whitespace.obj"
    ),
    textured("quoted name", 'map_Kd "grey one.png"', "grey one.png"),
    textured("name with %20", "map_Kd grey%20one.png", "grey one.png"),
    textured("name with escaped spaces", "map_Kd grey\\ one.png", "grey one.png"),
    textured(
        "folder with a backslash", "map_Kd textures\\grey.png", "textures/grey.png", "assimp mtl_different_folder.obj"
    ),
    textured(
        "options without effect",
        "map_Kd -blendu on -texres 512 -bm 0.2 -mm 0 1 grey.png",
        occurs="tinyobjloader issue-248-texres-texopt.obj",
    ),
    textured("tabs and statements in lower case", "\tmap_kd\t-clamp\ton\tgrey.png"),
    textured(
        "scale and offset",
        "map_Kd -s 0.5 0.5 -o 0.5 0 grey.png",
        occurs="tinyobjloader texture-options-issue-85.obj",
        shades=(((0.5, 0.5), 0.8),),
    ),
    textured(
        "clamped beyond the picture", "map_Kd -s 4 4 -clamp on grey.png", shades=(((0.9, 0.1), 0.68), ((0.9, 0.9), 0.4))
    ),
    textured("option that changes values", "map_Kd -mm 0.1 0.5 grey.png", rejected="is not read", of_colours=True),
    textured(
        "option of a colour space",
        "map_Kd -colorspace sRGB grey.png",
        occurs="tinyobjloader colorspace-issue-184.obj",
        rejected="-colorspace",
        of_colours=True,
    ),
    textured("comment behind the name", "map_Kd grey.png # the front"),
    textured(
        "path of another machine",
        r"map_Kd C:\work\leaf\grey.png",
        rejected='the folder of my.mtl has "grey.png": remove the path',
        of_colours=True,
    ),
    mtl(
        "opacity of 1 and a comment",
        "newmtl leaf\nKd 0 0.5 0\nd 1.0 # opaque\n",
        area=1,
        shades=(((0.5, 0.4), GREEN / 2),),
    ),
    textured("picture that is missing", "map_Kd other.png", rejected='"other.png" is missing', of_colours=True),
    mtl(
        "diffuse colour",
        "newmtl leaf\nKd 0 0.5 0\n",
        "assimp cube_usemtl.obj",
        area=1,
        shades=(((0.5, 0.4), GREEN / 2),),
    ),
    mtl(
        "diffuse colour times picture",
        "newmtl leaf\nmap_Kd a.png\nKd 0.5 0.5 0.5\n",
        files={"a.png": GREYS},
        area=1,
        shades=(((0.25, 0.75), 0.1),),
    ),
    mtl("byte-order mark", b"\xef\xbb\xbfnewmtl leaf\nKd 1 0 0\n", area=1, shades=(((0.5, 0.4), RED),)),
    mtl(
        "indented statements",
        "  newmtl leaf\n\tKd 1 0 0\n",
        "tinyobjloader issue-356-leading-spaces-newmtl.obj",
        area=1,
        shades=(((0.5, 0.4), RED),),
    ),
    mtl(
        "opacity",
        "newmtl leaf\nKd 1 0 0\nd 0.5\n",
        "tinyobjloader tr-and-d-issue-43.obj",
        area=1,
        rejected="opacity 0.5",
        of_colours=True,
    ),
    mtl(
        "Tr 1 of MeshLab",
        "newmtl leaf\nKd 1 0 0\nTr 1.0\n",
        "trimesh fuze.obj.mtl",
        area=1,
        shades=(((0.5, 0.4), RED),),
    ),
    mtl(
        "map of opacity (map_d)",
        "newmtl leaf\nKd 1 1 1\nmap_Kd a.png\nmap_d a.png\n",
        "tinyobjloader texture-options-issue-85.mtl",
        {"a.png": GREYS},
        rejected="map_d",
    ),
    mtl(
        "diffuse colour of zero times picture",
        "newmtl leaf\nKd 0 0 0\nmap_Kd a.png\n",
        files={"a.png": GREYS},
        area=1,
        rejected="Kd 0 0 0",
        of_colours=True,
    ),
    mtl("spectral colours", "newmtl leaf\nKd spectral file.rfl\n", area=1, rejected="spectral", of_colours=True),
    mtl(
        "material that the library does not have",
        "newmtl other\nKd 1 0 0\n",
        "assimp empty_mat.obj",
        area=1,
        rejected="which its material library does not have",
        of_colours=True,
    ),
    FileFeature(
        "MTL",
        "library that is missing",
        {"a.obj": "mtllib no.mtl\n" + SQUARE + "usemtl leaf\n" + QUAD},
        "tinyobjloader missing_material_file.obj",
        1,
        rejected="no.mtl",
        of_colours=True,
    ),
    FileFeature(
        "MTL",
        "several libraries, of which one exists",
        {"a.obj": "mtllib no.mtl b.mtl\n" + SQUARE + "usemtl leaf\n" + QUAD, "b.mtl": "newmtl leaf\nKd 1 0 0\n"},
        "tinyobjloader mtllib-multiple-files-issue-112.obj",
        1,
        shades=(((0.5, 0.4), RED),),
    ),
    FileFeature(
        "MTL",
        "names with a number sign, and comments",
        {"a.obj": "mtllib b.mtl # all\n" + SQUARE + "usemtl Leaf #25\n" + QUAD, "b.mtl": "newmtl Leaf #25\nKd 1 0 0\n"},
        "",
        1,
        shades=(((0.5, 0.4), RED),),
    ),
    FileFeature(
        "MTL",
        "several materials, and texture coordinates beyond 1",
        {
            "a.obj": f"mtllib b.mtl\n{SQUARE}v 2 0 0\nv 2 1 0\nvt 0 0\nvt 2 0\nvt 2 2\nvt 0 2\nusemtl one\n{UV_QUAD}"
            "usemtl two\nf 2/1 5/2 6/3 3/4\n",
            "b.mtl": "newmtl one\nmap_Kd g.png\nnewmtl two\nKd 0 1 0\n",
            "g.png": GREYS,
        },
        "trimesh issue 1943",
        2,
        2,
        (((0.125, 0.875), 0.2), ((0.625, 0.375), 0.2), ((1.5, 0.4), GREEN)),
    ),
)


def ply(name: str, header: str, data: str | bytes, occurs: str = "", ends: str = "\n", **more: Any) -> FileFeature:
    """Return a feature of a PLY file with the given statements between the first and the last line."""
    content = data if isinstance(data, bytes) else data.encode()
    head = f"ply\n{header.strip()}\nend_header\n".replace("\n", ends).encode()
    return FileFeature("PLY", name, {"mesh.ply": head + content}, occurs, **more)


ASCII, LITTLE, BIG = (f"format {kind} 1.0\n" for kind in ("ascii", "binary_little_endian", "binary_big_endian"))
XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices"
FOUR = f"element vertex 4\n{XYZ}"
SIX = f"element vertex 6\n{XYZ}"
L_POINTS = ((0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0))
POINTS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))
ROWS = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS)


def packed(order: str, points: Sequence[Sequence[float]], faces: Sequence[Sequence[int]], length: str = "B") -> bytes:
    """Return vertices and faces in binary form."""
    found = b"".join(struct.pack(f"{order}3f", *point) for point in points)
    return found + b"".join(struct.pack(f"{order}{length}{len(face)}i", len(face), *face) for face in faces)


MIXED = ((0, 1, 2, 3, 5), (3, 4, 5))
TWO = FACES.replace("face 1", "face 2")

_PLY = (
    ply("ASCII", ASCII + FOUR + FACES, ROWS + "4 0 1 2 3\n", "assimp cube.ply", area=1, polygons=1),
    ply(
        "little-endian",
        LITTLE + FOUR + FACES,
        packed("<", POINTS, [(0, 1, 2, 3)]),
        "assimp cube_binary.ply",
        area=1,
        polygons=1,
    ),
    ply("big-endian", BIG + FOUR + FACES, packed(">", POINTS, [(0, 1, 2, 3)]), area=1, polygons=1),
    ply(
        "polygons of different lengths, binary",
        LITTLE + SIX + TWO,
        packed("<", L_POINTS, MIXED),
        "assimp issue 1149",
        area=3,
        polygons=2,
    ),
    ply("concave polygon", LITTLE + SIX + FACES, packed("<", L_POINTS, [range(6)]), area=3, polygons=1),
    ply(
        "list lengths of 16 bits",
        LITTLE + FOUR + FACES.replace("uchar int", "ushort int"),
        packed("<", POINTS, [(0, 1, 2, 3)], "H"),
        "meshlab issue 1126",
        area=1,
        polygons=1,
    ),
    ply(
        "vertex_index instead of vertex_indices",
        ASCII + FOUR + FACES.replace("indices", "index"),
        ROWS + "4 0 1 2 3\n",
        "assimp issue 122",
        area=1,
        polygons=1,
    ),
    ply(
        "line ends of Windows in a binary file",
        LITTLE + FOUR + FACES,
        packed("<", POINTS, [(0, 1, 2, 3)]),
        "assimp issue 2534",
        "\r\n",
        area=1,
        polygons=1,
    ),
    FileFeature(
        "PLY",
        "line ends of Windows in the first line only",
        {
            "mesh.ply": b"ply\r\n"
            + f"{LITTLE}{FOUR}{FACES}\nend_header\n".encode()
            + packed("<", POINTS, [(0, 1, 2, 3)])
        },
        "assimp cube_binary_header_with_RN_newline.ply",
        1,
        1,
    ),
    ply(
        "line ends of a carriage return",
        LITTLE + FOUR + FACES,
        packed("<", POINTS, [(0, 1, 2, 3)]),
        "",
        "\r",
        area=1,
        polygons=1,
    ),
    ply(
        "binary data that begin with a line end",
        LITTLE + FOUR.replace("float x", "uchar x") + FACES,
        b"".join(struct.pack("<B2f", 10 + x, y, z) for x, y, z in POINTS) + struct.pack("<B4i", 4, 0, 1, 2, 3),
        "assimp cube_binary_starts_with_nl.ply",
        area=1,
        polygons=1,
    ),
    ply(
        "double coordinates and further properties",
        LITTLE + "element vertex 3\nproperty double x\nproperty uchar q\n"
        "property double y\nproperty double z\n" + FACES,
        b"".join(struct.pack("<dBdd", x, 7, y, z) for x, y, z in POINTS[:3]) + struct.pack("<B3i", 3, 0, 1, 2),
        area=0.5,
        polygons=1,
    ),
    ply(
        "further elements and lists",
        ASCII + "comment none\nobj_info none\nelement camera 1\nproperty list uchar float v\n" + FOUR + FACES,
        "2 1.5 2.5\n" + ROWS + "4 0 1 2 3\n",
        "trimesh points_ascii_with_lists.ply",
        area=1,
        polygons=1,
        note="camera",
    ),
    ply(
        "colours of 8 bits",
        ASCII + FOUR + "property uchar red\nproperty uchar green\nproperty uchar blue\n" + FACES,
        ROWS.replace("\n", " 255 0 0\n") + "4 0 1 2 3\n",
        "trimesh reference.ply",
        area=1,
        shades=(((0.5, 0.4), RED),),
    ),
    ply(
        "colours as floats",
        ASCII + FOUR + "property float red\nproperty float green\nproperty float blue\n" + FACES,
        ROWS.replace("\n", " 0 0.5 0\n") + "4 0 1 2 3\n",
        "assimp float-color.ply",
        area=1,
        shades=(((0.5, 0.4), GREEN / 2),),
    ),
    ply(
        "opacity of vertices",
        ASCII + FOUR + "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n" + FACES,
        ROWS.replace("\n", " 255 0 0 9\n") + "4 0 1 2 3\n",
        area=1,
        shades=(((0.5, 0.4), RED),),
        note="opacity",
    ),
    ply(
        "colours of faces",
        ASCII + FOUR + FACES + "\nproperty uchar red\nproperty uchar green\nproperty uchar blue",
        ROWS + "4 0 1 2 3 0 255 0\n",
        area=1,
        shades=(((0.5, 0.4), GREEN),),
    ),
    FileFeature(
        "PLY",
        "texture coordinates of corners and a picture",
        {
            "a.ply": f"ply\n{ASCII}comment TextureFile g.png\n{FOUR}{FACES}\n"
            f"property list uchar float texcoord\nend_header\n{ROWS}"
            "4 0 1 2 3 8 0 0 1 0 1 1 0 1\n",
            "g.png": GREYS,
        },
        "trimesh fuze.ply",
        1,
        1,
        (LEFT_TOP, LEFT_BOTTOM, RIGHT_TOP),
    ),
    FileFeature(
        "PLY",
        "texture coordinates of vertices and a picture",
        {
            "a.ply": f"ply\n{ASCII}comment TextureFile g.png\n{FOUR}"
            f"property float s\nproperty float t\n{FACES}\nend_header\n"
            "0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3\n",
            "g.png": GREYS,
        },
        "trimesh cube_blender_uv.ply",
        1,
        1,
        (LEFT_TOP, LEFT_BOTTOM, RIGHT_TOP),
    ),
    ply("points alone", ASCII + FOUR, ROWS, "assimp points.ply", rejected="no faces"),
    ply("fewer faces than declared", LITTLE + FOUR + TWO, packed("<", POINTS, [(0, 1, 2, 3)]), rejected="ends within"),
    ply("more values than declared", ASCII + FOUR + FACES, ROWS + "4 0 1 2 3\n3 0 1 2\n", rejected="more values"),
    ply(
        "bytes behind the last face",
        LITTLE + FOUR + FACES,
        packed("<", POINTS, [(0, 1, 2, 3)]) + b"abc",
        area=1,
        note="3 bytes",
    ),
    ply(
        "statement that is none",
        ASCII + "Created by a program\n" + FOUR + FACES,
        ROWS + "4 0 1 2 3\n",
        "assimp Wuson.ply",
        rejected="Created by a program",
    ),
    ply("index beyond the vertices", ASCII + FOUR + FACES, ROWS + "3 0 1 4\n", rejected="vertex 4"),
    ply("negative index", ASCII + FOUR + FACES, ROWS + "3 0 1 -1\n", rejected="vertex -1"),
    ply(
        "triangle strips",
        ASCII + FOUR + "element tristrips 1\nproperty list int int vertex_indices",
        ROWS + "4 0 1 3 2\n",
        rejected="triangle strips",
    ),
)


def stl(*triangles: Any, head: bytes = b"", count: int | None = None, tail: bytes = b"", extra: int = 0) -> bytes:
    """Return a binary STL file."""
    parts = [struct.pack("<12fH", 0, 0, 0, *np.ravel(points), extra) for points in triangles]
    return head.ljust(80, b"\0") + struct.pack("<I", len(parts) if count is None else count) + b"".join(parts) + tail


def text_stl(*triangles: Any, name: str = "one") -> str:
    """Return an ASCII STL file."""
    rows = ["".join(f"   vertex {x} {y} {z}\n" for x, y, z in points) for points in triangles]
    facets = "".join(f" facet normal 0 0 1\n  outer loop\n{row}  endloop\n endfacet\n" for row in rows)
    return f"solid {name}\n{facets}endsolid {name}\n"


LOWER, UPPER = (POINTS[0], POINTS[1], POINTS[2]), (POINTS[0], POINTS[2], POINTS[3])

_STL = tuple(
    FileFeature("STL", name, {"mesh.stl": content}, occurs, **more)
    for name, content, occurs, more in (
        ("binary", stl(LOWER, UPPER), "assimp Spider_binary.stl", {"area": 1, "polygons": 2}),
        ("ASCII", text_stl(LOWER, UPPER), "assimp Spider_ascii.stl", {"area": 1, "polygons": 2}),
        ("ASCII in upper case", text_stl(LOWER, UPPER).upper(), "", {"area": 1, "polygons": 2}),
        ("ASCII with a byte-order mark", "\ufeff" + text_stl(LOWER, UPPER), "", {"area": 1, "polygons": 2}),
        (
            "several solids",
            text_stl(LOWER) + text_stl(UPPER, name="two"),
            "assimp triangle_with_two_solids.stl",
            {"area": 1, "polygons": 2},
        ),
        (
            "empty solid behind another",
            text_stl(LOWER) + "solid b\nendsolid b\n",
            "assimp triangle_with_empty_solid.stl",
            {"area": 0.5, "polygons": 1},
        ),
        (
            "binary that begins with solid",
            stl(LOWER, UPPER, head=b"solid of SolidWorks"),
            "",
            {"area": 1, "polygons": 2},
        ),
        ("colours in the attributes", stl(LOWER, UPPER, extra=0x801F), "", {"area": 1, "polygons": 2}),
        ("bytes behind the last triangle", stl(LOWER, UPPER, tail=b"abc"), "", {"area": 1, "note": "3 bytes"}),
        ("fewer triangles than declared", stl(LOWER, count=2), "", {"rejected": "declares 2 triangles and has 1"}),
        ("cut off within a facet", text_stl(LOWER)[:70], "", {"rejected": "facet 1 of 1"}),
        ("facet of four vertices", text_stl(POINTS), "", {"rejected": "is not a triangle"}),
        ("NaN in a vertex", stl(LOWER, (POINTS[0], POINTS[1], (0, float("nan"), 0))), "", {"rejected": "not finite"}),
        ("no triangles", stl(), "trimesh stl_empty_bin.stl", {"rejected": "no faces"}),
    )
)

OFF_ROWS = "4 1 0\n" + ROWS
_OFF = tuple(
    FileFeature("OFF", name, {"mesh.off": content}, occurs, **more)
    for name, content, occurs, more in (
        ("polygons", "OFF\n" + OFF_ROWS + "4 0 1 2 3\n", "", {"area": 1, "polygons": 1}),
        (
            "concave polygon",
            "OFF\n6 1 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in L_POINTS) + "6 0 1 2 3 4 5\n",
            "",
            {"area": 3, "polygons": 1},
        ),
        ("numbers on the first line", "OFF " + OFF_ROWS + "4 0 1 2 3\n", "", {"area": 1, "polygons": 1}),
        (
            "comments and empty lines",
            "# a\nOFF\n\n4 1 0 # b\n" + ROWS + "\n4 0 1 2 3 # c\n",
            "trimesh comments.off",
            {"area": 1, "polygons": 1},
        ),
        ("without the first word", OFF_ROWS + "4 0 1 2 3\n", "", {"area": 1, "polygons": 1}),
        (
            "colours of faces",
            "OFF\n" + OFF_ROWS + "4 0 1 2 3 255 0 0\n",
            "",
            {"area": 1, "shades": (((0.5, 0.4), RED),)},
        ),
        (
            "colours of faces from 0.0 to 1.0",
            "OFF\n" + OFF_ROWS + "4 0 1 2 3 0.0 0.5 0.0 1.0\n",
            "",
            {"area": 1, "shades": (((0.5, 0.4), GREEN / 2),)},
        ),
        ("index of a colour map", "OFF\n" + OFF_ROWS + "4 0 1 2 3 7\n", "", {"area": 1, "note": "behind the corners"}),
        (
            "colours of vertices (COFF)",
            "COFF\n4 1 0\n" + ROWS.replace("\n", " 255 0 0 255\n") + "4 0 1 2 3\n",
            "",
            {"area": 1, "shades": (((0.5, 0.4), RED),)},
        ),
        (
            "normals (NOFF)",
            "NOFF\n4 1 0\n" + ROWS.replace("\n", " 0 0 1\n") + "4 0 1 2 3\n",
            "",
            {"area": 1, "polygons": 1},
        ),
        (
            "four dimensions (4OFF)",
            "4OFF\n4 1 0\n" + ROWS.replace("\n", " 1\n") + "4 0 1 2 3\n",
            "",
            {"rejected": "4OFF"},
        ),
        ("binary", "OFF BINARY\n", "", {"rejected": "binary OFF is not read"}),
        ("fewer faces than declared", "OFF\n4 2 0\n" + ROWS + "4 0 1 2 3\n", "", {"rejected": "2 faces"}),
        ("index beyond the vertices", "OFF\n" + OFF_ROWS + "3 0 1 4\n", "", {"rejected": "vertex 4"}),
    )
)

POLYGON_FEATURES: tuple[FileFeature, ...] = (*_OBJ, *_MTL, *_PLY, *_STL, *_OFF)
