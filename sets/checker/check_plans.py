"""That there is always a plan: the QPs of a certificate, row by row as they run; part of
`check_certificate`, of the standard library alone.

A plan (g_0 .. g_(N-1)) from a measured error e_0 predicts e_(j+1) = M_j e_j + B_j g_j, with the
model at the wheel speeds ahead, and keeps rows, D and C those of the band that period j is in

    low <= c e_j <= high,  0 < j < N        low <= D g_j + C e_j <= high,  j < N        H e_N <= t.

The first input acts, w in the W of its band disturbs, and the next error is e_1 + w. The next plan
that is proved to be one is this plan shifted, corrected by the K of its bands for what w did, and
ended by K:

    e'_j = e_(j+1) + Phi_j .. Phi_1 w        g'_j = g_(j+1) + K_(j+1) (e'_j - e_(j+1))

and g'_(N-1) = K' e'_(N-1) at the speeds of the next plan's last period. Every row of it is bounded
by what a plan may reach of the same row a period later, and W; at the end by multipliers on the
terminal rows, and W. A plan may reach of a row its bound, the solver's tolerance and the difference
between the row as it runs and as the model predicts it; it is accepted up to the bound less that
difference.

Source: Chisci, Rossiter, Zappa 2001; Higham 2002, lemma 3.1, for the rounding of inner products.
"""

from fractions import Fraction
from itertools import pairwise, product

from check_motion import COSINE, ONE, SINE, C, Number, apply, require, scale

AXES = [[sign * (k == axis) for k in range(3)] for axis in range(3) for sign in (1, -1)]
UNIT = [[Fraction(k == axis) for k in range(3)] for axis in range(3)]
ROUNDING = Fraction(1, 2**53)  # of an operation in 64 bits, relative


def pick(table, *names):
    """Return the entries of these names."""
    return [table[name] for name in names]


def read_index(number):
    """Return a number that counts."""
    require(number >= 0 and number == int(number), f"{number} counts nothing")
    return int(number)


def dot(left, right):
    """Return the sum of products."""
    return sum(a * b for a, b in zip(left, right, strict=True))


def times(row, matrix):
    """Return row @ matrix."""
    return [dot(row, column) for column in zip(*matrix, strict=True)]


def size(value):
    """Return the greatest magnitude of a number."""
    return Fraction(max(-value.low, value.high), ONE) if isinstance(value, Number) else abs(value)


def reach(band, row):
    """Return the greatest product of a row and a disturbance in W."""
    yaw, lean, box = pick(band["disturbance"], "yaw", "lean", "box")
    return yaw * size(row[1] * lean + row[2]) + dot(box, map(size, row))


def weigh(rows, offsets, row, multipliers):
    """Return what multipliers prove of row e where rows e <= offsets, and what they leave of it."""
    used = {int(index): weight for index, weight in multipliers.items()}
    require(all(weight >= 0 for weight in used.values()), "a multiplier is negative")
    made = [dot(used.values(), (rows[index][k] for index in used)) for k in range(3)]
    left = [size(wanted - entry) for wanted, entry in zip(row, made, strict=True)]
    return dot(used.values(), (offsets[index] for index in used)), left


def find_extents(rows, offsets, extents):
    """Return the greatest |x|, |y|, |th| in a set. With R the greatest that multipliers prove and r
    what they leave of a row, the greatest M is at most R + 3 r M, hence below 2 R."""
    pairs = zip(AXES, extents, strict=True)
    proved = [weigh(rows, offsets, *pair) for pair in pairs]
    left = max(max(parts) for _, parts in proved)
    require(6 * left <= 1, "a set is not bounded by its multipliers")
    most = [value + 6 * left * max(value for value, _ in proved) for value, _ in proved]
    return [max(most[index], most[index + 1]) for index in (0, 2, 4)]


def list_inputs(band):
    """Return rows D, C and ends of low <= D u + C e <= high: the caps of inputs, coupled with x."""
    of_x, of_turn = band["coupling"]
    alone = [((1, 0), (0, 0, 0), *band["u1"]), ((0, 1), (0, 0, 0), *band["u2"])]
    coupled = [((0, sign * of_turn), (of_x, 0, 0), -1, 1) for sign in (1, -1)]
    return alone + coupled if of_turn else alone


def make_stage(certificate, band, right, left):
    """Return M, B, K and Phi at wheel speeds."""
    T = certificate["period"]
    k1, k2, k3 = band["gains"]
    rate = (right - left) / certificate["track"]
    half = Number(*scale(T * rate / 2))
    secant = apply(COSINE, half).inverse()
    h = apply(SINE, half) * secant
    c = apply(C, half) * (T * (right + left) / 2) * secant
    M = ((1, T * rate, 0), (h * -2, h * (-T * rate) + 1, c), (0, 0, 1))
    B = ((T, 0), (h * -T, c * (T / 2)), (0, T))
    K = ((-k1, -rate, 0), (0, -k2, -k3))
    pairs = zip(M, B, strict=True)
    Phi = [[m + a for m, a in zip(row, times(u, K), strict=True)] for row, u in pairs]
    return M, B, K, Phi


def is_within(speeds, region):
    """Return whether a pair of wheel speeds lies in a region."""
    if len(region) == 2:
        return speeds == region
    lowest, highest, slowest, fastest = region
    is_mean = slowest <= sum(speeds) / 2 <= fastest
    return lowest <= min(speeds) and max(speeds) <= highest and is_mean


def stretch(angle):
    """Return tan(x)/x, by which loops stretch wheel speeds."""
    x = Number(*scale(angle))
    return apply(C, x) * apply(COSINE, x).inverse()


class Window:
    """A QP: its stages with their bands, and by row (kind, stage, number, sign) what a plan may
    reach of it at most, and up to what it is accepted."""

    def __init__(self, certificate, window):
        plans = certificate["plans"]
        bands = {band["name"]: band for band in certificate["bands"]}
        require(plans["tolerance"] >= 0, "a tolerance is negative")
        self.terminal = plans["terminal"]["rows"]
        self.speeds = window["speeds"]
        self.bands = pick(bands, *window["bands"])
        self.stages = []
        for band, speeds in zip(self.bands, self.speeds, strict=True):
            is_in = any(is_within(speeds, region) for region in band["regions"])
            require(is_in, f"a window leaves {band['name']}")
            self.stages.append(make_stage(certificate, band, *speeds))
        self.reached = {}
        self.accepted = {}
        # Rows differ by rounding alone, so that what they bound stays within twice the caps.
        caps = [max(map(abs, band[name])) for band in self.bands for name in ("u1", "u2")]
        box = [2 * end for end in (*self.bands[0]["errors"], *caps)]
        columns = (window[name] for name in ("rows", "norms", "lower", "upper"))
        for name, entries, norm, *ends in zip(plans["order"], *columns, strict=True):
            kind = name[0]
            j = read_index(name[1])
            i = read_index(name[2])
            predicted = self.predict(*self.find_row(kind, j, i), j)
            own = [*entries[:3], *(norm * entry for entry in entries[3:])]
            differs = [size(a - b) for a, b in zip(predicted, own, strict=True)]
            for sign, end in zip((-1, 1), ends, strict=True):
                if end is not None:
                    spread = dot(map(abs, own), box) + abs(end)
                    slack = dot(differs, box) + (len(box) + 6) * 2 * ROUNDING * spread
                    key = (kind, j, i, sign)
                    require(key not in self.reached and norm > 0, f"row {key} is there twice")
                    self.reached[key] = sign * end + norm * plans["tolerance"] + slack
                    self.accepted[key] = sign * end - slack
        self.check_rows()

    def find_row(self, kind, j, i):
        """Return D and C of a row D g_j + C e_j."""
        if kind == "inputs":
            return list_inputs(self.bands[j])[i][:2]
        rows = self.terminal if kind == "terminal" else UNIT
        return (0, 0), rows[i]

    def check_rows(self):
        """Require every row, and that inputs keep the caps of their bands."""
        N = len(self.stages)
        caps = {}
        for j, band in enumerate(self.bands):
            for i, (_, _, low, high) in enumerate(list_inputs(band)):
                caps |= {("inputs", j, i, 1): high, ("inputs", j, i, -1): -low}
        wanted = {*caps, *product(["errors"], range(1, N), range(3), (1, -1))}
        wanted |= {*product(["terminal"], [N], range(len(self.terminal)), [1])}
        require(set(self.reached) == wanted, "a QP lacks a row, or has one too many")
        is_kept = all(self.reached[key] <= cap for key, cap in caps.items())
        require(is_kept, "an input may pass its cap")

    def predict(self, on_u, row, j):
        """Return the row on the first error and the inputs that is on_u g_j + row e_j."""
        Number.made.clear()
        inputs = [on_u if stage == j else (0, 0) for stage in range(len(self.stages))]
        for stage in reversed(range(j)):
            M, B, *_ = self.stages[stage]
            inputs[stage] = times(row, B)
            row = times(row, M)
        return [*row, *(entry for pair in inputs for entry in pair)]


def list_successions(certificate):
    """Yield what a plan has to keep a period later: between which windows, which row, on what of
    the plan and up to which bound; and the bound that the plan keeps of it, or None at its end,
    where the terminal rows with their bounds have to prove it."""
    plans = certificate["plans"]
    windows = [Window(certificate, window) for window in plans["windows"]]
    N = len(windows[0].stages)
    require(all(len(window.stages) == N for window in windows), "windows differ in length")
    for now, after in sorted(set(pairwise(map(read_index, plans["sequence"])))):
        window = windows[now]
        following = windows[after]
        is_next = window.speeds[1:] == following.speeds[:-1]
        is_next &= window.bands[1:] == following.bands[:-1]
        require(is_next, "windows do not follow each other")
        ends = [window.reached["terminal", N, i, 1] for i in range(len(window.terminal))]
        errors = following.bands[0]["errors"]
        caps = {("errors", 0, i, s): errors[i] for i in range(3) for s in (1, -1)}
        for key, accepted in sorted({**following.accepted, **caps}.items()):
            kind, j, i, sign = key
            on_u, on_e = following.find_row(kind, j, i)
            reached = window.reached.get((kind, j + 1, i, sign))
            stage = window.stages[j + 1] if reached is not None else following.stages[-1]
            row = [sign * (a + c) for a, c in zip(times(on_u, stage[2]), on_e, strict=True)]
            row = times(row, stage[3]) if kind == "terminal" else row
            disturbed = row
            for each in reversed(window.stages[1 : min(j, N - 1) + 1]):
                disturbed = times(disturbed, each[3])
            room = accepted - reach(window.bands[0], disturbed)
            yield f"{now} to {after}", f"{kind} {j} {i} {sign}", row, room, reached, ends


def check_plans(certificate):
    """Prove that plans stay plans; return the room of every row."""
    plans = certificate["plans"]
    rows, extents = pick(plans["terminal"], "rows", "extents")
    rooms = []
    for pair, key, row, room, reached, ends in list_successions(certificate):
        if reached is None:
            reached, left = weigh(rows, ends, row, plans["ends"][pair][key])
            reached += dot(left, find_extents(rows, ends, extents))
        rooms.append(room - reached)
        require(rooms[-1] >= 0, f"from window {pair} the row {key} may be missed")
    return rooms


def check_cost(certificate, loops, gains):
    """Prove that the terminal cost decreases by at least the cost of a stage."""
    P, Q, R = pick(certificate["cost"], *"PQR")
    for loop, gain in product(loops, gains):
        terms = zip(P, weight(P, loop), Q, weight(R, gain), strict=True)
        left = [[p - a - q - r for p, a, q, r in zip(*rows, strict=True)] for rows in terms]
        require(is_semidefinite(left), "the terminal cost may decrease by less than a stage costs")


def weight(matrix, by):
    """Return by' matrix by."""
    columns = list(zip(*by, strict=True))
    return [[dot(times(left, matrix), right) for right in columns] for left in columns]


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
