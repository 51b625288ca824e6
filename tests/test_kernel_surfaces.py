"""Where kernels find that rays start and end, function by function.

Expectations are plain geometry in float64, or the oracle's.
"""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from kernel_functions import STARTS, evaluate
from scipy.ndimage import map_coordinates

starts = pytest.mark.parametrize("setting", STARTS, ids=str)
SURFACES = ["surfaces/camera", "surfaces/surfaces"]
# Rays that come so near to an edge, relative to its object's size, may be rounded to either side.
NEAR = {"float64": 1e-12, "float32": 1e-4}


# --- camera


@starts
@pytest.mark.parametrize("outgoing", [False, True])
def test_rays_leave_through_the_middles_of_pixels(device, setting, outgoing):
    """The followed ray is the camera's, or leads from a transmitter to a point on the camera's."""
    width, height = 5, 4
    frame = np.random.default_rng(1).normal(size=(6, 3))
    _, forward, right, up, _, offset = frame
    reach = np.linspace(0, 9, 20)
    direction, followed = np.zeros((2, 20, 3), setting.wide)
    body = """
    const point d = ray_direction(camera, 5, 4, first);
    const point f = follow_direction(camera, 5, 4, first, reach[first]);
    vstore3((wide3)(d.x, d.y, d.z), first, direction);
    vstore3((wide3)(f.x, f.y, f.z), first, followed);
    """
    arrays = {"__constant frame *camera": frame.astype(setting.wide)}
    arrays |= {"reach": reach.astype(setting.wide), "direction": direction, "followed": followed}
    options = [f"wide3={'double3' if setting.float64 else 'float3'}"]
    options += ["OUTGOING"] if outgoing else []
    evaluate(device, SURFACES[:1], body, arrays, 20, setting, options)
    column, row = np.meshgrid(np.arange(width) - 2, 1.5 - np.arange(height))  # from the middle
    expected = forward + column.reshape(-1, 1) * right + row.reshape(-1, 1) * up
    bound = 40 * setting.wide_eps
    assert np.abs(direction - expected).max() < bound
    if outgoing:
        expected = offset + reach[:, None] * expected
    assert np.abs(followed - expected).max() < 10 * bound


# --- ground and boxes


def meet(device, setting, call, arrays, origin, direction, reach):
    """Where each ray ends that would end at `reach` on surface 9, as a function of OpenCL C has it.

    Returns reach, surface, blend and cosine.
    """
    count = len(origin)
    out = {"nearest": reach.copy(), "surface": np.full(count, 9, np.int32)}
    out |= {name: np.zeros(count, setting.wide) for name in ("blend", "cosine")}
    body = f"""
    const point o = {{origin[3 * first], origin[3 * first + 1], origin[3 * first + 2]}};
    const point d = {{direction[3 * first], direction[3 * first + 1], direction[3 * first + 2]}};
    const wide norm = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
    hit h = {{nearest[first], 9, 0, 0, 0}};
    {call}
    nearest[first] = h.reach;
    surface[first] = h.surface;
    blend[first] = h.blend;
    cosine[first] = h.cosine;
    """
    arrays = arrays | {"origin": origin, "direction": direction} | out
    options = ["GROUND", "BOXES", "BILLBOARDS"]
    evaluate(device, SURFACES, body, arrays, count, setting, options)
    return out.values()


@starts
def test_the_ground_is_met_from_above(device, setting):
    """By rays that go down, if nothing else stands nearer."""
    rng, count = np.random.default_rng(12), 1024
    origin, direction = rng.uniform(-3, 3, (2, count, 3)).astype(setting.wide)
    direction[:9, 2] = 0
    reach = rng.uniform(0.2, 3, count).astype(setting.wide)
    call = "const things all = {0, 0, 0, 0, 0, 0, 0}; meet_all(&all, o, d, norm, &h);"
    ends, surface, _, cosine = meet(device, setting, call, {}, origin, direction, reach)
    with np.errstate(divide="ignore"):
        down = -origin[:, 2] / direction[:, 2]
    hit = (origin[:, 2] > 0) & (direction[:, 2] < 0) & (down < reach)
    slant = -direction[:, 2] / np.linalg.norm(direction, axis=1)
    assert 100 < hit.sum() < 400
    assert np.array_equal(surface, np.where(hit, 1, 9))
    assert ends == pytest.approx(np.where(hit, down, reach), rel=4 * setting.wide_eps)
    assert cosine == pytest.approx(np.where(hit, slant, 0), abs=4 * setting.wide_eps)


@starts
def test_a_slab_cuts_a_ray_to_what_lies_between_its_faces(device, setting):
    """A ray along the faces lies between them from the lower face on, and below the upper."""
    rng, count = np.random.default_rng(2), 4096
    half = rng.uniform(0.5, 2, count).astype(setting.wide)
    origin = rng.uniform(-4, 4, count).astype(setting.wide)
    direction = rng.normal(size=count).astype(setting.wide)
    direction[:64] = 0
    origin[:3] = -half[0], half[1], np.nextafter(-half[2], setting.wide.type(-9))
    stretch = np.sort(rng.uniform(-4, 4, (2, count)), axis=0).astype(setting.wide)
    cut, axes = stretch.copy(), np.zeros((2, count), np.int32)
    body = """
    wide enter = cut[first], leave = cut[4096 + first];
    int enter_axis = 7, leave_axis = 7;
    slab(origin[first], direction[first], half_size[first], 2, &enter, &leave, &enter_axis,
         &leave_axis);
    cut[first] = enter;
    cut[4096 + first] = leave;
    axes[first] = enter_axis;
    axes[4096 + first] = leave_axis;
    """
    arrays = {"origin": origin, "direction": direction, "half_size": half, "cut": cut, "axes": axes}
    evaluate(device, SURFACES, body, arrays, count, setting)
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.sort([(-half - origin) / direction, (half - origin) / direction], axis=0)
    within = (-half <= origin) & (origin < half)
    faces[:, :64] = np.where(within[:64], [[-np.inf], [np.inf]], [[-np.inf], [-np.inf]])
    enter, leave = np.maximum(stretch[0], faces[0]), np.minimum(stretch[1], faces[1])
    assert within[:3].tolist() == [True, False, False]
    assert cut == pytest.approx(np.array([enter, leave]), rel=4 * setting.wide_eps)
    turning = np.arange(count) >= 64  # a ray along the faces enters and leaves by none
    assert np.array_equal(axes[0], np.where((faces[0] > stretch[0]) & turning, 2, 7))
    assert np.array_equal(axes[1], np.where((faces[1] < stretch[1]) & turning, 2, 7))


FACES = [(axis, sign) for axis in range(3) for sign in (-1, 1)]


@starts
def test_stripes_are_counted_from_the_left_as_seen_from_outside(device, setting):
    """Also at points that rounding puts just beside the face."""
    half = np.array([1.0, 2.0, 0.5], setting.wide)
    asked = [(a, s, n, k) for a, s in FACES for n in (1, 2, 7) for k in range(-1, n + 1)]
    points = np.zeros((len(asked), 3), setting.wide)
    for point, (axis, sign, number, stripe) in zip(points, asked, strict=True):
        # Who looks at a wall from outside has this to the right; on top and bottom x says it.
        wall = np.cross(-sign * np.eye(3)[axis], (0, 0, 1))
        right = wall if axis < 2 else np.array([sign, 0, 0])
        point[:] = right * half * (np.clip((2 * stripe + 1) / number, -1e-3, 2.001) - 1)
        point[axis] = sign * half[axis]
    found = np.zeros(len(asked), np.int32)
    body = """
    wide p[3], h[3];
    for (int k = 0; k < 3; ++k) { p[k] = points[3 * first + k]; h[k] = half_size[k]; }
    found[first] = stripe_at(p, h, face[3 * first], face[3 * first + 1] > 0, face[3 * first + 2]);
    """
    arrays = {"points": points, "half_size": half, "found": found}
    arrays |= {"face": np.array([each[:3] for each in asked], np.int32)}
    evaluate(device, SURFACES, body, arrays, len(asked), setting)
    assert found.tolist() == [min(max(k, 0), n - 1) for _, _, n, k in asked]


def struck(box, origin, direction, longest):
    """Reach, face and stripe of five of what a ray meets nearer than `longest`, or Nones."""
    hit = box.meet(origin, direction)
    if hit is None or hit[0] >= longest:
        return None, None, None
    return hit[0], (hit[1], hit[2]), oracle.stripe(box, hit, 5)


@starts
def test_a_box_is_met_where_its_nearest_face_is(device, setting):
    """From outside by the first face, from inside by the last; other things may stand nearer."""
    rng, yaw = np.random.default_rng(3), 25.0
    center, size = np.array([1.0, -2.0, 0.5]), np.array([2.0, 3.0, 1.0])
    origin = (center + rng.uniform(-3, 3, (800, 3))).astype(setting.wide)
    origin[:200] = center + rng.uniform(-0.4, 0.4, (200, 3)) * size
    direction = rng.normal(size=(800, 3)).astype(setting.wide)
    direction[:6] = np.vstack([np.eye(3), -np.eye(3)])
    aim = center + rng.uniform(-0.6, 0.6, (400, 3)) * size
    direction[200:600] = aim - origin[200:600]
    reach = rng.uniform(0.5, 9, 800).astype(setting.wide)
    c, s = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    stripes = np.array([[5, 30 + face] if face else [0, 0] for face in range(6)], np.int32)
    arrays = {"__constant box *boxes": np.array([*center, *size / 2, c, s], setting.wide)}
    arrays |= {"__constant int2 *stripes": stripes}
    call = "meet_box(boxes, stripes, 20, o, d, norm, &h);"
    ends, surface, _, cosine = meet(device, setting, call, arrays, origin, direction, reach)

    near, axes, faces = NEAR[str(setting.wide)], np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), set()
    scales = (1, 1 - near, 1 + near)
    for i, (o, d) in enumerate(zip(origin.astype(float), direction.astype(float), strict=True)):
        there, *others = (
            struck(oracle.Box(center, size * scale, yaw), o, d, reach[i] * scale)
            for scale in scales
        )
        if any(other[1:] != there[1:] for other in others):
            continue
        met, face, stripe = there
        if face is None:
            assert (surface[i], ends[i]) == (9, reach[i])
            continue
        number = FACES.index(face)
        assert ends[i] == pytest.approx(met, rel=near)
        assert surface[i] == (30 + number if number and stripe % 2 == 0 else 20)
        assert cosine[i] == pytest.approx(abs(axes[face[0]] @ d) / np.linalg.norm(d), abs=near)
        faces.add((face, i < 200))
    assert len(faces) == 12  # every face, from outside and from inside


# --- billboards


def textures():
    """A texture of 5 by 3 texels with both extremes, one of a single texel, and one of a row."""
    rng = np.random.default_rng(4)
    made = [rng.uniform(size=shape).astype(np.float32) for shape in ((3, 5), (1, 1), (1, 4))]
    made[0][[0, 2], [0, 4]] = 0, 1
    return made


@starts
@pytest.mark.parametrize("number", range(3))
def test_texels_are_blended_between_their_middles(device, setting, number):
    """Beyond the outermost middles the edge goes on. The nearest texel is the one at (u, v)."""
    values, rng = textures()[number], np.random.default_rng(5)
    height, width = values.shape
    u, v = rng.uniform(size=(2, 1024)).astype(setting.wide)
    below_one = np.nextafter(setting.wide.type(1), setting.wide.type(0))
    u[:4], v[:4] = (0, below_one, 0.5 / width, 1 - 0.5 / width), (0, below_one, 0.5 / height, 0)
    blended, nearest = np.zeros((2, 1024), setting.wide)
    body = """
    blended[first] = texel(values, WIDTH, HEIGHT, 0, u[first], v[first]);
    nearest[first] = texel(values, WIDTH, HEIGHT, 1, u[first], v[first]);
    """
    arrays = {"values": values, "u": u, "v": v, "blended": blended, "nearest": nearest}
    options = [f"WIDTH={width}", f"HEIGHT={height}"]
    evaluate(device, SURFACES, body, arrays, 1024, setting, options)
    at = np.array([v * height, u * width])
    expected = map_coordinates(values.astype(float), at - 0.5, order=1, mode="nearest")
    assert np.abs(blended - expected).max() < 20 * setting.wide_eps
    assert np.array_equal(nearest, values[*np.floor(at).astype(int)])


CENTER, HALF, TURN = np.array([2.0, 1.0, 1.5]), np.array([0.9, 0.6]), math.radians(200.0)
FRONT = np.array([math.cos(TURN), math.sin(TURN), 0])
MASK = np.array([[1, 0, 1, 1, 0], [1, 1, 1, 0, 1], [0, 1, 1, 1, 1]])


def on_board(origin, direction, reach, near):
    """How far rays go to the billboard's plane, at which (row, column) of 3 by 5 texels.

    Returns also which of them hit the billboard, and which do or do not for sure.
    """
    right = np.cross(-FRONT, (0, 0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        there = (CENTER - origin) @ FRONT / (direction @ FRONT)
        point = origin + there[:, None] * direction - CENTER
        at = np.array([1.5 - 1.5 * point[:, 2] / HALF[1], 2.5 + 2.5 * (point @ right) / HALF[0]])
        inside = (at >= 0).all(axis=0) & (at[0] < 3) & (at[1] < 5)
        sure = (np.abs(at - np.rint(at)) > 10 * near).all(axis=0) & (np.abs(there - reach) > near)
    return there, at, inside & (there > 0) & (there < reach), sure


@starts
@pytest.mark.parametrize("take_nearest", [0, 1])
def test_a_billboard_is_met_where_its_mask_lets_it_be(device, setting, take_nearest):
    """From the front and from behind, with columns to the right as seen from the front."""
    rng, count, levels = np.random.default_rng(6), 4000, 7
    origin = (CENTER + rng.uniform(-3, 3, (count, 3))).astype(setting.wide)
    aim = rng.uniform(-1.2, 1.2, (count, 2)) * HALF
    target = CENTER + aim[:, :1] * [FRONT[1], -FRONT[0], 0] + aim[:, 1:] * [0, 0, 1]
    direction = ((target - origin) * rng.choice([1, 1, 1, -1], (count, 1))).astype(setting.wide)
    direction[0] = (0, 0, 1)  # along the billboard, and past it
    reach = rng.uniform(0.5, 4, count).astype(setting.wide)
    values = textures()[0]
    image = np.array([15, 5, 3, take_nearest, 20, levels, 0], np.int32)
    arrays = {"__constant billboard *board": np.array([*CENTER, *HALF, *FRONT[:2]], setting.wide)}
    arrays |= {"texels": np.concatenate([MASK, values]).ravel().astype(np.float32)}
    arrays |= {"__constant texture *image": image}
    call = "meet_billboard(board, image, texels, o, d, norm, &h);"
    ends, surface, blend, cosine = meet(device, setting, call, arrays, origin, direction, reach)

    near, d = NEAR[str(setting.wide)], direction.astype(float)
    there, at, hit, sure = on_board(origin.astype(float), d, reach.astype(float), near)
    cell = np.floor(np.where(hit, at, 0)).astype(int)
    seen, missed = hit & (MASK[*cell] == 1) & sure, ~(hit & (MASK[*cell] == 1)) & sure
    missed[0] = True
    assert seen.sum() > 500 and missed.sum() > 500 and np.ptp(np.sign(d[seen] @ FRONT)) == 2
    assert (surface[missed] == 9).all() and np.array_equal(ends[missed], reach[missed])
    assert ends[seen] == pytest.approx(there[seen], rel=near)
    slant = np.abs(d[seen] @ FRONT) / np.linalg.norm(d[seen], axis=1)
    assert cosine[seen] == pytest.approx(slant, abs=near)
    blended = map_coordinates(values.astype(float), at - 0.5, order=1, mode="nearest")
    level = (values[*cell].astype(float) if take_nearest else blended)[seen] * (levels - 1)
    assert surface[seen] - 20 + blend[seen] == pytest.approx(level, abs=50 * near)
    assert (surface[seen] >= 20).all() and (surface[seen] < 20 + levels - 1).all()
    assert (blend[seen] >= 0).all() and (blend[seen] <= 1).all()
