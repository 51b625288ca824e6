"""Damaged files and odd settings, which commands must refuse in words or use: nothing else.

`python tests/fuzz_files.py KIND SEED COUNT` tries as many of a kind. A file is a
sound one, some of whose bytes, numbers or parts have been changed, cut out, doubled or swapped.
"""

from __future__ import annotations

import contextlib
import io
import random
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
from PIL import Image
from scenes import scene, write

import thzcl
from thzcl.__main__ import main

CONTRACT = {0, 2, 3, 4}
LONGEST_S = 60.0
CHECKED = {0: "done", 2: "refused", 3: "no device", 4: "numbers"}
WORDS = (
    *(b"nan", b"inf", b"-1", b"1e400", b"0", b"", b"9" * 400, b"\xff\xfe", b"\x00", b"1e-320"),
    *("²".encode(), b",", b";", b"\n\n", b'"', b"[" * 3000, b"{}", b"null", b"-0.0", b"1_0"),
)
SETTINGS = ("camera.pixels", "atmosphere.temperature_k", "targets.box.kind", "sensor",
            "sky.profile",
            "atmosphere.fluctuations.file", "numerics.precision", "a.b.c", "", ".", "variants",
            "output.limits", "study.over", "sequence.frames", "targets.box", "ground")  # fmt: skip
VALUES = ("[12,10]", "nan", "-inf", "1e999", "{}", "[[]]", "'a", '"é', "²", "0x", "1e5", "[1,2",
          "true", "\x00", "9" * 5000, "[" * 500, "", "=", "1979-05-27", "12:00:00", "{a={b=1}}",
          "'mpm93'", "[nan,nan]", "-0", "[1e300,0,0]", "'box'", "'../../x'")  # fmt: skip

Corpus = dict[str, bytes]


def _image(form: str) -> bytes:
    file = io.BytesIO()
    shades = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
    Image.fromarray(shades).save(file, format=form)
    return file.getvalue()


def _array() -> bytes:
    file = io.BytesIO()
    np.save(file, np.linspace(290, 300, 48).reshape(6, 8))
    return file.getvalue()


def _solid() -> bytes:
    file = io.BytesIO()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    np.savez(file, vertices=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    return file.getvalue()


def _cube() -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as opened:
        values = np.random.default_rng(1).normal(12, 1, (8, 8, 8))
        opened["absolute_humidity"] = values
        opened["absolute_humidity"].attrs.update({"units": "g m-3", "voxel_m": 0.7})
    return file.getvalue()


def _record() -> bytes:
    rng = np.random.default_rng(2)
    rows = [
        f"{n / 10:.1f},{10 + rng.normal():.3f},{3 + rng.normal():.3f},{rng.normal():.3f}"
        for n in range(1200)
    ]
    return "\n".join(["time,h2o_g_m3,Ux_m_s,Uy_m_s", *rows]).encode()


def _table(head: str, rows: list[tuple[float, ...]]) -> bytes:
    return "\n".join([head, *(",".join(map(str, row)) for row in rows)]).encode()


MESH = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
LEVELS = [(h, 290 - 0.0065 * h, 1013 * np.exp(-h / 8000), 10 * np.exp(-h / 2000))
          for h in (0.0, 500.0, 2000.0, 9000.0, 18000.0, 27000.0)]  # fmt: skip
LAYERS = [(0.0, 290.0, 9.0), (20.0, 289.0, 8.0), (200.0, 287.0, 7.0)]
RESPONSE = [(600.0, 0.1), (650.0, 1.0), (700.0, 0.1)]
SPECTRUM = [(0.01, 1.0), (0.1, 0.5), (1.0, 0.02), (10.0, 5e-4)]


def _result(folder: Path) -> bytes:
    small = scene(camera__pixels=[6, 5], atmosphere__fluctuations__grid=16)
    made = thzcl.run(write(folder, small))
    return made.save(folder / "made.nc").read_bytes()


def kinds(folder: Path) -> dict[str, Callable[[], tuple[Corpus, list[list[str]]]]]:
    """Returns, by kind, what makes sound files by name, and the commands that read one (FILE)."""
    scenario = str(folder / "scene.toml")

    def checked(*settings: str) -> list[list[str]]:
        return [
            [name, scenario, *(part for one in settings for part in ("--set", one))]
            for name in ("check", "plan")
        ]

    board = (
        "targets.b={kind='billboard',center_m=[20,5,1],size_m=[1,1],facing_deg=180,image='FILE',"
        "quantity='temperature',reflectivity=0.1,%s}"
    )
    shades = "range=[290,310]"
    mesh = (
        "targets.m={kind='mesh',file='FILE',center_m=[20,5,1],temperature_k=300,reflectivity=0.1}"
    )
    air = "atmosphere.fluctuations={spectrum='%s',file='FILE'%s}"
    spectrum = ",voxel_m=0.7,grid=16,sigma_percent=10"
    broad = "sensor={kind='passive-broadband',response='FILE'}"
    return {
        "pictures": lambda: (
            {"a.png": _image("PNG"), "a.tif": _image("TIFF")},
            checked(board % shades),
        ),
        "arrays": lambda: ({"a.npy": _array()}, checked(board.replace(",%s", ""))),
        "cubes": lambda: ({"c.nc": _cube()}, checked(air % ("file", ""))),
        "meshes": lambda: ({"m.obj": MESH, "m.npz": _solid()}, checked(mesh)),
        "tables": lambda: (
            {"t.csv": _table("wavenumber,density", SPECTRUM)},
            checked(air % ("table", spectrum)),
        ),
        "responses": lambda: ({"r.csv": _table("ghz,response", RESPONSE)}, checked(broad)),
        "skies": lambda: (
            {"s.csv": _table("height_m,temperature_k,pressure_hpa,absolute_humidity_g_m3",
                             LEVELS)},
            checked("sky={profile='file',file='FILE'}", "background.environment='sky'"),
        ),
        "profiles": lambda: (
            {"p.csv": _table("height_m,temperature_k,absolute_humidity_g_m3", LAYERS)},
            checked("atmosphere={profile={file='FILE'}}"),
        ),
        "records": lambda: ({"r.csv": _record()}, [["fluctuations", "FILE"]]),
        "results": lambda: (
            {"r.nc": _result(folder)},
            [["report", "FILE", "-o", str(folder / "page.html")], ["check", "FILE"]],
        ),
    }  # fmt: skip


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Returns a file with one to four changes."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        place = rng.randrange(len(found) + 1)
        other = min(len(found), place + rng.choice((1, 2, 8, 64, 512)))
        way = rng.randrange(7)
        if way == 0 and place < len(found):
            found[place] ^= 1 << rng.randrange(8)
        elif way == 1:
            del found[place:other]
        elif way == 2:
            found[place:place] = found[place:other] * rng.choice((1, 2, 50))
        elif way == 3:
            found[place:other] = rng.choice(WORDS)
        elif way == 4:
            found[place:other] = bytes(rng.randrange(256) for _ in range(other - place))
        elif way == 5:
            found[place:other] = b"\x00" * (other - place)
        elif rng.random() < 0.2:
            del found[place:]
    return bytes(found)


def rewritten(data: bytes, rng: random.Random) -> bytes:
    """Returns a NetCDF-4 file with one variable or attribute changed."""
    file = io.BytesIO(data)
    with h5py.File(file, "r+") as opened:
        holders = [opened, *(one for one in opened.values() if isinstance(one, h5py.Dataset))]
        holder = rng.choice(holders)
        odd = rng.choice(("x", "", "{}", "[1]", "nan", -1.0, np.nan, np.inf, 0, [1.0, 2.0], 10**9))
        if rng.random() < 0.5 or holder is opened:
            names = list(holder.attrs) or ["units"]
            holder.attrs[rng.choice(names)] = odd
        else:
            name = holder.name
            values = holder[...]
            attrs = dict(holder.attrs) if name == "/absolute_humidity" else {}
            del opened[name]
            if values.dtype.kind in "fiu" and rng.random() < 0.8:
                flat = np.array(values).reshape(-1)
                with np.errstate(all="ignore"):
                    flat[rng.randrange(flat.size)] = (
                        rng.choice((0, -1, 1e30, np.nan, np.inf))
                        if flat.dtype.kind == "f"
                        else rng.choice((0, 1, 100))
                    )
                shapes = (values.shape, flat.shape, (*values.shape, 1), values.shape[::-1])
                opened[name] = flat.reshape(rng.choice(shapes))
                opened[name].attrs.update(attrs)
            elif rng.random() < 0.5:
                opened[name] = "text"
    return file.getvalue()


def cases(kind: str, folder: Path, rng: random.Random) -> Iterator[list[str]]:
    """Yields command lines without end; the file of each is written before."""
    write(folder, scene(camera__pixels=[6, 5], atmosphere__fluctuations__grid=16))
    if kind == "settings":
        while True:
            settings = [
                rng.choice((f"{rng.choice(SETTINGS)}={rng.choice(VALUES)}", rng.choice(VALUES)))
                for _ in range(rng.choice((1, 1, 2)))
            ]
            parts = [part for one in settings for part in ("--set", one)]
            yield ["check", str(folder / "scene.toml"), *parts]
    files, commands = kinds(folder)[kind]()
    while True:
        name = rng.choice(sorted(files))
        hdf5 = name.endswith(".nc") and rng.random() < 0.7
        data = rewritten(files[name], rng) if hdf5 else damaged(files[name], rng)
        (folder / name).write_bytes(data)
        whole = str(folder / name)
        for command in commands:
            own = command[0] in ("report", "fluctuations") or command[1] == "FILE"
            yield [part.replace("FILE", whole if own else name) for part in command]


def search(
    kind: str, seed: int, count: int, keep: Path | None = None
) -> tuple[Counter[str], list[str]]:
    """Returns how many of `count` commands ended how, and what broke.

    Files on which a command broke are stored in the folder `keep`.
    """
    ends: Counter[str] = Counter()
    broken: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        lines = cases(kind, folder, random.Random(seed))  # noqa: S311 (no secret)
        for number, command in zip(range(count), lines, strict=False):
            start, told = time.monotonic(), io.StringIO()
            try:
                with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(told):
                    code = main(command)
            except BaseException:  # noqa: BLE001 (what is looked for)
                code = -1
                told.write(traceback.format_exc())
            text, took = told.getvalue(), time.monotonic() - start
            wrong = code not in CONTRACT or "Traceback" in text or "a bug in thzcl" in text
            silent = code != 0 and not text.strip()
            if wrong or silent or took > LONGEST_S:
                broken.append(
                    f"--- {kind} {number}: {command}: {code}, {took:.0f} s\n{text[-900:]}"
                )
                if keep is not None:
                    for path in folder.glob("*.*"):
                        (keep / f"{kind}-{number}-{path.name}").write_bytes(path.read_bytes())
            ends[CHECKED.get(code, "broken")] += 1
    return ends, broken


KINDS = ("settings", *kinds(Path()))


if __name__ == "__main__":
    import sys

    many, mistakes = search(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
    print("\n".join(mistakes))
    print(dict(many), f"{len(mistakes)} broken")
    sys.exit(bool(mistakes))
