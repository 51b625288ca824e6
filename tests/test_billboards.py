"""Billboards: pictures where they belong, the right way round, and none but sound ones."""

from __future__ import annotations

import os
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import oracle
import pytest
from conftest import ROOT
from PIL import Image
from scenes import run, scene, write
from test_files import in_time

from thzcl import pipeline
from thzcl.errors import FileError, ScenarioError
from thzcl.scenario.scene import Billboard
from thzcl.surfaces import texture

BOARD = {
    "kind": "billboard", "center_m": [20.0, 0.0, 5.0], "size_m": [4.0, 3.0], "facing_deg": 180.0,
    "image": "board.png", "quantity": "temperature", "range": [280.0, 320.0],
}  # fmt: skip
AHEAD = {
    "camera__position_m": [0.0, 0.0, 5.0], "camera__look_at_m": [20.0, 0.0, 5.0],
    "camera__focal_length_mm": 100.0, "camera__focal_plane_mm": [20.0, 15.0],
    "camera__pixels": [40, 30], "ground": None, "atmosphere__fluctuations": None,
    "atmosphere__model": "none",
}  # fmt: skip


def save(folder, values, name="board.png", bits=8):
    """Saves values from 0 to 1 as a greyscale picture."""
    kind = np.uint8 if bits == 8 else np.uint16
    Image.fromarray(np.rint(values * (2**bits - 1)).astype(kind)).save(folder / name)


@pytest.fixture
def ramp(tmp_path):
    """Saves board.png, dark at the top left, brighter to the right and, less, downwards."""
    y, x = np.mgrid[0:30, 0:40]
    values = (3 * x + y) / 150
    save(tmp_path, values)
    return values


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_a_picture_is_seen_as_it_is(tmp_path, ramp, bits, interpolation):
    """The board fills the frame, one texel to a pixel: row 0 at the top, column 0 at the left."""
    save(tmp_path, ramp, bits=bits)
    data = scene(**AHEAD, targets={"board": BOARD | {"interpolation": interpolation}})
    kelvin = run(tmp_path, data).variants[0].radiances.brightness_temperature[0]
    assert kelvin == pytest.approx(280 + 40 * ramp, abs=0.1 if bits == 8 else 0.002)


def test_from_behind_it_is_mirrored(tmp_path, ramp):
    ahead = AHEAD | {"camera__position_m": [40.0, 0.0, 5.0]}
    kelvin = (
        run(tmp_path, scene(**ahead, targets={"board": BOARD}))
        .variants[0]
        .radiances.brightness_temperature[0]
    )
    assert kelvin == pytest.approx(280 + 40 * ramp[:, ::-1], abs=0.1)


@pytest.mark.parametrize("facing", [150.0, 180.0, 215.0, 20.0])
def test_geometry_and_bilinear_values_against_the_oracle(tmp_path, ramp, facing):
    np.save(tmp_path / "board.npy", 280 + 40 * ramp)
    board = {k: v for k, v in BOARD.items() if k != "range"} | {
        "image": "board.npy",
        "facing_deg": facing,
        "center_m": [20.0, 1.0, 4.5],
    }
    data = scene(**AHEAD, targets={"board": board}, numerics={"precision": "float64"})
    sight = run(tmp_path, data).variants[0].radiances
    lens = oracle.Camera(
        *(
            data["camera"][k]
            for k in ("position_m", "look_at_m", "focal_length_mm", "focal_plane_mm", "pixels")
        )
    )
    turn = np.deg2rad(facing)
    normal, right = (
        np.array([np.cos(turn), np.sin(turn), 0]),
        np.array([-np.sin(turn), np.cos(turn), 0]),
    )
    hits = 0
    for row, column in np.ndindex(30, 40):
        direction = lens.ray(row, column)
        t = normal @ (np.array(board["center_m"]) - [0, 0, 5.0]) / (normal @ direction)
        point = np.array([0, 0, 5.0]) + t * direction - board["center_m"]
        u, v = 0.5 + point @ right / 4.0, 0.5 - point[2] / 3.0
        inside = t > 0 and 0 <= u < 1 and 0 <= v < 1
        assert (sight.target[row, column] == 2) == inside
        if inside:
            x, y = np.clip(u * 40 - 0.5, 0, 39), np.clip(v * 30 - 0.5, 0, 29)
            x0, y0 = min(int(x), 38), min(int(y), 28)
            corner = 280 + 40 * ramp[y0 : y0 + 2, x0 : x0 + 2]
            expected = np.array([1 - y + y0, y - y0]) @ corner @ np.array([1 - x + x0, x - x0])
            assert sight.brightness_temperature[0, row, column] == pytest.approx(expected, abs=2e-4)
            hits += 1
    assert hits > 200


@pytest.mark.usefixtures("ramp")
def test_one_sees_past_the_dark_parts_of_a_mask(tmp_path):
    mask = np.zeros((30, 40))
    mask[:, 20:] = 1
    save(tmp_path, mask, "mask.png")
    wall = {
        "kind": "box",
        "center_m": [30.0, 0.0, 5.0],
        "size_m": [1.0, 50.0, 50.0],
        "temperature_k": 250.0,
    }
    data = scene(**AHEAD, targets={"board": BOARD | {"mask": "mask.png"}, "wall": wall})
    sight = run(tmp_path, data).variants[0].radiances
    assert np.all(sight.target[:, :20] == 3) and np.all(sight.target[:, 20:] == 2)
    assert sight.brightness_temperature[0][:, :20] == pytest.approx(250.0, abs=0.01)


def test_reflectivity_maps(tmp_path, ramp):
    """Passive: (1 - R) B(T) + R B_environment, R from the map; active: the echo is the map."""
    board = BOARD | {"quantity": "reflectivity", "range": [0.0, 0.5], "temperature_k": 310.0}
    sight = (
        run(tmp_path, scene(**AHEAD, targets={"board": board}, background__environment=100.0))
        .variants[0]
        .radiances
    )
    r = np.rint(ramp * 255) / 255 * 0.5
    expected = (1 - r) * oracle.planck(650e9, 310.0) + r * oracle.planck(650e9, 100.0)
    assert sight.radiance[0] == pytest.approx(expected, rel=1e-5)
    active = run(
        tmp_path,
        scene(
            **AHEAD,
            targets={"board": board},
            sensor={"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 90.0},
        ),
    )
    assert active.variants[0].image.layers["received_power"].values == pytest.approx(
        1e-3 * r, abs=1e-9
    )


@pytest.mark.usefixtures("ramp")
def test_a_board_lit_from_behind_stays_dark(tmp_path):
    board = BOARD | {"quantity": "reflectivity", "range": [0.2, 0.5]}
    sensor = {
        "kind": "active",
        "frequency_ghz": 650.0,
        "dynamic_range_db": 90.0,
        "arrangement": "bistatic",
    }
    for place, lit in (([0.0, 3.0, 5.0], True), ([40.0, 3.0, 5.0], False)):
        data = scene(**AHEAD, targets={"board": board}, sensor=sensor | {"transmitter_m": place})
        power = run(tmp_path, data).variants[0].image.layers["received_power"].values
        assert (power > 0).all() == lit and (power > 0).any() == lit


@pytest.mark.usefixtures("ramp")
def test_paths_stay_inside_the_scenarios_folder(tmp_path, thzcl_command):
    inner = tmp_path / "scenes"
    inner.mkdir()
    data = scene(**AHEAD, targets={"board": BOARD | {"image": "../board.png"}})
    file = write(inner, data)
    done = thzcl_command("check", file)
    assert done.returncode == 2
    assert (
        "../board.png: leads out of the scenario's folder; move it there, or pass --allow-outside"
        in done.stderr
    )
    assert thzcl_command("check", file, "--allow-outside").returncode == 0
    (inner / "link.png").symlink_to(tmp_path / "board.png")
    assert (
        "leads out"
        in thzcl_command(
            "check", write(inner, scene(**AHEAD, targets={"board": BOARD | {"image": "link.png"}}))
        ).stderr
    )


def bomb(path, side):
    """Writes a tiny PNG that says it is enormous."""

    def chunk(name, data):
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 1000))
        + chunk(b"IEND", b"")
    )


def truncated(folder):
    save(folder, np.random.default_rng(1).random((99, 99)))
    file = folder / "board.png"
    file.write_bytes(file.read_bytes()[:3000])


def animated(folder):
    first, second = Image.new("L", (9, 9)), Image.new("L", (9, 9), 9)
    first.save(folder / "board.png", save_all=True, append_images=[second])


def flat(folder, name="board.png", shape=(4, 4)):
    save(folder, np.zeros(shape), name)


def array(values):
    return lambda folder: np.save(folder / "a.npy", values)


def flat_array(value):
    return lambda folder: np.save(folder / "a.npy", np.full((8, 8), value))


def deep(folder, values):
    Image.fromarray(np.array(values, dtype=np.int32)).save(folder / "deep.tif")


def archive(folder):
    np.savez(folder / "a.npz", np.ones((3, 3)))
    (folder / "a.npz").rename(folder / "a.npy")


def damaged_head(folder):
    head = ("[" * 110).ljust(117).encode() + b"\n"
    (folder / "a.npy").write_bytes(
        b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(512)
    )


def enormous_head(folder):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000, 10000000)}".ljust(117)
    (folder / "a.npy").write_bytes(
        b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + head + b"\n" + bytes(512)
    )


NPY = {"image": "a.npy", "range": None}
REFLECTIVITY = NPY | {"quantity": "reflectivity", "temperature_k": 300.0}
BAD = {
    "missing": (
        lambda folder: folder,
        {},
        "cannot be read: No such file or directory; paths start from the scenario's folder",
    ),
    "folder": (lambda f: (f / "board.png").mkdir(), {}, "a folder, not a regular file; give a PNG"),
    "pipe": (lambda f: os.mkfifo(f / "board.png"), {}, "a pipe, not a regular file; give a PNG"),
    "pipe as a mask": (
        lambda f: (flat(f), os.mkfifo(f / "m.npy")),
        {"mask": "m.npy"},
        "a pipe, not a regular file",
    ),
    "link to itself": (lambda f: (f / "board.png").symlink_to("board.png"), {}, "mend the link"),
    "huge": (
        lambda f: (f / "board.png").write_bytes(b"\0" * 65_000_000),
        {},
        "65 MB, larger than 64 MB; give less",
    ),
    "truncated": (truncated, {}, "not a sound PNG or TIFF"),
    "no picture": (lambda f: (f / "board.png").write_text("hello"), {}, "not a sound PNG or TIFF"),
    "a JPEG": (
        lambda f: Image.new("L", (9, 9)).save(f / "board.png", format="JPEG"),
        {},
        "not a sound PNG or TIFF",
    ),
    "animated": (animated, {}, "holds 2 pictures"),
    "bomb": (lambda f: bomb(f / "board.png", 5000), {}, "textures may have 16 million"),
    "greater bomb": (
        lambda f: bomb(f / "board.png", 50000),
        {},
        "textures may have 16 million|not a sound PNG",
    ),
    "floats": (
        lambda f: Image.new("F", (4, 4)).save(f / "board.tiff"),
        {"image": "board.tiff"},
        "pixels of kind F",
    ),
    "no range": (flat, {"range": None}, "needs range"),
    "range below 0": (flat, {"range": [-1.0, 300.0]}, "range: must lie between 0"),
    "mask of another size": (
        lambda f: (flat(f), flat(f, "m.png", (5, 4))),
        {"mask": "m.png"},
        "make them equal",
    ),
    "array with range": (array(np.zeros((4, 4))), {"image": "a.npy"}, "remove range"),
    "array of NaN": (
        array(np.full((4, 4), np.nan)),
        {"image": "a.npy", "range": None},
        "not finite",
    ),
    "array of three": (
        array(np.zeros((4, 4, 3))),
        {"image": "a.npy", "range": None},
        "must be a plane of numbers",
    ),
    "array of objects": (
        array(np.array([[{}]])),
        {"image": "a.npy", "range": None},
        "not a sound .npy",
    ),
    "array of another kind": (
        array(np.zeros((4, 4), [("a", "f4")])),
        NPY,
        "must be a plane of numbers",
    ),
    "archive named array": (archive, NPY, "save one array with numpy.save"),
    "array with a damaged head": (damaged_head, NPY, "not a sound .npy array"),
    "array of an enormous head": (enormous_head, NPY, "not a sound .npy array"),
    "empty array": (lambda f: (f / "a.npy").write_bytes(b""), NPY, "not a sound .npy array"),
    "-5 K": (flat_array(-5.0), NPY, "-5 K; it must lie between 0 and 1e[+]19 K"),
    "1e308 K": (flat_array(1e308), NPY, "1e[+]308 K; it must lie between 0 and 1e[+]19 K"),
    "reflectivity of -5": (flat_array(-5.0), REFLECTIVITY, "-5; it must lie between 0 and 1"),
    "reflectivity of 250": (flat_array(250), REFLECTIVITY, "250; it must lie between 0 and 1"),
    "32 bit": (
        lambda f: deep(f, np.arange(64).reshape(8, 8) * 10**8 // 3),
        {"image": "deep.tif"},
        "pixels of 0 to 2100000000.*; give 16 bit greyscale",
    ),
    "negative pixels": (
        lambda f: deep(f, [[-1, 0], [1, 2]]),
        {"image": "deep.tif"},
        "pixels of -1 to 2",
    ),
    "32 bit as a mask": (
        lambda f: (save(f, np.zeros((8, 8))), deep(f, np.full((8, 8), 10**8))),
        {"mask": "deep.tif"},
        "pixels of 100000000 to 100000000",
    ),
    "two temperatures": (flat, {"temperature_k": 300.0}, "is given by the image"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_picture_that_cannot_be_trusted_is_refused(tmp_path, case):
    make, changes, expected = BAD[case]
    make(tmp_path)
    board = {k: v for k, v in (BOARD | changes).items() if v is not None}
    with in_time(30), pytest.raises(ScenarioError, match=expected):
        pipeline.prepare(write(tmp_path, scene(**AHEAD, targets={"board": board})))


def test_pictures_are_held_to_the_limits_of_the_keys():
    """What an array may hold is what the keys temperature_k and reflectivity may say."""
    properties = Billboard.model_json_schema()["properties"]
    for quantity, key in (("temperature", "temperature_k"), ("reflectivity", "reflectivity")):
        number = properties[key].get("anyOf", [properties[key]])[0]
        assert texture.QUANTITIES[quantity][:2] == (number["minimum"], number["maximum"])


def test_ends_beyond_the_limits_are_refused_as_values_are(tmp_path):
    flat(tmp_path)
    with pytest.raises(FileError, match=r"a reflectivity of 1\.5; it must lie between 0 and 1"):
        texture.read(tmp_path / "board.png", (0.0, 1.5), "reflectivity")


def test_16_bits_in_a_tiff_of_32_are_read(tmp_path):
    deep(tmp_path, [[0, 13107], [65535, 1]])
    found = texture.read(tmp_path / "deep.tif", (200.0, 300.0), "temperature")
    assert found.values == pytest.approx(np.array([[0, 0.2], [1, 1 / 65535]]))


def test_a_picture_that_changed_is_read_again(tmp_path):
    for value in (280.0, 290.0):
        np.save(tmp_path / "a.npy", np.full((4, 4), value))
        os.utime(tmp_path / "a.npy", ns=(0, 0))  # as tools that copy times do
        assert texture.read(tmp_path / "a.npy", None, "temperature").low == value


def test_a_relative_path_is_that_of_the_folder_one_is_in(tmp_path, monkeypatch):
    for value in (280.0, 290.0):
        folder = tmp_path / f"{value}"
        folder.mkdir()
        np.save(folder / "a.npy", np.full((4, 4), value))
        os.utime(folder / "a.npy", ns=(0, 0))
        monkeypatch.chdir(folder)
        assert texture.read(Path("a.npy"), None, "temperature").low == value


def test_the_phantom_is_what_its_script_draws(tmp_path):
    sys.path.insert(0, str(ROOT))
    from scenarios import phantom

    phantom.write(tmp_path)
    for name in ("reflectivity", "temperature", "mask"):
        file = f"phantom_{name}.png"
        drawn, shipped = (
            texture.read(folder / file, (0.0, 1.0), "reflectivity").values
            for folder in (tmp_path, ROOT / "scenarios")
        )
        assert np.array_equal(drawn, shipped)
    reflectivity, temperature, mask = phantom.phantom()
    assert reflectivity[mask > 0].max() > 3 * np.median(
        reflectivity[mask > 0]
    )  # metal under the cloth
    assert temperature[mask > 0].min() > 290
