"""That there is always a plan: the QPs of a certificate, row by row as they run; part of
`check_certificate`, of the standard library alone.

A plan (g_0 .. g_(N-1)) from a measured error e_0 predicts e_(j+1) = M_j e_j + B_j g_j, with the
model at the wheel speeds ahead, and keeps rows, D and C those of the band that period j is in

    low <= c e_j <= high,  0 < j < N        low <= D g_j + C e_j <= high,  j < N        H e_N <= t.

The first input acts, w in the W of its band disturbs, and the next error is e_1 + w. The next plan
that is proved to be one is this plan shifted, corrected by the K of its bands for what w did, and
ended by a law:

    e'_j = e_(j+1) + Phi_j .. Phi_1 w        g'_j = g_(j+1) + K_(j+1) (e'_j - e_(j+1))

and g'_(N-1) = K' e'_(N-1) at the speeds of the next plan's last period, or G' e'_(N-1) where
another law ends plans. Every row of it is bounded by what a plan may reach of the same row a period
later, and W; at the end by multipliers on the terminal rows, and W. A plan may reach of a row its
bound, the solver's tolerance and the difference between the row as it runs and as the model
predicts it; it is accepted up to the bound less that difference.

Source: Chisci, Rossiter, Zappa 2001; Higham 2002, lemma 3.1, for the rounding of inner products.
"""

from itertools import pairwise, product
from typing import NamedTuple

from check_intervals import (
    COSINE,
    SINE,
    ZERO,
    C,
    add,
    invert,
    multiply,
    pick,
    read_index,
    require,
    scale,
    scale_all,
    size,
    subtract,
    times,
)
from check_model import find_pair, mix_gains
from check_sets import (
    AXES,
    Set,
    find_greatest,
    find_input_sizes,
    is_within,
    list_inputs,
    negate_if,
    reach,
)

ROUNDING = 53  # bits of an operation in 64 bits


class Stage(NamedTuple):
    """A period of a plan: M, B, the K that corrects it with Phi = M + B K, and the same of the law
    that ends it; intervals."""

    M: list
    B: list
    K: list
    Phi: list
    end_K: list
    end_Phi: list


def make_stage(certificate, band, right, left):
    """Return a period at wheel speeds."""
    if "model" in certificate:
        M, B = map(scale_all, find_pair(certificate, right, left))
        gains = [scale_all(mix_gains(band, name, [right, left])) for name in ("K", "G")]
    else:
        M, B = find_jacobian(certificate, right, left)
        k1, k2, k3 = band["gains"]
        gains = [scale_all(((-k1, (left - right) / certificate["track"], 0), (0, -k2, -k3)))] * 2
    closed = []
    for K in gains:
        pairs = zip(M, B, strict=True)
        closed += [K, [list(map(add, row, times(on_u, K))) for row, on_u in pairs]]
    return Stage(M, B, *closed)


def find_jacobian(certificate, right, left):
    """Return M and B of the motion's Jacobian at wheel speeds."""
    T = certificate["period"]
    turn = T * (right - left) / certificate["track"]
    half = scale(turn / 2)
    secant = invert(COSINE.value(half))
    h = multiply(SINE.value(half), secant)
    c = multiply(multiply(C.value(half), scale(T * (right + left) / 2)), secant)
    turned = subtract(scale(1), multiply(h, scale(turn)))
    M = [scale_all((1, turn, 0)), [multiply(h, scale(-2)), turned, c], scale_all((0, 0, 1))]
    B = [scale_all((T, 0)), [multiply(h, scale(-T)), multiply(c, scale(T / 2))], scale_all((0, T))]
    return M, B


class Window:
    """A QP: its stages with their bands, and by row (kind, stage, number, sign) what a plan may
    reach of it at most, and up to what it is accepted, in units."""

    def __init__(self, certificate, window):
        plans = certificate["plans"]
        bands = {band["name"]: band for band in certificate["bands"]}
        require(plans["tolerance"] >= 0, "a tolerance is negative")
        self.terminal = scale_all(plans["terminal"]["rows"])
        self.speeds = window["speeds"]
        self.bands = pick(bands, *window["bands"])
        self.stages = []
        for band, speeds in zip(self.bands, self.speeds, strict=True):
            is_in = any(is_within(speeds, region) for region in band["regions"])
            require(is_in, f"a window leaves {band['name']}")
            self.stages.append(make_stage(certificate, band, *speeds))
        self.reached = {}
        self.accepted = {}
        columns = (window[name] for name in ("rows", "norms", "lower", "upper"))
        for name, entries, norm, *ends in zip(plans["order"], *columns, strict=True):
            row = (name[0], read_index(name[1]), read_index(name[2]))
            require(norm > 0, f"row {row} has no length")
            self.read_row(row, scale_all(entries), scale(norm), ends, scale(plans["tolerance"]))
        self.check_rows()

    def read_row(self, row, entries, norm, ends, tolerance):
        """Note what a row as it runs says of the row that the model predicts. They differ by
        rounding alone, so that what they bound stays within twice the caps."""
        caps = [cap for band in self.bands for cap in find_input_sizes(band)]
        box = [scale(2 * end) for end in (*self.bands[0]["errors"], *caps)]
        own = [*entries[:3], *(multiply(norm, entry) for entry in entries[3:])]
        kind, j, i = row
        on_u, on_e = self.find_row(kind, j, i)
        predicted = self.predict(on_u, on_e, j)
        differs = [subtract(*pair) for pair in zip(predicted, own, strict=True)]
        for sign, end in zip((-1, 1), ends, strict=True):
            if end is not None:
                spread = find_greatest(own, box) + size(scale(end))
                rounded = -(-(len(box) + 6) * 2 * spread >> ROUNDING)
                slack = find_greatest(differs, box) + rounded
                key = (*row, sign)
                require(key not in self.reached, f"row {key} is there twice")
                low, high = scale(sign * end)
                self.reached[key] = high + multiply(norm, tolerance)[1] + slack
                self.accepted[key] = low - slack

    def find_row(self, kind, j, i):
        """Return D and C of a row D g_j + C e_j."""
        if kind == "inputs":
            return list_inputs(self.bands[j])[i][:2]
        return scale_all((0, 0)), (self.terminal if kind == "terminal" else AXES[::2])[i]

    def check_rows(self):
        """Require every row, and that inputs keep the caps of their bands: as they would keep twice
        the caps if what they keep there were true of twice the caps, no larger input is left."""
        N = len(self.stages)
        caps = {}
        for j, band in enumerate(self.bands):
            for i, (_, _, low, high) in enumerate(list_inputs(band)):
                caps |= {("inputs", j, i, 1): scale(high)[0], ("inputs", j, i, -1): scale(-low)[0]}
        wanted = {*caps, *product(["errors"], range(1, N), range(3), (1, -1))}
        wanted |= {*product(["terminal"], [N], range(len(self.terminal)), [1])}
        require(set(self.reached) == wanted, "a QP lacks a row, or has one too many")
        is_kept = all(self.reached[key] <= cap for key, cap in caps.items())
        require(is_kept, "an input may pass its cap")
        is_near = all(self.reached[key] - self.accepted[key] <= cap for key, cap in caps.items())
        require(is_near, "a row on inputs differs from what the model predicts")

    def predict(self, on_u, row, j):
        """Return the row on the first error and the inputs that is on_u g_j + row e_j."""
        inputs = [on_u if stage == j else (ZERO, ZERO) for stage in range(len(self.stages))]
        for stage in reversed(range(j)):
            inputs[stage] = times(row, self.stages[stage].B)
            row = times(row, self.stages[stage].M)
        return [*row, *(entry for pair in inputs for entry in pair)]


def list_successions(certificate):
    """Yield what a plan has to keep a period later: between which windows, which row, on what of
    the plan and up to which bound; and the bound that the plan keeps of it, or None at its end,
    where the set of its terminal rows has to prove it."""
    plans = certificate["plans"]
    windows = [Window(certificate, window) for window in plans["windows"]]
    N = len(windows[0].stages)
    require(all(len(window.stages) == N for window in windows), "windows differ in length")
    sequence = [read_index(number) for number in plans["sequence"]]
    # The last period ends in an error within the caps, too, but in no plan.
    for now, after in [*sorted(set(pairwise(sequence))), (sequence[-1], None)]:
        window = windows[now]
        following = window if after is None else windows[after]
        is_next = window.speeds[1:] == following.speeds[:-1]
        is_next &= window.bands[1:] == following.bands[:-1]
        require(is_next or after is None, "windows do not follow each other")
        wanted = {} if after is None else following.accepted
        ends = [(window.reached["terminal", N, i, 1],) * 2 for i in range(len(window.terminal))]
        end_set = Set(window.terminal, ends, plans["terminal"]["extents"])
        errors = scale_all(following.bands[0]["errors"])
        caps = {("errors", 0, i, s): errors[i][0] for i in range(3) for s in (1, -1)}
        for key, accepted in sorted({**wanted, **caps}.items()):
            kind, j, i, sign = key
            on_u, on_e = following.find_row(kind, j, i)
            reached = window.reached.get((kind, j + 1, i, sign))
            K = following.stages[-1].end_K if reached is None else window.stages[j + 1].K
            row = negate_if(sign, map(add, times(on_u, K), on_e))
            row = times(row, following.stages[-1].end_Phi) if kind == "terminal" else row
            disturbed = row
            for each in reversed(window.stages[1 : min(j, N - 1) + 1]):
                disturbed = times(disturbed, each.Phi)
            room = accepted - reach(window.bands[0], disturbed)
            yield f"{now} to {after}", f"{kind} {j} {i} {sign}", row, room, reached, end_set


def check_plans(certificate):
    """Prove that plans stay plans; return the room of every row, in units."""
    proofs = certificate["plans"]["ends"]
    rooms = []
    for pair, key, row, room, reached, end_set in list_successions(certificate):
        if reached is None:
            reached = end_set.bound(row, proofs[pair][key])
        rooms.append(room - reached)
        require(rooms[-1] >= 0, f"from window {pair} the row {key} may be missed")
    return rooms
