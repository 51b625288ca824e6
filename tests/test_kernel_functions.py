"""What kernels compute with, function by function: random numbers, exponentials, sums, tables.

Expectations are plain NumPy in float64, or published numbers.
"""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from kernel_functions import PACKETS, Setting, evaluate

packets = pytest.mark.parametrize("setting", PACKETS, ids=str)
FIELD = [Setting("float32", 8), Setting("float32")]  # random numbers are float32 in any precision

# Counter, key and output: Random123 (Salmon, Moraes, Dror and Shaw 2011), tests/kat_vectors, the
# lines of "philox4x32 10".
PUBLISHED = (
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
)


# --- random numbers


@pytest.mark.parametrize(("counter", "key", "output"), PUBLISHED)
def test_the_oracle_gives_the_published_words(counter, key, output):
    assert tuple(int(word) for word in oracle.philox(counter, key)) == output


@pytest.mark.parametrize("setting", FIELD, ids=str)
def test_philox_gives_the_published_words_in_every_lane(device, setting):
    """Beside a published counter, the other lanes count otherwise, and give the oracle's words."""
    lanes = setting.lanes
    count = len(PUBLISHED) * lanes * lanes
    words = np.random.default_rng(1).integers(2**32, size=(4, count), dtype=np.uint32)
    keys = np.repeat([key for _, key, _ in PUBLISHED], lanes, axis=0).astype(np.uint32)
    known = np.arange(count).reshape(len(PUBLISHED), lanes, lanes).diagonal(axis1=1, axis2=2)
    for number, (counter, _, _) in enumerate(PUBLISHED):
        words[:, known[number]] = np.array(counter, np.uint32)[:, None]
    expected = [oracle.philox(words[:, i], keys[i // lanes]) for i in range(count)]
    body = """
    uints a = LOAD(words + first), b = LOAD(words + COUNT + first);
    uints c = LOAD(words + 2 * COUNT + first), d = LOAD(words + 3 * COUNT + first);
    philox(&a, &b, &c, &d, vload2(first / LANES, keys));
    STORE(a, words + first);
    STORE(b, words + COUNT + first);
    STORE(c, words + 2 * COUNT + first);
    STORE(d, words + 3 * COUNT + first);
    """
    arrays = {"words": words, "keys": keys}
    evaluate(device, ["turbulence/field"], body, arrays, count, setting, [f"COUNT={count}"])
    assert np.array_equal(words.T, expected)
    for number, (_, _, output) in enumerate(PUBLISHED):
        assert (words[:, known[number]] == np.array(output)[:, None]).all()


@pytest.mark.parametrize("setting", FIELD, ids=str)
def test_normals_are_those_of_box_and_muller(device, setting):
    """Words are rounded to 24 bits: that moves the squared radius by 2.4e-7, the angle by 4e-7."""
    a, b = np.random.default_rng(2).integers(2**32, size=(2, 65536), dtype=np.uint32)
    a[:4], b[4:10] = [0, 1, 2**32 - 1, 2**31], [0, 2**30, 2**31 - 1, 2**31, 3 << 30, 2**32 - 1]
    one, other, *opposite = (np.zeros(len(a), np.float32) for _ in range(4))
    body = """
    floats x, y;
    normals(LOAD(a + first), LOAD(b + first), &x, &y);
    STORE(x, one + first);
    STORE(y, other + first);
    """
    for turned, out in ((b, (one, other)), (b ^ np.uint32(2**31), opposite)):
        arrays = {"a": a, "b": turned, "one": out[0], "other": out[1]}
        evaluate(device, ["turbulence/field"], body, arrays, len(a), setting)
    radius = np.sqrt(-2 * np.log((a.astype(float) + 0.5) / 2**32))
    angle = 2 * np.pi * b.astype(float) / 2**32
    bound = 2.4e-7 / np.maximum(radius, np.sqrt(2.4e-7)) + 4e-7 * radius
    assert (np.abs(one - radius * np.cos(angle)) < bound).all()
    assert (np.abs(other - radius * np.sin(angle)) < bound).all()
    # Half a turn on lies the exact opposite, so that no rounding leaves a mean.
    assert np.array_equal(opposite, [-one, -other])


# --- exponentials


@packets
def test_attenuation_keeps_the_digits_of_what_is_left_and_what_is_lost(device, setting):
    # Where the reduction changes from one power of 2 to the next; and ends, beyond 80 too.
    half_powers = np.log(2) / 2 * np.arange(1, 231)
    x = np.concatenate(
        [np.geomspace(1e-12, 80, 7730), half_powers, half_powers * (1 + 1e-6), [0, 200]]
    ).astype(setting.precision)
    thin = np.geomspace(1e-12, 1 / 8, len(x)).astype(setting.precision)
    left, lost, thin_left, thin_lost = (np.zeros_like(x) for _ in range(4))
    body = """
    reals gone;
    STORE(attenuate(LOAD(x + first), &gone), left + first);
    STORE(gone, lost + first);
    STORE(attenuate_thin(LOAD(thin + first), &gone), thin_left + first);
    STORE(gone, thin_lost + first);
    """
    arrays = {"x": x, "left": left, "lost": lost}
    arrays |= {"thin": thin, "thin_left": thin_left, "thin_lost": thin_lost}
    evaluate(device, ["paths/attenuate"], body, arrays, len(x), setting)
    bound = 2e-7 if setting.precision == "float32" else 2e-15
    for depth, passed, gone in ((x[:-2], left[:-2], lost[:-2]), (thin, thin_left, thin_lost)):
        exact = depth.astype(float)
        assert np.abs(passed / np.exp(-exact) - 1).max() < bound
        assert np.abs(gone / -np.expm1(-exact) - 1).max() < bound
    assert (left[-2], lost[-2]) == (1, 0)
    assert 0 <= left[-1] < 2e-35 and lost[-1] == 1


# --- sums and tables


@packets
@pytest.mark.parametrize("moments", [0, 5])
def test_depth_is_the_sum_over_moments(device, setting, moments):
    """Each packet knows, besides, whether its rays meet the same surface."""
    rng, count = np.random.default_rng(3), 64
    c = rng.normal(size=moments + 1).astype(setting.precision)
    length = rng.uniform(1, 100, count).astype(setting.precision)
    m = rng.normal(size=(max(moments, 1), count)).astype(setting.precision)
    depth = np.zeros(count, setting.precision)
    surface = np.full(count, 3, np.int32)
    surface[
        32 + np.arange(0, 32, setting.lanes) + np.arange(32 // setting.lanes) % setting.lanes
    ] += 1
    alike = np.zeros(count // setting.lanes, np.int32)
    body = """
    reals m[MOMENTS + 1];
    for (int k = 0; k < MOMENTS; ++k) m[k] = LOAD(moments + k * 64 + first);
    STORE(depth_of(c, LOAD(length + first), m), depth + first);
    alike[first / LANES] = all_alike(surface, first);
    """
    arrays = {"c": c, "length": length, "moments": m, "depth": depth}
    arrays |= {"surface": surface, "alike": alike}
    files = ["surfaces/source", "paths/attenuate", "paths/shade"]
    evaluate(device, files, body, arrays, count, setting, [f"MOMENTS={moments}"])
    terms = c[:, None].astype(float) * np.vstack([length, m[:moments]])
    assert (np.abs(depth - terms.sum(axis=0)) < 4 * setting.eps * np.abs(terms).sum(axis=0)).all()
    assert np.array_equal(alike, np.ptp(surface.reshape(-1, setting.lanes), axis=1) == 0)


@packets
@pytest.mark.parametrize("textured", [False, True])
def test_a_surface_sends_out_its_row_of_the_table(device, setting, textured):
    """A ray on a texture sends out what lies between its row and the next."""
    rng, count, columns = np.random.default_rng(4), 32, 3
    table = rng.normal(size=(6, columns)).astype(setting.precision)
    surface = rng.integers(5, size=count).astype(np.int32)
    blend = rng.uniform(size=count).astype(setting.precision)
    blend[:3] = 0, 1, 0.5
    value = np.zeros(count, setting.precision)
    body = """
    const sources from = {table, surface, blend, 0, 0, 0, 0, 0};
    STORE(surface_value(&from, first, 3, 2), value + first);
    """
    arrays = {"table": table, "surface": surface, "blend": blend, "value": value}
    options = ["BLENDED"] if textured else []
    evaluate(device, ["surfaces/source"], body, arrays, count, setting, options)
    this, following = table[surface, 2].astype(float), table[surface + 1, 2].astype(float)
    if not textured:
        assert np.array_equal(value, this)
    else:
        error = value - ((1 - blend.astype(float)) * this + blend * following)
        assert (np.abs(error) < 2 * setting.eps * (np.abs(this) + np.abs(following))).all()


@packets
def test_lanes_gather_and_any_of_them_counts(device, setting):
    rng, lanes = np.random.default_rng(5), setting.lanes
    count = (lanes + 1) * lanes
    values = rng.normal(size=1000).astype(setting.precision)
    index = rng.integers(1000, size=count).astype(setting.whole)
    index[:2] = 0, 999
    x = np.eye(lanes + 1, lanes, dtype=setting.precision)  # each lane alone, and no lane
    gathered, least = np.zeros((2, count), setting.precision)
    found = np.zeros(lanes + 1, np.int32)
    body = """
    const reals value = GATHER(values, LOAD(index + first));
    STORE(value, gathered + first);
    STORE(SMALLER(value, LOAD(x + first)), least + first);
    found[first / LANES] = ANY(LOAD(x + first) > 0) ? 1 : 0;
    """
    arrays = {"values": values, "index": index, "x": x, "gathered": gathered}
    arrays |= {"least": least, "found": found}
    evaluate(device, [], body, arrays, count, setting)
    assert np.array_equal(gathered, values[index])
    assert np.array_equal(least, np.minimum(values[index], x.ravel()))
    assert found.tolist() == [1] * lanes + [0]


@packets
def test_depths_add_up_without_rounding_and_polynomials_end_where_they_end(device, setting):
    """Plain sums of 10,000 terms go astray by some 3e-6 in float32, compensated ones by rounding.

    The coefficient that a polynomial of three does not have is not a number here.
    """
    rng, count = np.random.default_rng(6), 16
    terms = rng.uniform(0, 1e-3, (10000, count)).astype(setting.precision)
    x = rng.uniform(-2, 2, count).astype(setting.precision)
    c = np.array([0.5, -1.25, 2.0, np.nan], setting.precision)
    total, left_over, value = (np.zeros(count, setting.precision) for _ in range(3))
    body = """
    reals depth = 0, rest = 0, latest = 0;
    for (int i = 0; i < 10000; ++i) {
        latest += LOAD(terms + 16 * i + first);
        take_in(&depth, &rest, &latest);
    }
    STORE(depth, total + first);
    STORE(latest, left_over + first);
    reals sum = 0;
    POLYNOMIAL(sum, c, 3, 4, LOAD(x + first))
    STORE(sum, value + first);
    """
    arrays = {"terms": terms, "total": total, "left_over": left_over, "x": x, "value": value}
    arrays |= {"__constant real *c": c}
    files = [
        "surfaces/camera",
        "paths/march",
        "surfaces/source",
        "paths/attenuate",
        "paths/emission",
    ]
    powers = ["HUMIDITY_POWERS=1", "TEMPERATURE_POWERS=1", "PLANCK_POWERS=1", "COUNTS=1"]
    evaluate(device, files, body, arrays, count, setting, ["FREQUENCIES=1", *powers])
    exact = terms.sum(axis=0, dtype=np.longdouble)
    assert np.abs(total / exact - 1).max() < 2 * setting.eps
    assert not left_over.any()
    assert value == pytest.approx(0.5 - 1.25 * x + 2 * x.astype(float) ** 2, abs=20 * setting.eps)
