"""The motion of a robot that slips, and proofs that what its model leaves out lies in W, for
`check_certificate`; of the standard library alone.

A robot drives for a period T with ground speeds g_r, g_l (right, left, b apart); its reference
drives an arc of length L = T V, V = (V_r + V_l)/2, that turns by A = T (V_r - V_l)/b. With the
error e = (x, y, th) of the reference in the robot's frame, z = x + i y, a = T (g_r - g_l)/b, way =
T (g_r + g_l)/2, S(a) = C(a) - i D(a), C = sin(a)/a and D = (1 - cos a)/a, the motion is exactly

    z+ = e^{-ia} z + L C(A/2) e^{i psi} - way S(a),   psi = th + A/2 - a,   th+ = th + A - a.

The input u = (u1, u2) asks for a = A - T u2, and for the way that makes x+ = x + A y + T u1. Then

    y+ = y - tan(a/2) (2 x + A y + T u1) + L C(A/2) sin(th + T u2/2) / cos(a/2).

Wheels keep 1 - d of the ground speed asked of each, and the body slides to the left at zeta v - r w
besides: the robot turns by a - kick. With h = tan(A/2), c = L C(A/2)/cos(A/2) the model

    e+ = M e + B u + w,  M = [1, A, 0; -2h, 1-hA, c; 0, 0, 1],  B = [T, 0; -hT, cT/2; 0, T]

the motion's Jacobian at e = u = 0, leaves out, of errors measured with noise n,

    w = m + r + next n   in   W = {s (0, lean, 1): |s| <= yaw} + box,    r_th = kick - n_th,

with r what slip, sideslip and n do, and m = (0, m_y, 0) what the motion has without them. Of
another model, "y of the model", the difference between the models is added to m_y. Of an estimate,
by `check_estimate`, w has a share l_y of r_y, the gain. Of wheels that lag, by `check_lag`, d_r and
d_l are the ways that slip takes from them. Last come a way and a turn that lag takes, and a lever,
by which a kick moves the robot sideways besides.
That r_x, r_y, m_y + l_y r_y - lean kick and the kick keep their bounds is proved cell by cell: a
motion is largest at an end of a cell where its slope has one sign, and rises by no more
than slope times way from elsewhere (Moore, Kearfott, Cloud 2009, chapter 6).
"""

from check_intervals import (
    COSINE,
    EXCESS,
    HALF,
    ONE,
    SINE,
    ZERO,
    C,
    D,
    Formula,
    Number,
    require,
    scale,
)

MINUS_HALF = (-HALF[1], -HALF[0])
# Letters of the variables of `find_motion`, in its order: where cells are cut.
VARIABLES = "abcdefghijklmnop"


def find_constants(robot, piece):
    """Return the ends of what is constant in `find_motion`."""
    T, b, lever, lean, gain = robot
    values = (T, T / b, b / 2, 1 / b, lever, lean, gain, *piece)
    return [None if value is None else scale(value) for value in values]


def turn_cosine(x, half_step):
    """Return cos(x + 2 half_step) - cos x."""
    return SINE(x + half_step) * SINE(half_step) * -2


def turn_sine(x, half_step):
    """Return sin(x + 2 half_step) - sin x."""
    return COSINE(x + half_step) * SINE(half_step) * 2


def find_motion(output, variables, constants):
    """Return r_x, r_y, m_y + l_y r_y - lean kick, the same of a model that is not the motion's
    Jacobian, the kick, or the way of a wheel or of the body that is asked for."""
    share, y, th, u1, u2, first, second, d_r, d_l, zeta, n_x, n_y, n_th, *late = variables
    T, turning, half_b, per_b, lever, lean, gain, x_reach, x_slope, *speeds = constants
    v_reach, v_slope = speeds
    x = share * (u2 * x_slope + x_reach)
    if v_reach is None:
        middle = (first + second) * HALF
        A = (first - second) * turning
    else:
        middle = first
        A = second * (first * v_slope + v_reach) * turning * 2
    m = u2 * T
    a = A - m
    half_A = A * HALF
    half_a = a * HALF
    chord = middle * T * C(half_A)
    psi = th - half_A + m
    sine = SINE(half_a)
    ahead = chord * COSINE(psi) - sine * sine * x * 2 + (EXCESS(a) - m) * y - u1 * T
    way = ahead * C(a).inverse()
    if output == "way":
        return way
    right = way + a * half_b
    left = way - a * half_b
    if output in ("right", "left"):
        return right if output == "right" else left
    right_lost = d_r if late else right * d_r
    left_lost = d_l if late else left * d_l
    way_taken, turn_taken, late_lever = late or [ZERO] * 3
    kick = (right_lost - left_lost) * per_b + turn_taken
    if output == "kick":
        return kick
    lost = (right_lost + left_lost) * HALF + way_taken
    turn = a - kick
    back = -kick
    half_back = back * HALF
    half_swing = (kick - n_th) * HALF
    d_cos = turn_cosine(a, half_back)
    d_sin = turn_sine(a, half_back)
    cos_turn = COSINE(turn)
    sin_turn = SINE(turn)
    sideways = zeta * (way - lost) - turn * lever
    if output == "x":
        swing = d_cos * x + d_sin * y + chord * turn_cosine(psi, half_swing)
        slip = lost * C(turn) - way * C.change(a, back) - sideways * D(turn)
        return swing + slip - cos_turn * n_x - sin_turn * n_y
    secant_a = COSINE(half_a).inverse()
    secants = secant_a * COSINE(half_A).inverse()
    half_m = m * HALF
    ahead_th = th + half_m
    bent = SINE(half_m) * secants * (x * 2 + A * y + u1 * T)
    curved = EXCESS(ahead_th) * secant_a
    curved = curved - turn_cosine(half_A, half_m * MINUS_HALF) * secants * ahead_th
    swing = d_cos * y - d_sin * x + chord * turn_sine(psi, half_swing) + kick * late_lever
    slip = way * D.change(a, back) - lost * D(turn) - sideways * C(turn)
    unpredicted = swing + slip + sin_turn * n_x - cos_turn * n_y
    if output == "unpredicted y":
        return unpredicted
    found = bent + chord * curved + unpredicted * gain - kick * lean
    if output == "y":
        return found
    # Of the model I + T (.), with f_r = f_l = 1, beside the Jacobian.
    secant_A = COSINE(half_A).inverse()
    tangent = SINE(half_A) * secant_A
    quarter = SINE(half_A * HALF)
    bend = (half_A * quarter * quarter * 2 + EXCESS(half_A)) * secant_A * -2
    longer = chord * secant_A - middle * T
    return found + bend * x - tangent * (A * y + u1 * T) + longer * th + chord * secant_A * m * HALF


def note_motion(output, cell, robot, piece):
    """Return the formula of a motion of a robot, in a piece of its operation."""
    variables = [Number(ends=ZERO if ends == ZERO else None) for ends in cell]
    return Formula(find_motion(output, variables, find_constants(robot, piece)), variables)


def shrink(cell, slopes):
    """Return what of a cell holds the greatest value: ends where a slope has one sign."""
    shrunk = []
    for (low, high), (least, most) in zip(cell, slopes, strict=True):
        shrunk.append((high, high) if least >= 0 else (low, low) if most <= 0 else (low, high))
    return shrunk


def bound(formula, sign, cell, slopes):
    """Return an upper bound of sign times a formula over a shrunk cell."""
    centre = []
    rise = 0
    for (low, high), (least, most) in zip(cell, slopes, strict=True):
        place = low if low == high else low + (high - low) * most // (most - least)
        rise += max(most * (high - place), least * (low - place)) if low < high else 0
        centre.append((place, place))
    low, high = formula.follow(centre)[-1]
    return (high if sign > 0 else -low) - (-rise // ONE)


def prove(output, sign, level, tree, cell, robot, piece):
    """Prove that sign times a motion is at most a level over a cell. A letter of the tree cuts a
    cell into halves along its variable, the lower one first; a dash shrinks it; a dot stands for a
    cell that has to be proved."""
    formula = note_motion(output, cell, robot, piece)
    cells = [cell]
    for letter in tree:
        require(cells, "a tree goes on where all cells are proved")
        cell = cells.pop()
        if letter in "-.":
            slopes = formula.find_slopes(cell, sign)
            cell = shrink(cell, slopes)
        if letter == "-":
            cells.append(cell)
        elif letter == ".":
            missed = bound(formula, sign, cell, slopes) - level
            require(missed <= 0, f"{output} may exceed its bound by {missed / ONE:.3g}")
        else:
            index = VARIABLES.index(letter)
            low, high = cell[index]
            middle = (low + high) // 2
            halves = ((middle, high), (low, middle))
            cells += [[*cell[:index], half, *cell[index + 1 :]] for half in halves]
    require(not cells, "cells are left that a tree does not prove")
