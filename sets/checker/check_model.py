"""A linear model that is not the motion's Jacobian, and gains that are mixed from those at the
corners of the wheel speeds; part of `check_certificate`, of the standard library alone.

With the shares f_r, f_l of the wheels' speeds that count in the yaw rate, b Om = f_r V_r - f_l V_l
and V = (V_r + V_l)/2, the model is

    e+ = M e + B u + w,    M = [1, T Om, 0; -T Om, 1, T V; 0, 0, 1],    B = [T, 0; 0, 0; 0, T].

A gain K or G of a region, right speeds from a to a', left ones from c to c', is given at (a, c),
(a, c'), (a', c), (a', c') and mixed by the shares of either way. M is affine in the speeds and B
constant, so that (M + B G, G) is a mixture of those at the corners by the same shares. Plans are
corrected by K and ended by G. That w lies in W is assumed, but where a certificate proves it.
"""

from fractions import Fraction
from itertools import product
from operator import add, mul

from check_intervals import pick, require
from check_sets import is_within, list_slips


def find_pair(certificate, right, left):
    """Return M and B at wheel speeds."""
    T = certificate["period"]
    of_right, of_left = certificate["model"]["turning"]
    turn = T * (of_right * right - of_left * left) / certificate["track"]
    M = ((1, turn, 0), (-turn, 1, T * (right + left) / 2), (0, 0, 1))
    return M, ((T, 0), (0, 0), (0, T))


def list_corners(region):
    """Return the ends of the right and of the left wheel speeds of a region."""
    if len(region) == 2:
        return [(speed, speed) for speed in region]
    lowest, highest, slowest, fastest = region
    require((lowest, highest) == (slowest, fastest), "gains are mixed over all of a region")
    return [(lowest, highest)] * 2


def mix_gains(band, name, speeds):
    """Return K or G at wheel speeds."""
    pairs = zip(band["regions"], band["gains"], strict=True)
    region, gains = next(pair for pair in pairs if is_within(speeds, pair[0]))
    shares = []
    for speed, (low, high) in zip(speeds, list_corners(region), strict=True):
        share = (speed - low) / (high - low) if low < high else Fraction(0)
        shares.append((1 - share, share))
    weights = [a * b for a, b in product(*shares)]
    parts = [zip(*rows, strict=True) for rows in zip(*gains[name], strict=True)]
    return [[sum(map(mul, weights, entries)) for entries in row] for row in parts]


def check_wheels(certificate, band):
    """Prove that inputs within their limits ask no wheel for more than it can do, and say so: the
    right one is asked for V_r - u1 - (b/2) u2 over ground, the left one for V_l - u1 + (b/2) u2."""
    slowest, fastest = certificate["wheel_speeds"]
    half = certificate["track"] / 2
    for index, wheel in enumerate(("right", "left")):
        on_u2, low, high = pick(band["inputs"][index], "on_u2", "low", "high")
        require(on_u2 == (half, -half)[index], f"a row on inputs is not that of the {wheel} wheel")
        grips = [1 - seen for _, seen in list_slips(certificate, wheel)]
        for region in band["regions"]:
            least, most = list_corners(region)[index]
            is_able = most - low <= min(grip * fastest for grip in grips)
            is_able &= least - high >= max(grip * slowest for grip in grips)
            require(is_able, f"the {wheel} wheel may be asked for more than it can do")
    return "wheels can do what is asked of them"


def list_ends(certificate, band):
    """Return the loops M + B G, with G, at the corners."""
    pairs = []
    for region, gains in zip(band["regions"], band["gains"], strict=True):
        for speeds, G in zip(product(*list_corners(region)), gains["G"], strict=True):
            M, B = find_pair(certificate, *speeds)
            made = [[sum(map(mul, on_u, column)) for column in zip(*G, strict=True)] for on_u in B]
            loop = [list(map(add, *rows)) for rows in zip(M, made, strict=True)]
            pairs.append((loop, G))
    return pairs
