"""Check a certificate of jaxtube with the standard library: python check_certificate.py FILE

The file holds the numbers of a controller and of the proof that a robot under it keeps its limits.
This program trusts none of them. Beside it lie `check_motion.py`, which says how the robot moves,
what its model e+ = M e + B u + w is, and proves w in W, `check_plans.py`, of the QPs, and what they
need, of sets, learnt slips, linear models and intervals. By band of wheel speeds V_r, V_l is proved

wheels  no command asks a wheel for more than it can do under the greatest slip it compensates;
sets    Phi S + W lies in S' for the band's set S, every S' that may follow, and all loops
        Phi = M + B K of the law u = K e, K = [-k1, -Om, 0; 0, -k2, -k3], Om = (V_r - V_l)/b; and
        S within the caps on which W rests. With t = tan(A/2)/(A/2) loops are affine in t V_r and
        t V_l, so mixtures of those at corners, and K one in V_r and V_l. Multipliers l >= 0 with
        l H = d prove d e <= l h where H e <= h (Farkas 1902);
cost    P - Phi' P Phi - Q - K' R K is positive semidefinite, by its pivots.
"""

import json
import re
import sys
import time
from fractions import Fraction
from itertools import product
from typing import Any

from check_estimate import bound_motions, check_estimate, find_lateral, read_estimate
from check_intervals import ONE, Refused, pick, require, scale, scale_all
from check_lag import find_late, narrow_levels
from check_learning import check_learning
from check_model import check_wheels, list_ends
from check_motion import prove
from check_plans import check_plans
from check_pose import bound_poses, check_lateness
from check_sets import (
    Set,
    check_cost,
    check_sets,
    cut,
    is_lasting,
    list_loops,
    list_slips,
    list_speeds,
)
from check_words import ROBOT, is_of_robot, list_assumptions, show_disturbance

FORMAT = "jaxtube certificate 1"
KNOWN = {"format", "name", *ROBOT, "wheel_speeds", "constraints", "noise", "slips", "sideslip"}
KNOWN |= {"bands", "sets", "inclusions", "cost", "plans", "learning", "model", "measured"}
KNOWN |= {"estimate", "lateness"}
DAMAGES = (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
DAMAGES += (RecursionError,)
BAND_OF_MODEL = {"name", "regions", "errors", "inputs", "gains", "disturbance"}
BAND = {"name", "regions", "errors", "u1", "u2", "coupling", "gains", "disturbance", "cells"}


def read(value: Any) -> Any:
    """Return JSON with its fractions "p/q" as numbers; other numbers would be inexact."""
    if isinstance(value, dict):
        return {name: read(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [read(entry) for entry in value]
    if value is None:
        return None
    require(isinstance(value, str), f"{value!r} is no string: numbers are strings p/q")
    return Fraction(value) if re.fullmatch(r"-?\d{1,400}(/\d{1,400})?", value) else value


def list_turns(band):
    """Return stretches of u2, with reach and slope of |x| <= reach + slope u2."""
    cap = band["errors"][0]
    of_x, of_turn = band["coupling"]
    low, high = band["u2"]
    if not of_turn:
        return [(stretch, cap, 0) for stretch in cut(low, high, 0)]
    require(of_x > 0 and of_turn > 0, "the coupling of x with u2 has to be positive")
    uncut = max((1 - of_x * cap) / of_turn, 0)
    turns = []
    for start, end in cut(max(low, -1 / of_turn), min(high, 1 / of_turn), -uncut, 0, uncut):
        is_cut = max(abs(start), abs(end)) > uncut
        slope = of_turn / of_x * (1 if start + end < 0 else -1)
        turns.append(((start, end), 1 / of_x, slope) if is_cut else ((start, end), cap, 0))
    return turns


def list_levels(certificate, band):
    """Return by name and sign up to which bound motions of a band are to be proved."""
    T = certificate["period"]
    levels = bound_motions(certificate, band)
    levels = {(output, sign): level for output, level in levels.items() for sign in (1, -1)}
    slowest, fastest = certificate["wheel_speeds"]
    for wheel in ("right", "left"):
        grips = [1 - seen for _, seen in list_slips(certificate, wheel)]
        levels[wheel, 1] = T * min(grip * fastest for grip in grips)
        levels[wheel, -1] = -T * max(grip * slowest for grip in grips)
        if "learning" in certificate:
            least, most = certificate["learning"]["speeds"][wheel]
            levels[wheel, 1] = min(levels[wheel, 1], T * most)
            levels[wheel, -1] = min(levels[wheel, -1], -T * least)
    return levels


def list_losses(certificate, band):
    """Return the ranges of d by which wheels (right, left) miss the ground speed asked of them."""
    if "learning" in certificate:
        return [(-loss, loss) for loss in band["losses"]]
    losses = []
    for wheel in ("right", "left"):
        shares = [(true - seen) / (1 - seen) for true, seen in list_slips(certificate, wheel)]
        losses.append((min(shares), max(shares)))
    return losses


def list_motions(certificate, band):
    """Yield what is bounded of the motions of a band: its name, sign and bound, and the cells over
    which it is bounded, with the constants of robot and cell."""
    T, b, lever_arm = pick(certificate, *ROBOT)
    levels = list_levels(certificate, band)
    losses = list_losses(certificate, band)
    sideslip = certificate["sideslip"]
    late = find_late(certificate, band)
    if late:
        # What slides is in the rest, which the levels leave room for.
        lever_arm = 0
        sideslip = 0
        levels = narrow_levels(certificate, levels, late)
        losses = late.lost
    robot = (T, b, lever_arm, *find_lateral(certificate, band))
    _, off = read_estimate(certificate)
    sizes = [*band["errors"][1:], sideslip, *off, *(late.taken if late else ())]
    ends = [(-size, size) for size in sizes]
    ends += [(late.lever, late.lever)] if late else []
    cells = []
    speeds = [each for region in band["regions"] for each in list_speeds(region)[0]]
    turns = list_turns(band)
    pairs = {tuple(region) for region in band["regions"] if len(region) == 2}
    is_even = band["u2"][0] == -band["u2"][1] and pairs == {pair[::-1] for pair in pairs}
    is_even &= all(levels["right", sign] == levels["left", sign] for sign in (1, -1))
    if is_even and losses[0] == losses[1]:
        # A motion with u2 < 0 is the mirror image of one with u2 > 0, wheels exchanged.
        turns = [turn for turn in turns if turn[0][0] >= 0]
    for (u2, *turn), (mean, part, *speed) in product(turns, speeds):
        ranges = [(-1, 1), *ends[:2], band["u1"], u2, mean, part, *losses, *ends[2:]]
        require(all(low <= high for low, high in ranges), "a range of the operation is crossed")
        cell = [(scale(low)[0], scale(high)[1]) for low, high in ranges]
        cells.append((cell, robot, (*turn, *speed)))
    require(cells, f"{band['name']} has no motions")
    for (output, sign), level in levels.items():
        yield output, sign, scale(level)[0], cells


def check_motions(certificate, band):
    """Prove W of a band, and its commands within the limits of wheels; return it in words."""
    turning = certificate.get("model", {"turning": [1, 1]})["turning"]
    require(turning == [1, 1], "no W is proved of a model whose slipping wheels turn it less")
    count = 0
    for output, sign, level, cells in list_motions(certificate, band):
        name = output + ("+" if sign > 0 else "-")
        trees = band["cells"][name]
        require(len(trees) == len(cells), f"{len(trees)} trees for {len(cells)} boxes of {name}")
        for tree, cell in zip(trees, cells, strict=True):
            prove(output, sign, level, tree, *cell)
            count += tree.count(".")
    W = show_disturbance(band)
    return f"w lies in W ({W}), and wheels can do what is asked of them; {count} cells"


def check_head(certificate):
    """Require that a certificate is described as known here."""
    unknown = sorted(set(certificate) - KNOWN - {"unchecked"})
    unknown += [f"{name} = {value}" for name, value in certificate.get("unchecked", {}).items()]
    require(not unknown, f"UNCHECKED: no proof is known here for {', '.join(unknown)}")
    require(certificate["format"] == FORMAT, f"the format is not {FORMAT!r}")
    require(isinstance(certificate["name"], str), "the certificate has no name")
    require(min(certificate["period"], certificate["track"]) > 0, "period or track is not positive")
    require(set(certificate["slips"]) == {"right", "left"}, "slips are not those of two wheels")
    if "estimate" in certificate:
        check_estimate(certificate)
    if "lateness" in certificate:
        check_lateness(certificate)
    names = {band["name"] for band in certificate["bands"]}
    require(0 < len(names) == len(certificate["bands"]), "bands need names of their own")
    require(is_of_robot(certificate) or "model" in certificate, "no W is proved or assumed")
    known = BAND if is_of_robot(certificate) else BAND_OF_MODEL
    known = known | {"age", "losses"} if "learning" in certificate else known
    known = known if "model" in certificate else known | {"set"}
    for band in certificate["bands"]:
        require(set(band) == known and band["regions"], f"{band['name']} is not described as known")
        pairs = zip(band["errors"], read_estimate(certificate)[1], strict=True)
        errors = bound_poses(certificate, [cap + size for cap, size in pairs])
        pairs = zip(errors, certificate["constraints"], strict=True)
        require(all(error <= limit for error, limit in pairs), "true errors may pass their limits")
        yaw, box = pick(band["disturbance"], "yaw", "box")
        require(min(yaw, *box) >= 0, f"the W of {band['name']} has a negative width")


def check(certificate):
    """Check all of a certificate and yield in words what is proved."""
    check_head(certificate)
    if "learning" in certificate:
        losses = ", ".join(f"{float(loss):.4g}" for loss in check_learning(certificate))
        yield f"slips are learnt: ground speeds err by {losses} (right, left) at most in the end"
    for band in certificate["bands"]:
        check_band = check_motions if is_of_robot(certificate) else check_wheels
        yield f"{band['name']}: {check_band(certificate, band)}"
    if "estimate" in certificate:
        error = ", ".join(f"{float(most):.6g}" for most in certificate["estimate"]["error"])
        whose = "of the committed pose " if "lateness" in certificate else ""
        yield f"as long as it keeps its caps, the estimate {whose}is within {error} m, m, rad"
    yield from (check_ends if "model" in certificate else check_law)(certificate)
    if "plans" in certificate:
        room = check_plans(certificate)
        shown = f"{len(room)} rows, least room {min(room) / ONE:.3g}"
        yield f"plans stay plans along the reference: {shown}"
    limits = ", ".join(f"{float(limit):.6g}" for limit in certificate["constraints"])
    when = "end of every period" + (", and a latency later" if "lateness" in certificate else "")
    yield f"hence, with w in W, at the {when}, true errors within {limits} m, m, rad"


def check_law(certificate):
    """Check the sets and the cost of the law u = K e; yield in words what is proved."""
    shapes = {
        name: Set(scale_all(shape["rows"]), scale_all(shape["offsets"]), shape["extents"])
        for name, shape in certificate["sets"].items()
    }
    for band in certificate["bands"]:
        if is_lasting(certificate, band):
            room = check_sets(certificate, band, shapes[band["set"]])
            yield f"{band['name']}: {len(room)} inclusions of sets, for speeds in any order"
            if "cost" in certificate:
                check_cost(certificate, product(*list_loops(certificate, band)))
                yield f"{band['name']}: the terminal cost decreases by the cost of a stage"


def check_ends(certificate):
    """Check the cost of the law u = G e that ends plans; yield in words what is proved."""
    require("plans" in certificate, "without plans gains that are mixed promise nothing")
    for band in certificate["bands"] if "cost" in certificate else ():
        check_cost(certificate, list_ends(certificate, band))
        yield f"{band['name']}: the terminal cost decreases by the cost of a stage"


def main(path):
    """Check a file, say what is proved and assumed, and return 0, or 1 where it is refused."""
    began = time.perf_counter()
    try:
        with open(path, encoding="utf-8") as file:
            certificate = read(json.load(file))
        for sentence in check(certificate):
            print(f"proved   {sentence}")
        for sentence in list_assumptions(certificate):
            print(f"assumed  {sentence}")
    except Refused as refusal:
        print(f"REFUSED  {refusal}")
        return 1
    except DAMAGES as error:
        print(f"REFUSED  the file is damaged: {type(error).__name__}: {str(error)[:80]}")
        return 1
    whose = "" if is_of_robot(certificate) else " for its linear model alone"
    print(f"CHECKED  {certificate['name']}{whose}, in {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]) if len(sys.argv) == 2 else __doc__)
