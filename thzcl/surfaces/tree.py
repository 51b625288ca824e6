"""A tree of boxes over triangles: built level by level, and searched on the host for plans.

Up to 50,000 triangles, boxes are split where the surface area heuristic is least, of all splits
along all three axes (MacDonald and Booth 1990, Visual Computer 6, 153). Of more triangles, blocks
of at most 4096 are cut off by medians first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAF = 4  # the most triangles in a box without children
SWEPT = 50_000  # the most triangles that are split by the heuristic at once
BLOCK = 4096
ALIKE = 1e-12  # relative difference of costs that rounding makes
EVEN_FROM = 40  # levels from which boxes are halved, so that no tree is deeper than the kernel's


class Tree(NamedTuple):
    """The boxes of a tree, (node, 6) in float32, lowest corner first, and their links (node, 2).

    A link is the first of two children, which follow each other, and 0; or the first triangle of a
    leaf, in the tree's own `order` (triangle,), and how many there are.
    """

    boxes: NDArray[np.float32]
    links: NDArray[np.int32]
    order: Integers


@dataclass
class _Growing:
    """Nodes that have been made, and the segments of `order` that are still to be split."""

    low: Array  # (triangle, 3): of the triangles' boxes
    high: Array
    links: list[NDArray[np.int32]]
    boxes: list[Array]
    count: int = 0

    def add(self, order: Integers, start: Integers) -> Integers:
        """Adds nodes for the segments of `order` that begin at `start`; returns their numbers."""
        low = [np.minimum.reduceat(side[order], start) for side in self.low.T]
        high = [np.maximum.reduceat(side[order], start) for side in self.high.T]
        self.boxes.append(np.stack([*low, *high], axis=1))
        self.links.append(np.zeros((len(start), 2), np.int32))
        number = np.arange(self.count, self.count + len(start))
        self.count += len(start)
        return number


def grow(low: Array, high: Array) -> Tree:
    """Returns the tree over boxes whose corners are `low` and `high`, both (triangle, 3)."""
    order = np.arange(len(low))
    growing = _Growing(np.asfortranarray(low), np.asfortranarray(high), [], [])
    root = growing.add(order, np.zeros(1, np.int64))
    pieces = _Segments(np.zeros(1, np.int64), np.array([len(order)]), root)
    links: list[tuple[Integers, Integers, Integers]] = []
    if len(order) > SWEPT:
        order, pieces = _halved(growing, order, pieces, links)
    for batch in _batches(pieces):
        first, last = batch.start[0], batch.start[-1] + batch.size[-1]
        local = _Segments(batch.start - first, batch.size, batch.node)
        order[first:last] = _swept(growing, order[first:last], local, int(first), links)
    boxes, table = np.vstack(growing.boxes), np.vstack(growing.links)
    for node, one, other in links:
        table[node, 0], table[node, 1] = one, other
    return Tree(_outwards(boxes), table, order)


class _Segments(NamedTuple):
    """Segments of an order: where each starts, how long it is, and the node it belongs to."""

    start: Integers
    size: Integers
    node: Integers

    def some(self, which: NDArray[np.bool_]) -> _Segments:
        """Returns some of the segments."""
        return _Segments(self.start[which], self.size[which], self.node[which])

    def members(self) -> tuple[Integers, Integers]:
        """Returns the places of all members, and the number of the segment of each."""
        which = np.repeat(np.arange(len(self.start)), self.size)
        before = np.cumsum(self.size) - self.size
        return np.arange(len(which)) - before[which] + self.start[which], which


def _batches(pieces: _Segments) -> list[_Segments]:
    """Returns segments in runs of about SWEPT members, in the order of their places."""
    by_place = np.argsort(pieces.start)
    pieces = _Segments(*(column[by_place] for column in pieces))
    batch = (np.cumsum(pieces.size) - 1) // SWEPT
    return [pieces.some(batch == number) for number in np.unique(batch)]


def _halved(
    growing: _Growing,
    order: Integers,
    pieces: _Segments,
    links: list[tuple[Integers, Integers, Integers]],
) -> tuple[Integers, _Segments]:
    """Returns the order and the segments after halving at medians down to BLOCK members."""
    middle = growing.low + growing.high
    done: list[_Segments] = []
    while len(pieces.start):
        large = pieces.size > BLOCK
        done.append(pieces.some(~large))
        pieces = pieces.some(large)
        if not len(pieces.start):
            break
        place, which = pieces.members()
        inside = order[place]
        start = np.cumsum(pieces.size) - pieces.size
        span = np.maximum.reduceat(middle[inside], start) - np.minimum.reduceat(
            middle[inside], start
        )
        axis = span.argmax(axis=1)
        key = middle[inside, axis[which]]
        order[place] = inside[np.lexsort((key, which))]
        left = pieces.size // 2
        pieces = _children(growing, order, pieces, left, links)
    return order, _Segments(*(np.concatenate(columns) for columns in zip(*done, strict=True)))


def _children(
    growing: _Growing,
    order: Integers,
    parents: _Segments,
    left: Integers,
    links: list[tuple[Integers, Integers, Integers]],
) -> _Segments:
    """Adds two children to each segment, the first with `left` members; returns the children."""
    start = np.stack([parents.start, parents.start + left], axis=1).ravel()
    size = np.stack([left, parents.size - left], axis=1).ravel()
    children = _Segments(start, size, np.zeros_like(start))
    place, _ = children.members()
    node = growing.add(order[place], np.cumsum(size) - size)
    links.append((parents.node, node[::2], np.zeros(len(left), np.int64)))
    return children._replace(node=node)


def _swept(
    growing: _Growing,
    order: Integers,
    pieces: _Segments,
    first: int,
    links: list[tuple[Integers, Integers, Integers]],
) -> Integers:
    """Returns an order that is split by the surface area heuristic down to leaves.

    `first` is the place of its first member among all triangles.
    """
    low, high = growing.low[order], growing.high[order]
    ranks = _Ranks.of(low, high)
    middle = low + high
    of_piece = np.repeat(np.arange(len(pieces.start)), pieces.size)
    by_axis = [np.lexsort((middle[:, axis], of_piece)) for axis in range(3)]
    level, final = 0, np.arange(len(order))
    while len(pieces.start):
        leaf = pieces.size <= LEAF
        leaves = pieces.some(leaf)
        place, _ = leaves.members()
        final[place] = by_axis[0][place]
        links.append((leaves.node, leaves.start + first, leaves.size))
        pieces = pieces.some(~leaf)
        if not len(pieces.start):
            break
        left, axis = (
            (pieces.size // 2, np.zeros(len(pieces.start), np.int64))
            if level >= EVEN_FROM
            else _best(ranks, by_axis, pieces)
        )
        _partition(by_axis, pieces, left, axis)
        pieces = _children(growing, order[by_axis[0]], pieces, left, links)
        level += 1
    return np.asarray(order[final])


class _Ranks(NamedTuple):
    """The ranks of the sides of boxes, and the sides by rank, each (6, triangle): low, then high.

    Running extremes of segments are taken of ranks, since whole numbers can hold the segment too.
    """

    rank: NDArray[np.int32]
    side: Array

    @classmethod
    def of(cls, low: Array, high: Array) -> _Ranks:
        """Returns the ranks of some boxes."""
        sides = np.hstack([low, high]).T
        by_size = np.argsort(sides, axis=1)
        # Below, ranks and numbers of segments of five and more are multiplied: 32 bits hold them.
        rank = np.empty(by_size.shape, np.int32)
        in_turn = np.arange(sides.shape[1], dtype=np.int32)
        np.put_along_axis(rank, by_size, in_turn[None], axis=1)
        return cls(rank, np.take_along_axis(sides, by_size, axis=1))

    def areas(self, member: Integers, which: Integers) -> Array:
        """Returns half the surface of the box around each segment's members up to each.

        `which` is the number of the segment of each `member`, ascending.
        """
        count = np.int32(self.rank.shape[1])
        offset = which.astype(np.int32) * count
        edges = []
        for axis in range(3):
            lowest = count - 1 - _running(count - 1 - self.rank[axis][member], offset)
            highest = _running(self.rank[axis + 3][member], offset)
            edges.append(self.side[axis + 3][highest] - self.side[axis][lowest])
        x, y, z = edges
        return np.asarray(x * y + y * z + z * x)


def _running(rank: NDArray[np.int32], offset: NDArray[np.int32]) -> NDArray[np.int32]:
    """Returns the largest rank so far within each segment, whose ranks an offset sets apart."""
    return np.asarray(np.maximum.accumulate(rank + offset) - offset)


def _best(ranks: _Ranks, by_axis: list[Integers], pieces: _Segments) -> tuple[Integers, Integers]:
    """Returns how many members stay left in each segment's best split, and along which axis."""
    place, which = pieces.members()
    start = np.cumsum(pieces.size) - pieces.size
    number = np.arange(len(place)) - start[which] + 1  # members up to each, itself included
    last = number == pieces.size[which]
    least = np.full(len(start), np.inf)
    left, along = pieces.size // 2, np.zeros(len(start), np.int64)
    backwards = (len(start) - 1 - which)[::-1]
    for axis in range(3):
        member = by_axis[axis][place]
        up_to = ranks.areas(member, which)
        after = ranks.areas(member[::-1], backwards)[::-1]
        following = np.append(after[1:], 0.0)
        cost = up_to * number + following * (pieces.size[which] - number)
        cost[last] = np.inf
        lowest = np.minimum.reduceat(cost, start)
        # Of splits that are as good, as those of equal triangles are, the most even one.
        hit = np.flatnonzero(cost <= lowest[which] * (1 + ALIKE))
        uneven = np.abs(2 * number[hit] - pieces.size[which[hit]])
        hit = hit[np.lexsort((uneven, which[hit]))]
        segment, at = np.unique(which[hit], return_index=True)
        better = lowest[segment] < least[segment]
        segment, at = segment[better], at[better]
        left[segment], along[segment] = number[hit[at]], axis
        least[segment] = lowest[segment]
    return left, along


def _partition(by_axis: list[Integers], pieces: _Segments, left: Integers, axis: Integers) -> None:
    """Sorts every segment's members into the left and the right of its split, in all orders."""
    place, which = pieces.members()
    number = place - pieces.start[which]
    goes_left = np.zeros(len(by_axis[0]), bool)
    for one in range(3):
        along = (axis == one)[which]
        goes_left[by_axis[one][place[along]]] = number[along] < left[which[along]]
    for order in by_axis:
        member = order[place]
        side = goes_left[member]
        before = np.cumsum(side) - side  # of all segments: less those before this one's start
        start = np.cumsum(pieces.size) - pieces.size
        lefts = before - before[start][which]
        there = np.where(side, lefts, left[which] + number - lefts)
        order[pieces.start[which] + there] = member


def _outwards(boxes: Array) -> NDArray[np.float32]:
    """Returns boxes in float32, rounded outwards by two places."""
    found = boxes.astype(np.float32)
    for _ in range(2):
        found[:, :3] = np.nextafter(found[:, :3], np.float32(-np.inf))
        found[:, 3:] = np.nextafter(found[:, 3:], np.float32(np.inf))
    return found


class Strikes(NamedTuple):
    """Where rays meet triangles first: the ray parameter (ray,), inf for none, and the triangle."""

    reach: Array
    triangle: Integers


def first_struck(
    boxes: NDArray[np.float32],
    links: NDArray[np.int32],
    corners: tuple[Array, Array, Array],
    origin: Array,
    direction: Array,
) -> Strikes:
    """Returns where rays from one origin meet triangles first, all levels of the tree at once.

    `corners` are (triangle, 3) each, in the tree's order, and `direction` (ray, 3).
    """
    nearest = np.full(len(direction), np.inf)
    found = np.full(len(direction), -1)
    inverse = 1 / np.where(np.abs(direction) < 1e-300, 1e-300, direction)
    ray, node = np.arange(len(direction)), np.zeros(len(direction), np.int64)
    while len(ray):
        one = (boxes[node, :3] - origin) * inverse[ray]
        other = (boxes[node, 3:] - origin) * inverse[ray]
        enter = np.minimum(one, other).max(axis=1)
        leave = np.maximum(one, other).min(axis=1)
        inside = (enter <= leave * (1 + 1e-12)) & (leave >= 0)
        ray, node = ray[inside], node[inside]
        first, count = links[node].T
        leaf = count > 0
        for number in range(LEAF):
            some = leaf & (count > number)
            _strike(corners, first[some] + number, origin, direction, ray[some], nearest, found)
        ray = np.repeat(ray[~leaf], 2)
        node = np.stack([first[~leaf], first[~leaf] + 1], axis=1).ravel().astype(np.int64)
    return Strikes(nearest, found)


def _strike(
    corners: tuple[Array, Array, Array],
    triangle: Integers,
    origin: Array,
    direction: Array,
    ray: Integers,
    nearest: Array,
    found: Integers,
) -> None:
    """Records in `nearest` and `found` the rays that meet a triangle each."""
    a, b, c = (corner[triangle] - origin for corner in corners)
    d = direction[ray]
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (normal * a).sum(axis=1) / (normal * d).sum(axis=1)
    u, v, w = ((np.cross(one, other) * d).sum(axis=1) for one, other in ((c, b), (a, c), (b, a)))
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    met = inside & (reach > 0) & np.isfinite(reach)
    by_reach = np.argsort(-reach[met], kind="stable")  # the nearest is written last
    ray, triangle, reach = (one[met][by_reach] for one in (ray, triangle, reach))
    sooner = reach < nearest[ray]
    nearest[ray[sooner]], found[ray[sooner]] = reach[sooner], triangle[sooner]
