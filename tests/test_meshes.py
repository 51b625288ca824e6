"""Meshes: files, trees, rays that are not lost, and images that equal those of known shapes."""

from __future__ import annotations

import json
import struct
import sys

import numpy as np
import pytest
import solids
from kernel_functions import STARTS, evaluate
from scenes import ACTIVE, BROAD, MOIST, run, scene
from scipy.spatial.transform import Rotation

from thzcl.errors import FileError, ScenarioError
from thzcl.surfaces import mesh_file, tree

MESH_KERNELS = ["surfaces/camera", "surfaces/mesh", "surfaces/surfaces"]


# --- trees


def soup(count, seed=0):
    """Triangles anywhere, (triangle, corner, 3)."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 1, 3)) * 10 + rng.normal(size=(count, 3, 3)) * 0.5


@pytest.mark.parametrize("count", [1, 2, 4, 5, 37, 3000])
def test_a_tree_holds_every_triangle_in_its_boxes(count):
    holds(soup(count))


@pytest.mark.parametrize("points", [1, 3, 50])
def test_a_tree_of_equal_triangles_is_not_deep(points):
    corners = np.repeat(soup(points), 4000 // points, axis=0)
    assert holds(corners) < 30


def test_a_tree_of_many_triangles_is_cut_into_blocks(monkeypatch):
    monkeypatch.setattr(tree, "SWEPT", 500)
    monkeypatch.setattr(tree, "BLOCK", 64)
    holds(soup(5000))


def holds(corners):
    """Checks a tree, and returns its depth."""
    made = tree.grow(corners.min(axis=1), corners.max(axis=1))
    assert np.array_equal(np.sort(made.order), np.arange(len(corners)))
    corners = corners[made.order]
    seen, deepest, waiting = np.zeros(len(corners), int), 0, [(0, 1)]
    while waiting:
        node, depth = waiting.pop()
        deepest = max(deepest, depth)
        first, count = made.links[node]
        box = made.boxes[node]
        if count:
            assert count <= 4
            seen[first : first + count] += 1
            inside = corners[first : first + count]
            assert (inside >= box[:3]).all() and (inside <= box[3:]).all()
        else:
            for child in (first, first + 1):
                assert (made.boxes[child, :3] >= box[:3]).all()
                assert (made.boxes[child, 3:] <= box[3:]).all()
                waiting.append((child, depth + 1))
    assert (seen == 1).all()
    return deepest


def test_the_heuristic_beats_medians(monkeypatch):
    corners = soup(4000) * [1, 1, 0.05]
    low, high = corners.min(axis=1), corners.max(axis=1)

    def cost(made):
        edge = made.boxes[:, 3:].astype(float) - made.boxes[:, :3]
        return (edge * np.roll(edge, 1, axis=1)).sum()

    swept = cost(tree.grow(low, high))
    monkeypatch.setattr(tree, "EVEN_FROM", 0)
    assert swept < 0.8 * cost(tree.grow(low, high))


# --- rays and triangles on the device


def strikes(device, setting, corners, origin, direction):
    """What rays meet, by the kernel: reach and triangle of each."""
    made = tree.grow(corners.min(axis=1), corners.max(axis=1))
    corners = corners[made.order].astype(setting.wide)
    count = len(origin)
    numbers = np.arange(3 * len(corners)).reshape(-1, 3)
    four = np.column_stack([numbers, np.zeros(len(numbers))]).astype(np.int32)
    arrays = {
        "boxes": made.boxes,
        "__global int2 *links": made.links,
        "__global int4 *corners": four,
        "vertices": corners.ravel(),
        "origin": origin.astype(setting.wide),
        "direction": direction.astype(setting.wide),
        "reach": np.zeros(count, setting.wide),
        "triangle": np.zeros(count, np.int32),
    }
    body = """
    const mesh all = {boxes, links, corners, vertices, 0};
    wide o[3], d[3];
    for (int k = 0; k < 3; ++k) { o[k] = origin[3 * first + k]; d[k] = direction[3 * first + k]; }
    const shot ray = shot_of(o, d);
    strike met = {INFINITY, -1, 0, 0, 0};
    meet_triangles(&all, &ray, &met);
    reach[first] = met.reach;
    triangle[first] = met.triangle;
    """
    evaluate(device, MESH_KERNELS, body, arrays, count, setting, ["MESHES"])
    found = arrays["triangle"]
    return arrays["reach"], np.where(found < 0, -1, made.order[np.maximum(found, 0)])


@pytest.mark.parametrize("setting", STARTS, ids=str)
def test_rays_through_edges_and_vertices_are_not_lost(device, setting):
    """A closed sphere of 5,120 triangles at 64 m: every ray must meet its front."""
    vertices, faces = solids.sphere(4)
    turn = Rotation.from_rotvec([0.3, 1.1, -0.7]).as_matrix()
    vertices = (vertices @ turn.T + [64.0, 3.0, -2.0]).astype(setting.wide).astype(float)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    through = np.concatenate([vertices, vertices[edges].mean(axis=1)])
    front = (through - [64.0, 3.0, -2.0]) @ [-1.0, 0, 0] > 0.1
    direction = through[front] / np.linalg.norm(through[front], axis=1, keepdims=True)
    origin = np.zeros_like(direction)
    reach, triangle = strikes(device, setting, vertices[faces], origin, direction)
    away = np.linalg.norm(through[front], axis=1)
    assert len(direction) > 6000
    assert (triangle >= 0).all()
    bound = 1e-9 if setting.float64 else 3e-4
    assert np.abs(reach - away).max() < bound


@pytest.mark.parametrize("setting", STARTS, ids=str)
def test_strikes_are_those_of_plain_geometry(device, setting):
    corners, rng = soup(3000), np.random.default_rng(5)
    corners = corners.astype(setting.wide).astype(float)
    origin = rng.normal(size=(1500, 3)) * 20
    aim = corners[rng.integers(0, 3000, 1500)].mean(axis=1)
    direction = aim - origin
    direction[:3], direction[3:6] = np.eye(3), -np.eye(3)
    origin, direction = (one.astype(setting.wide).astype(float) for one in (origin, direction))
    reach, triangle = strikes(device, setting, corners, origin, direction)
    a, b, c = (corners[:, k] for k in range(3))
    met = 0
    for i, (o, d) in enumerate(zip(origin, direction, strict=True)):
        # Moeller and Trumbore in float64, which shares nothing with the kernel's test.
        e, f = b - a, c - a
        p = np.cross(d, f)
        det = (e * p).sum(-1)
        s = o - a
        u = (s * p).sum(-1) / det
        q = np.cross(s, e)
        v = (q @ d) / det
        t = (f * q).sum(-1) / det
        near = 1e-9 if setting.float64 else 1e-3
        inside, clear = ((u >= m) & (v >= m) & (u + v <= 1 - m) & (t > 0) for m in (-near, near))
        if (inside != clear).any():
            continue
        if not clear.any():
            assert triangle[i] == -1
            continue
        first = np.flatnonzero(clear)[t[clear].argmin()]
        rest = np.sort(t[clear])
        if len(rest) > 1 and rest[1] - rest[0] < near:
            continue
        assert triangle[i] == first
        assert reach[i] == pytest.approx(t[first], rel=1e-9 if setting.float64 else 1e-4)
        met += 1
    assert met > 1000


# --- images


def pair(tmp_path, **changes):
    """A scene's box, and the same box as a mesh."""
    solids.npz(tmp_path / "box.npz", solids.CUBE, solids.BOX_FACES)
    one = scene(**changes)
    other = scene(**changes)
    box = one["targets"]["box"]
    size = box["size_m"]
    solids.npz(tmp_path / "box.npz", solids.CUBE * size, solids.BOX_FACES)
    kept = {k: v for k, v in box.items() if k not in ("size_m", "kind")}
    other["targets"]["box"] = {"kind": "mesh", "file": "box.npz"} | kept
    return one, other


OPTICS = {"aperture_m": 0.1, "pixel": False}
SAME = {
    "plain": {},
    "even air": {"atmosphere": MOIST},
    "float64": {"numerics": {"precision": "float64"}},
    "samples": {"camera__samples_per_pixel": 4},
    "a band": {"sensor": BROAD},
    "thinned": {"camera__pixels": [48, 36], "numerics": {"ray_stride": 4}},
    "a material": {
        "targets__box__material": "concrete",
        "targets__box__reflectivity": None,
        "sensor": {"kind": "passive-spectral", "frequency_ghz": 220.0},
        "ground": {"temperature_k": 285.0, "material": "marble"},
        "camera__polarization_deg": 30.0,
        "numerics": {"bounces": 1},
    },
    "a cover": {
        "targets__box__cover": {"transmission": 0.5, "reflectivity": 0.1, "temperature_k": 296.0}
    },
    "sky": {
        "sky": {"profile": "us-standard"},
        "background__environment": "sky",
        "sensor": {"kind": "passive-spectral", "frequency_ghz": 94.0},
    },
    "optics": {"sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0, "optics": OPTICS}},
    "echoes": {"sensor": ACTIVE | {"spreading": "lambert", "aperture_m": 0.1}},
    "bistatic": {"sensor": ACTIVE | {"arrangement": "bistatic", "transmitter_m": [2.0, 12.0, 5.0]}},
    "warm air": {
        "atmosphere": MOIST
        | {"fluctuations": scene()["atmosphere"]["fluctuations"] | {"temperature_sigma_k": 1.0}}
    },
}


@pytest.mark.parametrize("changes", SAME.values(), ids=SAME)
def test_a_box_as_a_mesh_is_the_box(tmp_path, changes):
    one, other = pair(tmp_path, **changes)
    one, other = (run(tmp_path, data).variants[0].sight for data in (one, other))
    assert np.array_equal(one.target, other.target)
    assert (one.target == 2).sum() > 20
    values = ("contrast", "returned")
    name = next(name for name in values if hasattr(one, name))
    scale = np.abs(getattr(one, name)).max()
    assert np.abs(getattr(one, name) - getattr(other, name)).max() < 2e-6 * scale
    assert one.path_length == pytest.approx(other.path_length, rel=1e-6)


def test_a_subdivided_mesh_is_the_same(tmp_path):
    _, data = pair(tmp_path)
    coarse = run(tmp_path, data)
    vertices, faces = solids.CUBE * scene()["targets"]["box"]["size_m"], solids.BOX_FACES
    for _ in range(4):
        vertices, faces = solids.divided(vertices, faces)
    solids.npz(tmp_path / "box.npz", vertices, faces)
    fine = run(tmp_path, data)
    one, other = coarse.variants[0].sight, fine.variants[0].sight
    assert np.array_equal(one.target, other.target)
    assert one.contrast == pytest.approx(other.contrast, rel=1e-6)


def test_a_mesh_that_turns_with_its_camera_looks_the_same(tmp_path):
    """In uniform air, around the vertical; yaw is as a box's."""
    vertices, faces = solids.sphere(2)
    solids.npz(tmp_path / "egg.npz", vertices * [2.0, 1.0, 1.5], faces)
    found = []
    for degrees in (0.0, 35.0):
        turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        egg = {"kind": "mesh", "file": "egg.npz", "temperature_k": 305.0, "reflectivity": 0.2}
        egg |= {"yaw_deg": 20.0 + degrees, "center_m": (turn @ [25.0, 7.0, 2.0]).tolist()}
        data = scene(
            atmosphere=MOIST,
            targets={"egg": egg},
            camera__position_m=(turn @ [1.0, -2.0, 4.0]).tolist(),
            camera__look_at_m=(turn @ [25.0, 7.0, 2.0]).tolist(),
        )
        found.append(run(tmp_path, data).variants[0].sight)
    one, other = found
    assert np.array_equal(one.target, other.target)
    assert one.contrast == pytest.approx(other.contrast, rel=1e-5)


def test_pitch_raises_what_points_along_x(tmp_path):
    rod = solids.CUBE * [4.0, 0.1, 0.1] + [2.0, 0, 0]
    solids.npz(tmp_path / "rod.npz", rod, solids.BOX_FACES)
    from scenes import write

    from thzcl import pipeline

    mesh = {"kind": "mesh", "file": "rod.npz", "temperature_k": 300.0, "center_m": [20.0, 5.0, 1.0]}
    for extra, top in (
        ({"pitch_deg": 90.0}, [20.05, 5.05, 5.0]),
        ({"yaw_deg": 90.0}, [20.05, 9.0, 1.05]),
        ({"pitch_deg": 90.0, "yaw_deg": 90.0}, [20.05, 5.05, 5.0]),
        ({"up": "y"}, [24.0, 5.05, 1.05]),
        ({"scale": 0.5}, [22.0, 5.025, 1.025]),
    ):
        data = scene(targets={"rod": mesh | extra})
        plan = pipeline.prepare(write(tmp_path, data))
        from thzcl.plan import report

        found = report.as_json(plan)["meshes"][0]
        assert found["high_m"] == pytest.approx(top)


def test_parts_are_targets_of_their_own(tmp_path):
    left, right = (solids.CUBE * 1.5 + [0, y, 0] for y in (-1.0, 1.0))
    text = solids.obj(("left", left, solids.BOX_FACES), ("right", right, solids.BOX_FACES))
    (tmp_path / "two.obj").write_text(text, encoding="utf-8")
    mesh = {
        "kind": "mesh",
        "file": "two.obj",
        "center_m": [25.0, 7.0, 1.0],
        "temperature_k": 300.0,
        "parts": {"right": {"temperature_k": 320.0, "material": "steel"}},
    }
    result = run(tmp_path, scene(targets={"two": mesh}, atmosphere=MOIST))
    assert result.targets == ("background", "ground", "two", "two.right")
    target = result.variants[0].sight.target
    assert (target == 2).sum() > 5 and (target == 3).sum() > 5


@pytest.mark.parametrize("element", ["vertex", "face"])
def test_temperatures_of_vertices_and_faces(tmp_path, element):
    """A plate that is warmer to the one side, against the temperature where each ray meets it."""
    n = 8
    y, z = np.meshgrid(np.linspace(-3, 3, n), np.linspace(-2, 2, n))
    vertices = np.stack([np.zeros(n * n), y.ravel(), z.ravel()], axis=1)
    cell = np.arange(n * (n - 1)).reshape(n - 1, n)[:, :-1].ravel()
    faces = np.concatenate(
        [np.stack([cell, cell + 1, cell + n], 1), np.stack([cell + 1, cell + n + 1, cell + n], 1)]
    )
    kelvin = 300.0 + 4 * vertices[:, 1]
    of_faces = kelvin[faces].mean(axis=1)
    solids.npz(
        tmp_path / "plate.npz", vertices, faces, warmth=kelvin if element == "vertex" else of_faces
    )
    mesh = {"kind": "mesh", "file": "plate.npz", "temperature": "warmth"}
    data = scene(
        atmosphere=MOIST | {"model": "none"},
        camera__position_m=[0.0, 0.0, 4.0],
        camera__look_at_m=[20.0, 0.0, 4.0],
        targets={"plate": mesh | {"center_m": [20.0, 0.0, 4.0]}},
    )
    sight = run(tmp_path, data).variants[0].radiances
    found = 290.0 + sight.brightness_temperature_contrast[0]
    from scenes import lens

    camera = lens(data)
    checked = 0
    for row in range(12):
        for column in range(16):
            d = camera.ray(row, column)
            at = d * 20.0 / d[0]
            if abs(at[1]) > 2.99 or abs(at[2]) > 1.99:
                continue
            expected = 300.0 + 4 * at[1]
            if element == "face":
                assert np.abs(of_faces - found[row, column]).min() < 1e-3
            else:
                assert found[row, column] == pytest.approx(expected, abs=1e-3)
            checked += 1
    assert checked > 50


def test_a_mirror_sees_the_mesh_itself(tmp_path):
    """Two plates at a right angle: the one of metal shows the warm one behind."""
    plate = np.array([[0, -3, 0], [0, 3, 0], [0, 3, 3], [0, -3, 3.0]])
    floor = np.array([[-6, -3, 0], [0, -3, 0], [0, 3, 0], [-6, 3, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    text = solids.obj(("wall", plate, faces), ("floor", floor, faces))
    (tmp_path / "corner.obj").write_text(text, encoding="utf-8")
    mesh = {
        "kind": "mesh",
        "file": "corner.obj",
        "center_m": [26.0, 0.0, 1.0],
        "temperature_k": 400.0,
        "parts": {"floor": {"temperature_k": 290.0, "material": "steel"}},
    }
    data = scene(
        atmosphere=MOIST | {"model": "none"},
        camera__position_m=[0.0, 0.0, 3.0],
        camera__look_at_m=[24.0, 0.0, 1.0],
        camera__focal_length_mm=60.0,
        targets={"corner": mesh},
        ground=None,
    )
    one = run(tmp_path, data).variants[0].radiances
    floor = one.target == 3
    kelvin = 290.0 + one.brightness_temperature_contrast[0]
    assert floor.sum() > 10
    assert (kelvin[floor] > 395).any()
    none = run(tmp_path, data, settings={"numerics.bounces": 0}).variants[0].radiances
    assert np.abs(none.brightness_temperature_contrast[0][floor]).max() < 1


def test_the_budgets_twin_sees_meshes(tmp_path):
    vertices, faces = solids.sphere(2)
    solids.npz(tmp_path / "egg.npz", vertices, faces, warmth=300 + vertices[:, 2])
    egg = {"kind": "mesh", "file": "egg.npz", "temperature": "warmth", "material": "steel"}
    data = scene(targets__egg=egg | {"center_m": [20.0, 3.0, 2.0]}, numerics={"bounces": 1})
    assert run(tmp_path, data).error_budget["arithmetic"]["relative"] < 4e-6


def test_scenes_without_meshes_compile_none(tmp_path):
    result = run(tmp_path, scene())
    assert not any("MESHES" in options for options in result.build_options)
    assert {"stage": "meshes", "reason": "no meshes: no triangle test in the kernel"} in list(
        result.left_out
    )


# --- files


def stl(vertices, faces):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *vertices[f].ravel().tolist(), 0) for f in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + body


def ply(vertices, faces, extra=""):
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {n}" for n in ("x", "y", "z", "temperature_k")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [f"{x} {y} {z} {300 + z}" for x, y, z in vertices]
    rows += ["3 " + " ".join(map(str, f)) for f in faces]
    return "\n".join([*head, *rows, extra])


def glb(vertices, faces):
    import trimesh

    made = trimesh.Trimesh(vertices, faces, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(made, geom_name="hull", node_name="hull")
    return scene.export(file_type="glb")


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb", "npz"])
def test_every_format_holds_the_same_box(tmp_path, kind):
    path = tmp_path / f"box.{kind}"
    if kind == "npz":
        solids.npz(path, solids.CUBE, solids.BOX_FACES)
    elif kind in ("stl", "glb"):
        path.write_bytes({"stl": stl, "glb": glb}[kind](solids.CUBE, solids.BOX_FACES))
    else:
        made = {"obj": lambda *a: solids.obj(("hull", *a)), "ply": ply}[kind]
        path.write_text(made(solids.CUBE, solids.BOX_FACES), encoding="utf-8")
    found = mesh_file.read(path)
    corners = found.vertices[found.faces]
    expected = solids.CUBE[solids.BOX_FACES]
    assert len(corners) == 12

    def key(c):
        return sorted(map(tuple, np.round(np.sort(c, axis=1).reshape(len(c), -1), 6).tolist()))

    assert key(corners) == key(expected)
    assert found.up == ("y" if kind == "glb" else "z")
    if kind in ("obj", "glb"):
        assert found.parts == ("hull",)
    if kind == "ply":
        assert found.attributes["temperature_k"][0] == "vertex"


FACET = b"""facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
"""


def test_what_programs_write_is_read(tmp_path):
    """Groups of an OBJ are its parts where it has no objects; names may be in Latin 1."""
    text = solids.obj(("hull", solids.CUBE, solids.BOX_FACES), ("tür", solids.CUBE, [[0, 1, 2]]))
    (tmp_path / "a.obj").write_text(text.replace("\no ", "\ng ").replace("o h", "g h"), "latin-1")
    found = mesh_file.read(tmp_path / "a.obj")
    assert found.parts == ("hull", "tür")
    assert np.bincount(found.part).tolist() == [12, 1]
    (tmp_path / "a.stl").write_bytes(stl(solids.CUBE, solids.BOX_FACES) + b"made by us")
    assert len(mesh_file.read(tmp_path / "a.stl").faces) == 12


def test_objects_of_an_obj_hold_their_own_vertices_only(tmp_path, monkeypatch):
    """Files of hundreds of objects would else take hundreds of times their size."""
    pieces = [(f"part{n}", solids.CUBE + n, solids.BOX_FACES) for n in range(20)]
    (tmp_path / "many.obj").write_text(solids.obj(*pieces), encoding="utf-8")
    seen = []
    monkeypatch.setattr(mesh_file, "_refuse_broken", lambda *given: seen.append(given[1]))
    assert mesh_file.read(tmp_path / "many.obj").parts == tuple(name for name, _, _ in pieces)
    assert [len(piece.vertices) for piece in seen] == 20 * [8]


BAD = {
    "empty.obj": (b"", "holds no triangles"),
    "empty.stl": (b"", ""),
    "empty.ply": (b"", ""),
    "empty.glb": (b"", "no GLB file"),
    "noise.stl": (b"\x01" * 200, ""),
    "noise.ply": (b"ply\n" + bytes(range(256)), ""),
    "noise.glb": (b"glTF" + bytes(100), "no GLB file"),
    "noise.npz": (b"PK" + bytes(100), "no NPZ file"),
    "noise.obj": (bytes(range(256)) * 3, "holds no triangles"),
    "far.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
    "nan.obj": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    "huge.obj": (b"v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n", "beyond 1e+09"),
    "flat.obj": (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle has an area"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\n", "holds no triangles"),
    "many.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n",
        "it is cut off or broken",
    ),
    "points.ply": (ply(solids.CUBE, []).encode(), "holds no triangles"),
    "cut.ply": (ply(solids.CUBE, solids.BOX_FACES)[:-20].encode(), "but holds 18: it is cut off"),
    "cut.stl": (stl(solids.CUBE, solids.BOX_FACES)[:-70], "says 12 triangles but holds 10"),
    "solid.stl": (b"solid a\n" + FACET + b"endsolid a\nsolid b\n" + FACET, "2 triangles begin, 1"),
    "mesh.step": (b"", "no mesh by its name"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_message(tmp_path, name):
    data, words = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FileError) as refused:
        mesh_file.read(tmp_path / name)
    assert words in str(refused.value) and name in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_glb_that_promises_too_much_is_refused(tmp_path):
    data = glb(solids.CUBE, solids.BOX_FACES)
    size = int.from_bytes(data[12:16], "little")
    told = json.loads(data[20 : 20 + size])
    told["accessors"][0]["count"] = 10**12
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    made = data[:12] + struct.pack("<I", len(text)) + b"JSON" + text + data[20 + size :]
    (tmp_path / "big.glb").write_bytes(made)
    with pytest.raises(FileError, match="cannot hold"):
        mesh_file.read(tmp_path / "big.glb")


def test_without_trimesh_the_remedy_is_named(tmp_path, monkeypatch):
    (tmp_path / "box.stl").write_bytes(stl(solids.CUBE, solids.BOX_FACES))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(FileError, match=r"pip install 'thzcl\[mesh\]'"):
        mesh_file.read(tmp_path / "box.stl")


def test_triangles_without_an_area_are_left_out_and_told(tmp_path):
    faces = np.vstack([solids.BOX_FACES, [[0, 0, 1], [2, 2, 2]]])
    solids.npz(tmp_path / "box.npz", solids.CUBE * 2, faces)
    mesh = {"kind": "mesh", "file": "box.npz", "temperature_k": 300.0}
    result = run(tmp_path, scene(targets={"it": mesh | {"center_m": [20.0, 3.0, 1.0]}}))
    assert "it: 2 triangles without an area left out of box.npz" in result.warnings


def test_values_of_faces_that_are_no_triangles_are_refused(tmp_path):
    """A square of a PLY becomes two triangles, of which its value is none."""
    text = ply(solids.CUBE, [[0, 1, 2, 3]]).replace("end_header", "property float heat\nend_header")
    (tmp_path / "a.ply").write_text(text.replace("3 0 1 2 3", "4 0 1 2 3 300"), encoding="utf-8")
    mesh = {"kind": "mesh", "file": "a.ply", "temperature": "heat", "center_m": [20.0, 3.0, 1.0]}
    with pytest.raises(ScenarioError, match="heat: 1 values for 2 triangles; split all faces"):
        run(tmp_path, scene(targets={"it": mesh}))


WRONG = {
    "part": ({"parts": {"rihgt": {}}}, "did you mean right?"),
    "attribute": ({"temperature": "heat", "temperature_k": None}, "no attribute heat"),
    "both": ({"temperature": "heat"}, "give only one of temperature_k or temperature"),
    "none": ({"temperature_k": None}, "missing; a passive sensor sees"),
    "material": ({"material": "stele"}, "did you mean steel?"),
    "material of a part": ({"parts": {"right": {"material": "stele"}}}, "did you mean steel?"),
    "scale": ({"scale": 0.0}, "must be above 0"),
    "too large": ({"scale": 1e9, "center_m": [9e8, 0.0, 0.0]}, "lower scale"),
}


@pytest.mark.parametrize(("changes", "words"), WRONG.values(), ids=WRONG)
def test_wrong_keys_are_refused_in_one_message(tmp_path, changes, words):
    text = solids.obj(
        ("left", solids.CUBE, solids.BOX_FACES), ("right", solids.CUBE + 2, solids.BOX_FACES)
    )
    (tmp_path / "two.obj").write_text(text, encoding="utf-8")
    mesh = {"kind": "mesh", "file": "two.obj", "center_m": [25.0, 7.0, 1.0], "temperature_k": 300.0}
    mesh = {k: v for k, v in (mesh | changes).items() if v is not None}
    with pytest.raises(ScenarioError) as refused:
        run(tmp_path, scene(targets={"two": mesh}))
    assert len(refused.value.problems) == 1
    assert words in refused.value.problems[0]


def test_a_part_that_is_not_shown_is_not_there(tmp_path):
    """What stands behind it is."""
    front, behind = solids.CUBE * [0.5, 2, 2] - [2, 0, 0], solids.CUBE * [0.5, 2, 2]
    text = solids.obj(("front", front, solids.BOX_FACES), ("behind", behind, solids.BOX_FACES))
    (tmp_path / "two.obj").write_text(text, encoding="utf-8")
    mesh = {"kind": "mesh", "file": "two.obj", "center_m": [25.0, 7.0, 1.0], "temperature_k": 300.0}
    shown = []
    for there in (True, False):
        parts = {"front": {"shown": there}, "behind": {}}
        result = run(tmp_path, scene(targets={"two": mesh | {"parts": parts}}, atmosphere=MOIST))
        shown.append((result.variants[0].sight.target == result.targets.index("two.front")).sum())
        assert (result.variants[0].sight.target == result.targets.index("two.behind")).any()
    assert shown[0] > 10 and shown[1] == 0
