"""A tube-MPC exported by jaxtube, in NumPy alone: README.md beside it explains its use."""

import cmath
import hashlib
import math
from collections import namedtuple
from pathlib import Path

import numpy as np

SOLVED, INFEASIBLE, UNSOLVED, BLIND, HALTED, FINISHED = range(6)  # status: how it was found
USED, MISSING, LATE, INVALID = range(4)  # pose: what became of it
FIELDS = "wheels inputs errors margins status pose in_time guaranteed plan_left exchanges"
Output = namedtuple("Output", FIELDS)


def join(first, second):  # motions: (complex place, heading)
    return first[0] + second[0] * cmath.rect(1.0, first[1]), first[1] + second[1]


def see(motion, seen_from):
    return (motion[0] - seen_from[0]) * cmath.rect(1.0, -seen_from[1]), motion[1] - seen_from[1]


def sinc(angle):
    return math.sin(angle) / angle if abs(angle) > 1e-4 else 1.0 - angle * angle / 6.0


class Controller:
    def __init__(self, path="controller.npz"):
        path = Path(path)
        lines = (path.parent / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
        sums = {name: digest for digest, name in map(str.split, lines)}
        for file in (Path(__file__), path):
            if sums.get(file.name) != hashlib.sha256(file.read_bytes()).hexdigest():
                raise ValueError(f"{file}: is not the file that SHA256SUMS names; export it again")
        with np.load(path, allow_pickle=False) as file:
            for name, value in file.items():
                setattr(self, name, value if value.ndim else value.item())
        self.horizon = self.free_inputs.shape[1] // 2
        self.restart()

    def restart(self, runs=False):
        """Begin anew; `runs`: wheels that lag already run as the reference begins."""
        self.period = self.blind = self.halted = 0
        self.guaranteed = self.is_certified and (runs or not self.remembers_wheels)
        self.last_stamp = -math.inf
        self.stage = self.horizon  # of the plan's input that is due: none is left
        self.nominal = self.estimate = self.begun = None
        self.expected = self.reference_wheels[0] * runs
        self.intended = [self.expected] * (self.delay_periods + 2)

    def step(self, pose=None, stamp=None, now=None, slip=None):
        """Return what the next period is to do; numbers never raise, and no NaN comes back."""
        clock = math.nan if now is None else now
        self.begun = clock if self.begun is None else self.begun  # NaN: calls without times
        is_untimed = now is None and math.isnan(self.begun)
        late = 0.0 if is_untimed else abs(clock - self.begun - self.period * self.dt)
        in_time = bool(late <= self.most_jitter)
        age = 0.0 if now is None or stamp is None else now - stamp
        use = self._judge_pose(pose, stamp, age)
        is_over = self.period >= len(self.window)
        if use == USED and not is_over:
            self._correct_estimate(pose)
        self.blind = 0 if use == USED else self.blind + 1
        self.halted |= self.estimate is None or self.blind > self.horizon
        errors = np.zeros(3) if self.estimate is None else self.estimate
        margins = 1.0 - np.abs(errors) / self.caps
        if is_over or self.halted:
            found = (FINISHED if is_over else HALTED, use, in_time, False, 0, 0)
            return Output(*np.zeros((2, 2)), errors, margins, *found)
        index = self.window[self.period]
        found = (BLIND, None, 0)
        if use == USED:
            found = self._make_plan(index, errors if self.restarts else self.nominal)
        status, plan, exchanges = found
        given = self.nominal_slip if slip is None else np.asarray(slip, float)
        is_usable = np.all((self.slip_limits[0] <= given) & (given <= self.slip_limits[1]))
        slips = given if is_usable else self.nominal_slip
        keeps = status == SOLVED and is_usable and not (slip is None and self.needs_slip)
        keeps &= bool(max(late, abs(age)) <= self.certified_time and margins.min() >= 0)
        self.guaranteed = bool(self.guaranteed and keeps)
        inputs = self._follow_plan(index, errors, plan)
        wheels = self._turn_into_wheels(inputs, errors, slips)
        self._predict(errors, wheels * (1.0 - slips))
        found = (status, use, in_time, self.guaranteed, self.horizon - self.stage, exchanges)
        return Output(wheels, inputs, errors, margins, *found)

    def _judge_pose(self, pose, stamp, age):
        if pose is None:
            return MISSING
        is_near = np.shape(pose) == (3,) and np.max(np.abs(pose)) <= 1e8  # m, rad
        if not (is_near and -self.most_age <= age < math.inf):
            return INVALID
        if stamp is not None and not stamp > self.last_stamp:
            return MISSING
        self.last_stamp = self.last_stamp if stamp is None else stamp
        return USED if age <= self.most_age else LATE

    def _correct_estimate(self, pose):
        """Take a pose into the estimate of the errors; of the committed pose where wheels lag."""
        x, y, heading = self.reference_poses[self.period]
        error = see((complex(x, y), heading), (complex(pose[0], pose[1]), pose[2]))
        ahead = tuple(self.to_body @ self.expected * self.lag)
        ahead = join(ahead, self._arc(self.intended[1] * self.delay_rest))
        for speeds in self.intended[2:]:
            ahead = join(ahead, self._arc(speeds * self.dt))
        place, turn = see(error, ahead)
        measured = np.array([place.real, place.imag, math.remainder(turn, math.tau)])
        if self.estimate is None:
            self.estimate = self.nominal = measured
        self.estimate = self.estimate + self.observer_gain * (measured - self.estimate)

    def _arc(self, travel):
        way, turn = self.to_body @ travel
        return way * sinc(turn / 2.0) * cmath.rect(1.0, turn / 2.0), turn

    def _make_plan(self, index, start):
        """Return status, inputs, exchanges: a free plan's, or by active rows (Goldfarb, Idnani)."""
        bounds = self.bounds[index] - self.row_errors[index] @ start
        x = self.free_inputs[index] @ start
        if np.all(self.rows[index] @ x <= bounds):
            return SOLVED, x.reshape(-1, 2), 0
        whitened = self.whitened[index]
        y = np.zeros(len(bounds))
        rows = []
        adding = -1
        for exchanges in range(self.most_exchanges):
            active = whitened[rows]
            missed = whitened @ (self.start[index] @ start - whitened.T @ y) - bounds
            if adding < 0:
                adding = int(np.argmax(missed))
                if missed[adding] <= self.row_tolerance or len(rows) > self.most_rows:
                    break
            r = np.zeros_like(y)
            r[rows] = np.linalg.solve(active @ active.T, active @ whitened[adding])
            d = whitened[adding] - whitened.T @ r
            moves = d @ d > self.dependent * (whitened[adding] @ whitened[adding])
            full = max(missed[adding], 0.0) / (d @ d) if moves else math.inf
            ratios = np.where(r > self.unmoved, y, math.inf) / np.where(r > self.unmoved, r, 1.0)
            length = min(full, np.min(ratios))
            if length == math.inf:
                # Farkas: for every z that a plan may have, with what keeps this from being exact.
                left = np.linalg.norm(d) + np.maximum(r, 0.0) @ np.linalg.norm(whitened, axis=1)
                gap = bounds[adding] - np.minimum(r, 0.0) @ bounds + left * self.farthest[index]
                is_proof = gap < -self.tolerance * (1.0 + abs(r).sum())
                return (INFEASIBLE if is_proof else UNSOLVED), None, exchanges
            y = y - length * r
            y[adding] += length
            if full == length:
                rows.append(adding)
                adding = -1
            else:
                rows.remove(np.argmin(ratios))
                y[np.argmin(ratios)] = 0.0
        else:
            return UNSOLVED, None, self.most_exchanges
        y[rows] += np.linalg.solve(active @ active.T, missed[rows])
        x = x - self.unwhiten[index] @ (whitened.T @ y)
        is_met = np.all(self.rows[index] @ x - bounds <= self.tolerance)
        return (SOLVED, x.reshape(-1, 2), exchanges) if is_met else (UNSOLVED, None, exchanges)

    def _follow_plan(self, index, errors, plan):
        """Return inputs: of a fresh plan, else of the last one, then of the terminal gain."""
        if plan is not None:
            self.plan = plan
            self.stage = 0
            self.nominal = errors if self.restarts else self.nominal
        has_plan = self.stage < self.horizon
        gain = self.tube_gain[index] if has_plan else self.terminal_gain[index]
        due = self.plan[self.stage] if has_plan else gain @ self.nominal
        inputs = due + gain @ (errors - self.nominal)
        self.nominal = self.transition[index] @ self.nominal + self.input_matrix[index] @ due
        self.stage = min(self.stage + 1, self.horizon)
        return inputs

    def _turn_into_wheels(self, inputs, errors, slip):
        """Return the wheel speeds that realise inputs by the input map, within the limits."""
        V, Om = self.to_body @ self.reference_wheels[self.period]
        T = self.dt
        om = Om - inputs[1]
        v = V * (math.cos(errors[2]) if self.input_map == "cosine_free" else 1.0) - inputs[0]
        if self.input_map == "x_exact":
            chord = T * V * sinc(T * Om / 2.0) * math.cos(errors[2] + T * Om / 2.0 - T * om)
            turned = (math.sin(T * om) - T * Om) * errors[1]
            turned -= 2.0 * math.sin(T * om / 2.0) ** 2 * errors[0]
            v = ((chord + turned) / T - inputs[0]) / max(sinc(T * om), 0.1)
        over_ground = np.linalg.solve(self.to_body, [v, om])
        return np.clip(over_ground / (1.0 - slip), *self.wheel_limits)

    def _predict(self, errors, speeds):
        """Go to the next period: the estimate, and speeds over ground (m/s) of wheels that lag."""
        moved = see((complex(*errors[:2]), errors[2]), self._arc(speeds * self.dt))
        place, turn = join(moved, self._arc(self.reference_wheels[self.period] * self.dt))
        self.estimate = np.array([place.real, place.imag, turn])
        self.intended = [*self.intended[1:], speeds]
        for command, decay in zip(self.intended, self.decays, strict=False):
            self.expected = command + (self.expected - command) * decay
        self.period += 1
