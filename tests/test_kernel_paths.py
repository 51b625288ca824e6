"""How kernels go through the cube, and which rays they follow, function by function.

Expectations are plain geometry in float64, or the oracle's list of crossings.
"""

from __future__ import annotations

import re

import numpy as np
import oracle
import pytest
from conftest import ROOT
from kernel_functions import PACKETS, Setting, evaluate

packets = pytest.mark.parametrize("setting", PACKETS, ids=str)
MARCH = ["surfaces/camera", "paths/march"]


# --- through the cube

N, LOG2N = 8, 3
TO_MARCH = """
    axis axes[3];
    for (int k = 0; k < 3; ++k) {
        wide o[LANES], d[LANES];
        for (int lane = 0; lane < LANES; ++lane) {
            o[lane] = origin[3 * (first + lane) + k];
            d[lane] = direction[3 * (first + lane) + k];
        }
        axes[k] = axis_start(o, d, o, 3 * k, 3);
    }
    march ray = {axes[0], axes[1], axes[2], 0, LOAD(end + first), 1};
    for (int step = 0; step < shape[0]; ++step) {
        const reals there = march_exit(&ray);
        STORE(march_voxel(&ray), voxel + step * shape[1] + first);
        march_cross(&ray, there);
        STORE(ray.here, here + step * shape[1] + first);
    }
"""


def marched(device, setting, origin, direction, end, steps):
    """Voxel numbers, and the ray parameters where rays leave them, both (step, ray)."""
    rays = len(origin)
    voxel, here = np.zeros((steps, rays), setting.whole), np.zeros((steps, rays), setting.precision)
    arrays = {"origin": origin.astype(float), "direction": direction.astype(float)}
    arrays |= {"end": end.astype(setting.precision), "voxel": voxel, "here": here}
    arrays |= {"shape": np.array(voxel.shape, np.int32)}
    evaluate(device, MARCH, TO_MARCH, arrays, rays, setting)
    return voxel, here


def awkward():
    """Origins and directions of rays along axes, in faces, and from corners, both ways."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    diagonals = np.array([[1, 1, 0], [-1, 1, 0], [0, -1, -1], [1, 1, 1], [-1, -1, -1], [-1, 1, -1]])
    inside, in_face, in_edge, corner = (2.3, 5.6, 7.1), (2.0, 5.6, 0.0), (3.0, 0.0, 7.5), (0, 4, 7)
    return (
        np.repeat([inside, in_face, in_edge, corner], 12, axis=0),
        np.tile(np.vstack([axes, diagonals]), (4, 1)).astype(float),
    )


@packets
def test_rays_cross_the_voxels_of_a_sorted_list_of_crossings(device, setting):
    """In order, each over its own length; slivers no longer than rounding are left out."""
    rng = np.random.default_rng(7)
    origins, towards = awkward()
    origin = np.vstack([origins, rng.uniform(0, N, (80, 3))])
    direction = np.vstack([towards, rng.normal(size=(80, 3))])
    end = rng.uniform(20, 30, 128).astype(setting.precision)
    voxel, here = marched(device, setting, origin, direction, end, 250)
    assert np.array_equal(here[-1], end)
    sliver = 200 * setting.eps
    for ray in range(128):
        cells, lengths = oracle.segments(origin[ray], direction[ray], float(end[ray]), N)
        long = lengths > sliver
        own = np.diff(here[:, ray].astype(float), prepend=0)
        crossed = own > sliver
        assert np.array_equal(voxel[crossed, ray], cells[long] @ [1, N, N * N])
        assert own[crossed] == pytest.approx(lengths[long], abs=sliver)


@packets
def test_crossings_do_not_drift(device, setting):
    """After 2000 voxels a crossing lies where it should to one rounding of step, first and sum."""
    slopes = np.random.default_rng(8).uniform(0.7, 1.4, 16)
    origin, direction = np.tile([0.3, 4.5, 4.5], (16, 1)), np.outer(slopes, [1, 0, 0])
    _, here = marched(device, setting, origin, direction, np.full(16, 1e6), 2000)
    exact = (np.arange(1, 2001)[:, None] - 0.3) / slopes
    assert np.abs(here / exact - 1).max() < 1.6 * setting.eps


@packets
@pytest.mark.parametrize("moving", [False, True])
def test_followed_rays_start_where_the_camera_is_at_their_time(device, setting, moving):
    """Idle lanes repeat the last ray; a moving origin is taken back into the cube."""
    rng, count, picked = np.random.default_rng(9), 16, np.array([7, 2, 11, 0, 5, 3], np.int32)
    frame = np.vstack([rng.uniform(0, N, 3), rng.normal(size=(5, 3))])
    origin, forward, right, up, drift, _ = frame
    time, end, stretch = rng.uniform(-90, 90, 12), rng.uniform(1, 9, 12), rng.uniform(1, 2, 12)
    numbers = {"time": time, "end": end, "stretch": stretch.astype(setting.precision)}
    cell, into, step = (np.zeros((3, count), t) for t in (setting.whole, *[setting.precision] * 2))
    ends, metres = np.zeros((2, count), setting.precision)
    body = """
    const march ray = march_start(cube, 4, 3, 3, 3, 3, end, end, time, end, end, stretch, picked,
                                   6, first);
    const axis axes[3] = {ray.x, ray.y, ray.z};
    for (int k = 0; k < 3; ++k) {
        STORE(axes[k].cell >> (whole)(3 * k), cell + 16 * k + first);
        STORE(axes[k].first, into + 16 * k + first);
        STORE(axes[k].step, step + 16 * k + first);
    }
    STORE(ray.end, ends + first);
    STORE(ray.metres, metres + first);
    """
    arrays = {"__constant frame *cube": frame, "picked": picked, **numbers}
    arrays |= {"cell": cell, "into": into, "step": step, "ends": ends, "metres": metres}
    evaluate(device, MARCH, body, arrays, count, setting, ["MOTION"] if moving else [])
    ray = picked[np.minimum(np.arange(count), 5)]
    o = np.mod(origin + moving * time[ray, None] * drift, N)
    d = forward + (ray % 4 - 1.5)[:, None] * right + (1 - ray // 4)[:, None] * up
    assert np.array_equal(cell.T, np.floor(o))
    ahead = np.where(d > 0, np.floor(o) + 1 - o, o - np.floor(o))
    assert step == pytest.approx(1 / np.abs(d.T), rel=2 * setting.eps)
    assert into == pytest.approx((ahead / np.abs(d)).T, rel=2 * setting.eps, abs=1e-12)
    assert np.array_equal(ends, end[ray].astype(setting.precision))
    assert np.array_equal(metres, stretch[ray].astype(setting.precision))


@packets
def test_voxels_are_counted_and_ends_recorded_for_rays_that_are_followed(device, setting):
    """A ray past the cut-off keeps its path so far and meets nothing; idle lanes do not count."""
    count, followed = 16, 13
    crossed = np.arange(100, 116).astype(setting.whole)
    lane = np.minimum(np.arange(count), followed - 1)  # idle ones repeat the last ray
    over = np.where(lane % 3 == 0, -1, 0).astype(setting.whole)
    end = (1 + lane).astype(setting.precision)
    picked = np.random.default_rng(10).permutation(20)[:followed].astype(np.int32)
    length, surface = np.full(20, 99, setting.precision), np.full(20, 4, np.int32)
    sums = np.zeros(count // setting.lanes, np.int32)
    body = """
    march ray;
    ray.end = LOAD(end + first);
    ray.metres = 3;
    march_record_ends(&ray, LOAD(over + first), picked, 13, first, length, surface);
    sums[first / LANES] = march_count(LOAD(crossed + first), first, 13);
    """
    arrays = {"crossed": crossed, "over": over, "end": end, "picked": picked}
    arrays |= {"length": length, "surface": surface, "sums": sums}
    evaluate(device, MARCH, body, arrays, count, setting)
    ended = np.isin(np.arange(20), picked[over[:followed] != 0])
    assert np.array_equal(surface, np.where(ended, 0, 4))
    assert np.array_equal(length[picked], np.where(over, 3 * end, 99)[:followed])
    expected = np.where(np.arange(count) < followed, crossed, 0).reshape(-1, setting.lanes)
    assert np.array_equal(sums, expected.sum(axis=1))


# --- thinning

RASTERS = [(7, 5, 3), (8, 8, 4), (5, 4, 10), (1, 1, 2), (9, 2, 2), (4, 6, 1)]


@pytest.mark.parametrize(("width", "height", "stride"), RASTERS)
def test_every_ray_knows_its_cell_of_the_lattice(device, width, height, stride):
    """By division, and step by step from the first ray on."""
    rays = width * height
    asked, stepped = np.zeros((2, rays, 8), np.int32)
    fields = "c.row, c.column, c.top, c.bottom, c.left, c.right, c.lattice_row, c.lattice_column"
    body = f"""
    cell next = cell_of(0, size[0], size[1], size[2]);
    for (int ray = 0; ray < size[0] * size[1]; ++ray) {{
        cell c = cell_of(ray, size[0], size[1], size[2]);
        vstore8((int8)({fields}), ray, asked);
        c = next;
        vstore8((int8)({fields}), ray, stepped);
        cell_next(&next, size[0], size[1], size[2]);
    }}
    """
    size = np.array([width, height, stride], np.int32)
    arrays = {"size": size, "asked": asked, "stepped": stepped}
    evaluate(device, ["paths/thinning"], body, arrays, 1, Setting(), ["MOMENTS=1"])

    def span(at, size):
        lattice = sorted({*range(0, size, stride), size - 1})
        low = max(line for line in lattice[: -(-size // stride)] if line <= at)
        return low, min([line for line in lattice if line > low], default=low), lattice.index(low)

    for ray in range(rays):
        row, column = divmod(ray, width)
        (top, bottom, i), (left, right, j) = span(row, height), span(column, width)
        assert asked[ray].tolist() == [row, column, top, bottom, left, right, i, j]
    assert np.array_equal(stepped, asked)


@pytest.mark.parametrize("setting", [Setting(), Setting("float64")], ids=str)
def test_a_cell_shows_one_thing_if_its_corners_do(device, setting):
    """Its rays may end a tenth short of its farthest corner, and a ninth beyond its nearest."""
    rng, width, height, stride = np.random.default_rng(11), 20, 15, 4
    surface = rng.choice(4, p=[0.6, 0.3, 0.05, 0.05], size=(height, width)).astype(np.int32)
    things = np.array([5, 5, 6, 7], np.int32)
    length = rng.uniform(10, 11, surface.shape).astype(setting.precision)
    thing, shortest, longest = np.zeros(300, np.int32), *np.zeros((2, 300), setting.precision)
    body = """
    const cell c = cell_of(first, 20, 15, 4);
    const view v = view_of(&c, 20, surface, length, things);
    thing[first] = v.thing;
    shortest[first] = v.shortest;
    longest[first] = v.longest;
    """
    arrays = {"surface": surface, "length": length, "things": things}
    arrays |= {"thing": thing, "shortest": shortest, "longest": longest}
    evaluate(device, ["paths/thinning"], body, arrays, 300, setting, ["MOMENTS=1"])
    for ray, (row, column) in enumerate(np.ndindex(height, width)):
        top, left = row - row % stride, column - column % stride
        rows, columns = [top, min(top + stride, 14)], [left, min(left + stride, 19)]
        seen = set(things[surface[np.ix_(rows, columns)]].ravel())
        far = length[np.ix_(rows, columns)].astype(float)
        assert thing[ray] == (seen.pop() if len(seen) == 1 else -1)
        assert shortest[ray] == pytest.approx(far.max() / 1.1, rel=4 * setting.eps)
        assert longest[ray] == pytest.approx(far.min() / 0.9, rel=4 * setting.eps)
    assert {-1, 5} <= set(thing)


def test_offsets_of_whole_planes_of_rays_do_not_overflow():
    """Nine moments of 16384 x 16384 rays are more than an int counts; no test has the memory."""
    planes = re.compile(r"(\(size_t\))?\b\w+ \* (padded|all|lattice|row)\b(?! \*)")
    found = {
        (path.name, match[0]): match[1] is not None
        for path in (ROOT / "kernels").glob("*/*.cl")
        for line in path.read_text(encoding="utf-8").splitlines()
        for match in planes.finditer(line.partition("//")[0])
    }
    assert len(found) >= 9
    assert [place for place, wide in found.items() if not wide] == []
