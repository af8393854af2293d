"""Sets of errors under the loops and W of every band, and the cost of their ends; part of
`check_certificate`, of the standard library alone.

With t = tan(x)/x, x = A/2, loops Phi = M + B K are affine in t V_r and t V_l, so that those of a
region of wheel speeds are mixtures of those at its corners, with the least and the greatest t; K is
affine in V_r and V_l. Multipliers l >= 0 that make l H of a row prove row e <= l h where H e <= h,
up to what they leave of the row (Farkas 1902).
"""

from itertools import pairwise, product
from operator import mul

from check_intervals import (
    BITS,
    COSINE,
    ONE,
    ZERO,
    C,
    add,
    dot,
    invert,
    multiply,
    pick,
    read_units,
    require,
    scale,
    scale_all,
    size,
    subtract,
    times,
)

AXES = [[scale(sign * (k == axis)) for k in range(3)] for axis in range(3) for sign in (1, -1)]


def find_greatest(row, sizes):
    """Return the greatest product of a row and numbers of these sizes, in units."""
    return dot([(0, size(entry)) for entry in row], sizes)[1]


def negate_if(sign, row):
    """Return sign times a row."""
    return list(row) if sign > 0 else [(-high, -low) for low, high in row]


def reach(band, row):
    """Return the greatest product of a row and a disturbance in W, in units."""
    yaw, lean, box = pick(band["disturbance"], "yaw", "lean", "box")
    along = add(multiply(row[1], scale(lean)), row[2])
    return find_greatest([along, *row], scale_all([yaw, *box]))


def weigh(rows, offsets, row, multipliers):
    """Return what multipliers prove of row e, rows e <= offsets, and what they leave of it, in
    units. Whatever a multiplier is rounded to proves something, as long as it is not negative."""
    require(all(weight >= 0 for weight in multipliers.values()), "a multiplier is negative")
    weights = [(scale(weight)[0],) * 2 for weight in multipliers.values()]
    used = [int(index) for index in multipliers]
    made = times(weights, [rows[index] for index in used]) if used else [ZERO] * 3
    left = [size(subtract(*pair)) for pair in zip(row, made, strict=True)]
    return dot(weights, [offsets[index] for index in used])[1], left


class Set:
    """A set of errors, rows e <= offsets, intervals; the greatest |x|, |y|, |th| in it by the
    multipliers of its extents. With R the greatest that multipliers prove and r what they leave of
    a row, the greatest M is at most R + 3 r M, hence below 2 R."""

    def __init__(self, rows, offsets, extents):
        self.rows = rows
        self.offsets = offsets
        pairs = zip(AXES, extents, strict=True)
        proved = [weigh(rows, offsets, *pair) for pair in pairs]
        left = max(max(parts) for _, parts in proved)
        require(6 * left <= ONE, "a set is not bounded by its multipliers")
        greatest = max(value for value, _ in proved)
        most = [value - (-6 * left * greatest >> BITS) for value, _ in proved]
        self.extents = [(0, max(most[i], most[i + 1])) for i in (0, 2, 4)]

    def bound(self, row, multipliers):
        """Return an upper bound of row e over the set by multipliers, in units."""
        proved, left = weigh(self.rows, self.offsets, row, multipliers)
        return proved + dot([(0, each) for each in left], self.extents)[1]


def list_inputs(band):
    """Return rows D, C, as intervals, and ends of low <= D u + C e <= high: the caps of inputs,
    coupled with x."""
    if "inputs" in band:
        rows = [
            ((1, each["on_u2"]), (0, 0, 0), *pick(each, "low", "high")) for each in band["inputs"]
        ]
    else:
        of_x, of_turn = band["coupling"]
        rows = [((1, 0), (0, 0, 0), *band["u1"]), ((0, 1), (0, 0, 0), *band["u2"])]
        coupled = [((0, sign * of_turn), (of_x, 0, 0), -1, 1) for sign in (1, -1)]
        rows += coupled if of_turn else []
    return [(scale_all(on_u), scale_all(on_e), *ends) for on_u, on_e, *ends in rows]


def find_input_sizes(band):
    """Return the greatest |u1| and |u2| that the rows on inputs alone leave: with |u1 + s u2| and
    |u1 - s u2| at most m, these are m and m/s."""
    if "inputs" not in band:
        return [max(map(abs, band[name])) for name in ("u1", "u2")]
    first = band["inputs"][0]["on_u2"]
    require(first == -band["inputs"][1]["on_u2"] > 0, "rows on inputs are not those of two wheels")
    most = max(abs(each[end]) for each in band["inputs"] for end in ("low", "high"))
    return [most, most / first]


def list_slips(certificate, wheel):
    """Return pairs of a true slip and the one that is compensated then, which hold the extremes of
    both and of d = (true - compensated) / (1 - compensated). Where a slip i is measured within a +
    r |i|, d has one slope on either side of i = 0, and its greatest values at ends."""
    pairs = []
    for least, most, *seen in certificate["slips"][wheel]:
        require(least <= most and seen[0] <= seen[1] < 1, f"slips of the {wheel} wheel cross")
        pairs += product((least, most), seen)
    if "measured" in certificate:
        constant, share = certificate["measured"][wheel]
        require(min(constant, share) >= 0, "slips are measured within less than nothing")
        ends = [slip for least, most, *_ in certificate["slips"][wheel] for slip in (least, most)]
        errors = [constant + share * abs(slip) for slip in ends]
        pairs = [
            (slip, slip + sign * error)
            for slip, error in zip(ends, errors, strict=True)
            for sign in (1, -1)
        ]
    require(all(seen < 1 for _, seen in pairs), f"the {wheel} wheel is said to slip in full")
    return pairs


def cut(low, high, *places):
    """Return the stretches into which places cut a range."""
    ends = sorted({low, high, *(min(max(place, low), high) for place in places)})
    return list(pairwise(ends)) or [(low, high)]


def list_speeds(region):
    """Return pieces of a region of wheel speeds, and its corners (right, left). A piece has ranges
    of both speeds; or of their mean and of parts of half their difference, part (reach + slope
    mean), with reach and slope."""
    if len(region) == 2:
        right, left = region
        return [((right, right), (left, left), None, None)], [(right, left)]
    lowest, highest, slowest, fastest = region
    require(lowest <= slowest <= fastest <= highest, "the speeds of a region are not in order")
    stretches = []
    corners = set()
    for low, high in cut(slowest, fastest, (lowest + highest) / 2):
        slope = 1 if low + high <= lowest + highest else -1
        stretches.append(((low, high), (-1, 1), -lowest if slope > 0 else highest, slope))
        for mean, sign in product((low, high), (1, -1)):
            half = sign * min(mean - lowest, highest - mean)
            corners.add((mean + half, mean - half))
    if (lowest, highest) == (slowest, fastest):
        stretches = [((lowest, highest), (lowest, highest), None, None)]
    return stretches, sorted(corners)


def is_within(speeds, region):
    """Return whether a pair of wheel speeds lies in a region."""
    if len(region) == 2:
        return speeds == region
    lowest, highest, slowest, fastest = region
    is_mean = slowest <= sum(speeds) / 2 <= fastest
    return lowest <= min(speeds) and max(speeds) <= highest and is_mean


def stretch(angle):
    """Return tan(x)/x, by which loops stretch wheel speeds."""
    x = scale(angle)
    return multiply(C.value(x), invert(COSINE.value(x)))


def list_loops(certificate, band):
    """Return loops whose mixtures are those of a band, and its gains at the corners of speeds."""
    T, b, _ = pick(certificate, "period", "track", "lever_arm")
    k1, k2, k3 = band["gains"]
    loops = []
    gains = []
    for region in band["regions"]:
        _, corners = list_speeds(region)
        gains += [((-k1, -(right - left) / b, 0), (0, -k2, -k3)) for right, left in corners]
        angles = [T * (right - left) / (2 * b) for right, left in corners]
        least = 0 if min(angles) <= 0 <= max(angles) else min(map(abs, angles))
        most = max(map(abs, angles))
        ratios = (read_units(stretch(least)[0]), read_units(stretch(most)[1]))
        for (right, left), t in product(corners, ratios):
            h = t * T * (right - left) / (2 * b)
            c = t * T * (right + left) / 2
            turned = (-h * (2 - T * k1), 1 - c * T * k2 / 2, c * (1 - T * k3 / 2))
            loops.append(((1 - T * k1, 0, 0), turned, (0, -T * k2, 1 - T * k3)))
    return list(dict.fromkeys(loops)), list(dict.fromkeys(gains))


def is_lasting(certificate, band):
    """Return whether periods of a band may come at any time: of slips that are learnt those where
    an observer looks back as far as it will."""
    return "learning" not in certificate or band["age"] == certificate["learning"]["periods"]


def list_targets(certificate, band):
    """Return by name what the set of a band is to lie in, as rows e <= offsets, intervals and
    units: the caps, and what loops and W lead into the sets that may follow."""
    loops, gains = list_loops(certificate, band)
    errors = scale_all(band["errors"])
    caps = [(axis, errors[index // 2][0]) for index, axis in enumerate(AXES)]
    inputs = list_inputs(band)
    for (on_u, on_e, *ends), gain, sign in product(inputs, map(scale_all, gains), (-1, 1)):
        row = negate_if(sign, map(add, times(on_u, gain), on_e))
        caps.append((row, scale(sign * ends[sign > 0])[0]))
    targets = {"caps": caps}
    followers = [other for other in certificate["bands"] if is_lasting(certificate, other)]
    for into in sorted({other["set"] for other in followers}):
        shape = certificate["sets"][into]
        rows = zip(scale_all(shape["rows"]), scale_all(shape["offsets"]), strict=True)
        limits = [(row, offset[0] - reach(band, row)) for row, offset in rows]
        pairs = product(limits, map(scale_all, loops))
        targets[into] = [(times(row, loop), limit) for (row, limit), loop in pairs]
    return targets


def check_sets(certificate, band, shape):
    """Prove where the set of a band lies and is led to; return the room of every inclusion, in
    units."""
    name = band["name"]
    proofs = {(each["loop"], each["into"]): each for each in certificate["inclusions"]}
    room = []
    for into, wanted in list_targets(certificate, band).items():
        proof = proofs.get((name, into), {"set": None, "multipliers": ()})
        is_whole = proof["set"] == band["set"] and len(proof["multipliers"]) == len(wanted)
        require(is_whole, f"no proof that the set of {name} leads into {into}")
        for (row, limit), multipliers in zip(wanted, proof["multipliers"], strict=True):
            room.append(limit - shape.bound(row, multipliers))
            missed = -room[-1] / ONE
            require(missed <= 0, f"the set of {name} may leave {into} by {missed:.3g}")
    return room


def check_cost(certificate, pairs):
    """Prove that the terminal cost decreases by at least the cost of a stage, whatever mixture of
    pairs of a loop and its gain acts."""
    P, Q, R = pick(certificate["cost"], *"PQR")
    is_cost = all(map(is_semidefinite, (P, Q, R))) and R[0][0] * R[1][1] > R[0][1] * R[1][0]
    require(is_cost, "a cost may be negative, or inputs may cost nothing")
    for loop, gain in pairs:
        terms = zip(P, weight(P, loop), Q, weight(R, gain), strict=True)
        left = [[p - a - q - r for p, a, q, r in zip(*rows, strict=True)] for rows in terms]
        require(is_semidefinite(left), "the terminal cost may decrease by less than a stage costs")


def weight(matrix, by):
    """Return by' matrix by, of fractions."""
    columns = list(zip(*by, strict=True))
    made = [[sum(map(mul, row, column)) for column in columns] for row in matrix]
    return [[sum(map(mul, left, column)) for column in zip(*made, strict=True)] for left in columns]


def is_semidefinite(matrix):
    """Return whether a symmetric matrix has no negative pivot."""
    require([list(row) for row in zip(*matrix, strict=True)] == matrix, "a cost is not symmetric")
    while matrix:
        (pivot, *row), *others = matrix
        if pivot < 0 or (pivot == 0 and any(row)):
            return False
        share = [entry / pivot if pivot else 0 for entry in row]
        matrix = [[b - a * c for b, c in zip(rest, share, strict=True)] for a, *rest in others]
    return True
