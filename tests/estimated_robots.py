"""Robots that are steered by an estimate of their error, in the world frame, by what a certificate
says of them: what the checker proves of estimates is compared with."""

from typing import NamedTuple

import numpy as np
from late_robot import LatePeriod, commit, move

from sets.robot.actuation import Nominal

AT_ENDS = 0.9
"""Share of numbers that are drawn at the ends of their ranges."""
BRED = 200
"""Robots of which one goes on."""
PAST = 8
"""Commands before that of a period."""


class Asked(NamedTuple):
    """What is asked of every robot in a period: inputs (2, n), reference wheel speeds (2, n), and
    the ground speeds (2, n) that lead x where the model has it, with the errors (n, 3) that they
    would lead the estimates to."""

    inputs: np.ndarray
    reference: np.ndarray
    wheels: np.ndarray
    expected: np.ndarray


class EstimatedRobots:
    """Estimates anywhere within their caps, everything else at random, mostly at its ends.

    Attributes:
        off: how far estimates are off (n, 3), at first as far as what is measured.
        variables: of the last period, those of the checker (n, 13), with the error itself in the
            place of its share.
    """

    def __init__(self, said, count):
        self.said = said
        self.random = np.random.default_rng(3)
        self.count = count
        self.off = self.draw(said["noise"])
        self.variables = np.empty((count, 13))

    def draw(self, sizes):
        """Return numbers (n, sizes) within +- sizes."""
        shape = (self.count, len(sizes))
        inside = self.random.uniform(-1, 1, shape)
        is_end = self.random.random(shape) < AT_ENDS
        return sizes * np.where(is_end, np.sign(inside), inside)

    def draw_between(self, low, high):
        return (low + high) / 2 + self.draw([(high - low) / 2])[:, 0]

    def draw_grips(self):
        """Return (1 - true slip) / (1 - compensated slip) of the wheels (right, left), (2, n)."""
        return np.array([self._draw_grip(self.said["slips"][name]) for name in ("right", "left")])

    def _draw_grip(self, cases):
        pairs = [[self.draw_between(*case[:2]), self.draw_between(*case[2:])] for case in cases]
        which = self.random.integers(len(cases), size=self.count)
        true, compensated = np.array(pairs)[which, :, np.arange(self.count)].T
        return (1 - true) / (1 - compensated)

    def advance(self):
        """Go on by a period; return what disturbed the model of the estimates, (n, 3)."""
        (band,) = self.said["bands"]
        estimates = self.draw(band["errors"])
        u1 = self.draw_between(*band["u1"])
        of_x, of_turn = band["coupling"]
        u2 = np.clip(self.draw_between(*band["u2"]), -1 / of_turn, 1 / of_turn)
        most = (1 - of_turn * np.abs(u2)) / of_x
        estimates[:, 0] = np.clip(estimates[:, 0], -most, most)
        asked = self._ask(estimates, np.array([u1, u2]))
        moved = self.move(estimates, asked)
        after = self.see(estimates - self.off, asked.reference, *moved)
        measured = after + self.draw(self.said["noise"])
        gain = np.array(self.said["estimate"]["gain"])
        following = asked.expected + gain * (measured - asked.expected)
        self.off = following - after
        return following - self._predict(estimates, asked)

    def _ask(self, estimates, inputs):
        T = self.said["period"]
        pairs = np.array(self.said["bands"][0]["regions"])
        reference = pairs[self.random.integers(len(pairs), size=self.count)].T
        rate = (reference[0] - reference[1]) / self.said["track"]
        aside = self.said["track"] / 2 * (rate - inputs[1]) * np.array([[1.0], [-1.0]])

        def expect(speed):
            return self.see(estimates, reference, *self.drive(speed + aside))

        # The way ahead is linear in the speed.
        wanted = estimates[:, 0] + T * rate * estimates[:, 1] + T * inputs[0]
        still, rolling = (expect(speed)[:, 0] for speed in (0.0, 1.0))
        speed = (wanted - still) / (rolling - still)
        return Asked(inputs, reference, speed + aside, expect(speed))

    def drive(self, ground, sideways=0.0):
        """Return the motion (complex place, heading) along arcs, by the ground speeds of the wheels
        (2, n) and that of the slide."""
        turn = self.said["period"] * (ground[0] - ground[1]) / self.said["track"]
        chord = self.said["period"] * np.sinc(turn / 2 / np.pi) * np.exp(0.5j * turn)
        return chord * ((ground[0] + ground[1]) / 2 + 1j * sideways), turn

    def see(self, errors, reference, place, turn):
        """Return the errors (n, 3) after a motion of the robot and a period of its reference."""
        ahead, turned = self.drive(reference)
        x, y, heading = errors.T
        after = (x + 1j * y + ahead * np.exp(1j * heading) - place) * np.exp(-1j * turn)
        return np.stack([after.real, after.imag, heading + turned - turn], axis=1)

    def move(self, estimates, asked):
        """Return the motion (complex place, heading) of what is steered in the period."""
        ground = asked.wheels * self.draw_grips()
        share = self.draw([self.said["sideslip"]])[:, 0]
        turning = (ground[0] - ground[1]) / self.said["track"]
        sideways = share * (ground[0] + ground[1]) / 2 - self.said["lever_arm"] * turning
        lost = 1 - ground / asked.wheels
        others = [*asked.inputs, *asked.reference, *lost, share]
        self.variables = np.stack([*estimates.T, *others, *self.off.T], axis=1)
        return self.drive(ground, sideways)

    def _predict(self, estimates, asked):
        """Return M p + B u."""
        T = self.said["period"]
        A = T * (asked.reference[0] - asked.reference[1]) / self.said["track"]
        h = np.tan(A / 2)
        c = T * asked.reference.mean(axis=0) * np.sinc(A / 2 / np.pi) / np.cos(A / 2)
        x, y, heading = estimates.T
        ahead, turned = T * asked.inputs
        aside = y - h * (2 * x + A * y + ahead) + c * (heading + turned / 2)
        return np.stack([x + A * y + ahead, aside, heading + turned], axis=1)

    def breed(self, coordinate):
        """Let all robots go on from the worst errors of a coordinate: what led there may have
        happened to each of them."""
        worst = np.argsort(-np.abs(self.off[:, coordinate]))[: max(self.count // BRED, 1)]
        self.off = self.off[np.resize(worst, self.count)]


class LateRobots(EstimatedRobots):
    """The same of robots whose wheels lag, without a lever arm: errors are those of the committed
    pose, wheels and delays are followed step by step."""

    def move(self, estimates, asked):
        late = self.said["lateness"]
        losses = 1 - self.draw_grips()
        shares = self.draw([self.said["sideslip"]])[:, 0]
        lags = self.draw_between(*late["lag"])
        motions = [
            self._move_one(
                LatePeriod(
                    self.said["period"],
                    self.said["track"],
                    Nominal(*late["nominal"]),
                    np.vstack([self._draw_past(), asked.wheels[:, robot]]),
                    lags[robot],
                    self.random.choice(late["delay"], PAST + 1),
                    losses[:, robot],
                    shares[robot],
                )
            )
            for robot in range(self.count)
        ]
        places, turns = np.array(motions).T
        return places, turns.real

    def _draw_past(self):
        """Return commands (PAST, 2) before, each within what may be commanded."""
        said = self.said
        (band,) = said["bands"]
        b = said["track"]
        rates = [(right - left) / b for right, left in band["regions"]]
        turns = (min(rates) - band["u2"][1], max(rates) - band["u2"][0])
        ends = np.array([said["lateness"]["wheels"][name] for name in ("right", "left")])
        pairs = []
        while len(pairs) < PAST:
            speed, turn = map(self._draw_one, (said["lateness"]["speeds"], turns))
            pair = speed + b / 2 * turn * np.array([1.0, -1.0])
            if np.all(ends[:, 0] <= pair) and np.all(pair <= ends[:, 1]):
                pairs.append(pair)
        return np.array(pairs)

    def _draw_one(self, ends):
        is_end = self.random.random() < AT_ENDS
        return self.random.choice(ends) if is_end else self.random.uniform(*ends)

    def _move_one(self, period):
        before, heading_before, _ = commit(period, now=True)
        after, heading_after, _ = commit(period, now=False)
        place, heading = move(period)
        whole = place + after * np.exp(1j * heading) - before
        return whole * np.exp(-1j * heading_before), heading + heading_after - heading_before


def lies_in(w, W):
    """Return whether disturbances lie in a segment of kicks plus a box."""
    kicks = np.stack([np.zeros(len(w)), w[:, 2], w[:, 1] / W["lean"]])
    x, y, heading = W["box"]
    sizes = np.array([[W["yaw"]], [heading], [y / W["lean"]]])
    is_kick = np.max(kicks - sizes, axis=0) <= np.min(kicks + sizes, axis=0)
    return np.all(is_kick) and np.all(np.abs(w[:, 0]) <= x)
