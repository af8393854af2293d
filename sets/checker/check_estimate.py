"""An estimate on which a controller acts in the place of the measured error: how far it is off, and
what disturbs it; part of `check_certificate`, of the standard library alone.

With e the true error and p the estimate, the motion of `check_motion` leads p to p- where wheels
do what they are asked and nothing slides; the true error becomes e+ = p- + r. A measurement is
within nu of it, and the estimate takes over a share of what it did not predict:

    p+ = p- + L (e+ + nu+ - p-) = p- + L (r + nu+),    L = diag(l_x, l_y, l_th),    0 < l <= 1,
    n+ = p+ - e+ = L nu+ - (I - L) r,                  n = p - e,                   |nu+| <= nu.

What slips, sideslip and n do is r, the n of `check_motion` being p - e; in heading r = kick - n_th.
The first estimate is the first measurement. So |n| <= S at all times, by coordinate, where

    nu <= S    and    (1 - l) |r| + l nu <= S    as long as    |n| <= S    and p keeps its caps.

The model leaves out w = p+ - M p - B u = m + L (r + nu+). Of this m, which p- has beside the model,
has a lateral coordinate alone, and the kick turns p by s = l_th kick. So w lies in
W = {s (0, lean, 1): |s| <= yaw} + box where

    l_th |kick| <= yaw                       l_x |r_x| + l_x nu_x <= box_x
    l_th (S_th + nu_th) <= box_th            |m_y + l_y r_y - lean s| + l_y nu_y <= box_y,

and caps and plans are those of p, within S of which e lies. Without an estimate p is what is
measured: L = I, S = nu.

Source: an error kept in a robust invariant set goes back to Mayne, Rakovic, Findeisen, Allgoewer
2006, Automatica 42(7), section 3.
"""

from check_intervals import pick, require
from check_words import is_of_robot


def read_estimate(certificate):
    """Return the gain L of an estimate and the bound S of its error; those of what is measured,
    where no estimate is made."""
    estimate = certificate.get("estimate", {"gain": [1, 1, 1], "error": certificate["noise"]})
    return pick(estimate, "gain", "error")


def check_estimate(certificate):
    """Require an estimate as known here, whose error S holds at first."""
    is_known = "learning" not in certificate and is_of_robot(certificate)
    require(is_known, "UNCHECKED: an estimate beside slips that are learnt, or of a model alone")
    require(set(certificate["estimate"]) == {"gain", "error"}, "the estimate is not as known")
    rows = zip(*read_estimate(certificate), certificate["noise"], strict=True)
    for gain, error, noise in rows:
        require(0 < gain <= 1, "a gain of the estimate is no share in (0, 1]")
        require(0 <= noise <= error, "the first estimate, which is measured, may be off by more")


def find_lateral(certificate, band):
    """Return the lean of a kick of the robot in w_y, and the gain l_y."""
    gain, _ = read_estimate(certificate)
    return band["disturbance"]["lean"] * gain[2], gain[1]


def bound_motions(certificate, band):
    """Return by the name of a motion the bound up to which it is to be proved, in both directions,
    so that w lies in W and the error of an estimate in S."""
    gain, error = read_estimate(certificate)
    noise = certificate["noise"]
    yaw, box = pick(band["disturbance"], "yaw", "box")
    taken = [share * most for share, most in zip(gain, noise, strict=True)]
    require(box[2] >= gain[2] * error[2] + taken[2], "W is narrower than the noise of headings")
    sideways = "y" if "model" not in certificate else "y of the model"
    levels = {
        "x": (box[0] - taken[0]) / gain[0],
        sideways: box[1] - taken[1],
        "kick": yaw / gain[2],
    }
    # Up to there |r| leaves the error within S; with a gain of one the error is the noise alone.
    allowed = {
        name: (error[i] - taken[i]) / (1 - gain[i])
        for i, name in enumerate(("x", "unpredicted y", "kick"))
        if gain[i] < 1
    }
    if "kick" in allowed:
        allowed["kick"] -= error[2]
    return levels | {name: min(most, levels.get(name, most)) for name, most in allowed.items()}
