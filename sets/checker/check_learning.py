"""Slips that are learnt on line: how far the slip that is compensated is from the true one at most;
part of `check_certificate`, of the standard library alone.

Over a period T a wheel that runs at v and slips by i travels T v (1 - i) over ground. A body that
drives an arc of length s, turns by phi = 2 h, and may slide sideways at a constant speed meanwhile,
has wheels that travel s + (b/2) phi (right) and s - (b/2) phi (left), and moves by s C(h) along the
direction that lies halfway in its turn. With the errors e before and e' after, and the reference as
in `check_motion`, the sum of ways along this direction says that exactly

    s = k(h) X + h Y + l r(h) cos m,    k = h cot h, r = h / sin h, l = L C(A/2), m = (th + th')/2,

X = x - x', Y = y + y', phi = th - th' + A. The controller works this out from errors that are
measured within n of the true ones. Over N periods it knows the travel of a wheel within

    E_N = sum over N + 1 instants of |slopes of the travel by the error measured then| n
          + sum over N periods of  |h| (0.7 |X| + 0.36 l) n_th + (0.7 n_x + 2 n_y) n_th
                                   + (0.375 (|X| + 2 n_x) + 0.905 l) n_th^2,

where slopes of s by h count Y alone, those by X, Y and m are k, h and - l r sin m. The second line
bounds what k' X + l r' cos m and second derivatives add (Taylor), as for |h| + n_th <= 1/2

    |k'| <= 0.7 |h| <= 0.35,  |k''| <= 0.75,  r <= 1.05,  |r'| <= 0.36 |h| <= 0.18,  |r''| <= 0.4,

which is proved here. The travel of the N periods is sum R_j (1 - i_j), R_j = T v_j known. The slip
of the period that begins differs by at most c j from that of the j-th period back, so it lies
within (E_N + c sum j R_j) / sum R_j of 1 - travel / sum R_j. The interval of a wheel is where all
windows of 1, 2 .. periods and the interval given agree; 1e-9 is added for rounding. It holds the
true slip, and the controller compensates its centre. How wide it is at most is bounded by the
greatest of all slopes, and by the least and greatest travels: for a window, the quotient is
largest where the oldest travels are the greatest and the others the least possible.

Source: bounded sets of estimates go back to Schweppe 1968.
"""

from fractions import Fraction

from check_intervals import (
    COSINE,
    ONE,
    SINE,
    C,
    add,
    add_up,
    invert,
    multiply,
    pick,
    read_index,
    read_units,
    require,
    scale,
    subtract,
)
from check_sets import list_speeds

CELLS = 64  # of 0 <= h <= 1/2
ROUNDING = Fraction(1, 10**9)
MOST_HALF_TURN = Fraction(1, 2)


def check_derivatives():
    """Prove the bounds on the derivatives of k and r. Where k'' < 0 < r'', k and -r fall; k' and r'
    are sums of second derivatives over cells."""
    low = ONE // (2 * CELLS)
    of_k = 0
    of_r = 0
    for cell in range(CELLS):
        ends = (cell * low, (cell + 1) * low)
        bent_k, bent_r = bend(ends)
        require(4 * bent_k[0] >= -3 * ONE and bent_k[1] < 0, "k'' is not as it is said to be")
        require(bent_r[0] > 0 and 5 * bent_r[1] <= 2 * ONE, "r'' is not as it is said to be")
        of_k += -bent_k[0]
        of_r += bent_r[1]
        # In units of a cell. Linear in between, so that ends are enough.
        require(10 * of_k <= 7 * ONE * (cell + 1), "k' is not as it is said to be")
        require(100 * of_r <= 36 * ONE * (cell + 1), "r' is not as it is said to be")
    require(100 * invert(C.value((ONE // 2, ONE // 2)))[1] <= 105 * ONE, "r passes 1.05")


def bend(h):
    """Return the second derivatives of k = r cos and of r = 1/C over an interval of h."""
    slope = add_up(C.tables[1], h)
    r = invert(C.value(h))
    squared = multiply(r, r)
    twice = multiply(multiply(slope, slope), r)
    of_r = multiply(subtract(add(twice, twice), add_up(C.tables[2], h)), squared)
    turning = multiply(SINE.value(h), multiply(slope, squared))
    of_k = multiply(COSINE.value(h), subtract(of_r, r))
    return add(of_k, add(turning, turning)), of_r


def find_share(slip, radius):
    """Return |i - i_m| / (1 - i_m) at most: i_m is the centre of an interval, radius half its
    width at most, below the greatest slip."""
    return radius / (1 - slip + radius)


def bound_noise(certificate):
    """Return E_N at most over all that is certified, of N = 1, 2 .. periods."""
    T, b = pick(certificate, "period", "track")
    bands = certificate["bands"]
    E_x, E_y, E_th = map(max, zip(*(band["errors"] for band in bands), strict=True))
    n_x, n_y, n_th = certificate["noise"]
    regions = [region for band in bands for region in band["regions"]]
    corners = [corner for region in regions for corner in list_speeds(region)[1]]
    chord = T * max(abs(right + left) for right, left in corners) / 2
    turn = T * max(abs(right - left) for right, left in corners) / b
    turn += T * max(abs(end) for band in bands for end in band["u2"])
    for wheel, (_, fastest) in certificate["learning"]["speeds"].items():
        least, most = certificate["slips"][wheel][0][:2]
        turn += T / b * fastest * find_share(most, (most - least) / 2)
    H = turn / 2 + n_th
    require(H + n_th <= MOST_HALF_TURN, "a period may turn too far for its slips to be learnt")
    r = invert(C.value(scale(H)))
    k = read_units(multiply(COSINE.value(scale(H)), r)[0])
    swing = chord * read_units(multiply(SINE.value(scale(E_th)), r)[1])
    # At the first and the last instant, and in between, where most of it is taken back.
    at_ends = 2 * (n_x + n_y * H + n_th * (b / 2 + E_y + swing / 2))
    inside = n_x * (1 - k) + 2 * n_y * H + n_th * (E_y + swing)
    rest = n_th * (H * (Fraction(7, 5) * E_x + Fraction(9, 25) * chord))
    rest += n_th * (Fraction(7, 10) * n_x + 2 * n_y)
    rest += n_th**2 * (Fraction(3, 4) * (E_x + n_x) + Fraction(181, 200) * chord)
    periods = read_index(certificate["learning"]["periods"])
    return [at_ends + (N - 1) * inside + N * rest for N in range(1, periods + 1)]


def find_reach(noise, change, ways):
    """Return how far a slip is from the mean of a window at most, by the (least, greatest) ways of
    its periods, the last one first. A quotient of sums whose terms grow with age is largest where
    the oldest ways are the greatest."""
    worst = 0
    for newest in range(len(ways) + 1):
        rolled = [most if back >= newest else least for back, (least, most) in enumerate(ways)]
        drift = change * sum((back + 1) * way for back, way in enumerate(rolled))
        worst = max(worst, (noise + drift) / sum(rolled))
    return worst


def bound_wheel(learning, noise, period, slips, speeds):
    """Return |d| of a wheel at most, by the periods that its slip has been learnt."""
    least, most = slips
    slowest = period * speeds[0]
    fastest = period * speeds[1]
    rolled = (slowest / (1 - least), fastest / (1 - most))
    change = learning["change"]
    radius = [(most - least) / 2]
    shares = [find_share(most, radius[0])]
    for age in range(1, len(noise) + 1):
        reaches = [find_reach(noise[N - 1], change, [rolled] * N) for N in range(1, age + 1)]
        radius.append(round_up(min(radius[0], min(reaches) + ROUNDING)))
        # Ground ways g_k = R_k (1 - i_m,k) are known more closely, and slips that are compensated
        # differ little: R_k (1 - i_m) = g_k q_k, with q_k and 1/q_k at least `ratio`.
        ways = []
        for back in range(age):
            apart = radius[age] + radius[age - 1 - back] + (back + 1) * change
            ratio = (1 - most) / (1 - most + min(apart, most - least))
            ways.append((slowest * ratio, fastest / ratio))
        reaches = [
            find_reach(noise[N - 1], change / (1 - most), ways[:N]) for N in range(1, age + 1)
        ]
        by_ground = min(reaches) + ROUNDING / (1 - most)
        shares.append(round_up(min(by_ground, find_share(most, radius[age]))))
    return shares


def round_up(value):
    """Return a fraction above another, of few digits."""
    return read_units(scale(value)[1])


def check_learning(certificate):
    """Prove the losses on which the W of every band rests, a band for each of the first periods;
    return how far the ground speeds (right, left) may be off in the end."""
    learning = certificate["learning"]
    require(set(learning) == {"change", "periods", "speeds"}, "learning is not as known")
    require(learning["change"] >= 0, "the change of slips is negative")
    require("plans" in certificate, "learning begins with wider W, which needs plans")
    check_derivatives()
    for wheel in ("right", "left"):
        (slips,) = certificate["slips"][wheel]
        require(slips[:2] == slips[2:], f"the {wheel} wheel compensates other slips than may be")
        slowest, fastest = learning["speeds"][wheel]
        require(0 < slowest <= fastest, f"the {wheel} wheel may stand still, and tell nothing")
    noise = bound_noise(certificate)
    bands = certificate["bands"]
    ages = [read_index(band["age"]) for band in bands]
    require(ages == list(range(len(noise) + 1)), "bands are not those of the first periods")
    for index, wheel in enumerate(("right", "left")):
        slips = certificate["slips"][wheel][0][:2]
        shares = bound_wheel(
            learning, noise, certificate["period"], slips, learning["speeds"][wheel]
        )
        for band, share in zip(bands, shares, strict=True):
            require(
                share <= band["losses"][index], f"{band['name']}: the {wheel} wheel may lose more"
            )
    for start, number in enumerate(certificate["plans"]["sequence"]):
        window = certificate["plans"]["windows"][read_index(number)]
        wanted = [bands[min(start + j, len(noise))]["name"] for j in range(len(window["bands"]))]
        require(
            window["bands"] == wanted, f"plan {start} has other bands than those of its periods"
        )
    return bands[-1]["losses"]
