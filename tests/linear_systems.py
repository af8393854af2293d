"""Linear systems for tests, and what is known of them without this project."""

import numpy as np
from scipy.linalg import solve_discrete_are

from jaxtube.systems.system import LinearSystem

T = 0.1


def varying_mass(**changes):
    """Return a double integrator whose mass falls along its run."""
    shares = np.linspace(0, 1, 12)
    fields = {
        "A": np.array([[1.0, T], [0.0, 1.0]]),
        "B": np.array([[[T**2 / 2 / mass], [T / mass]] for mass in (1.25, 0.8)]),
        "E": np.array([1.0, 1.0]),
        "U": np.array([2.0]),
        "W": np.array([0.002, 0.01]),
        "Q": np.diag([1.0, 0.1]),
        "R": np.array([[0.05]]),
        "schedule": np.stack([1 - shares, shares], axis=1),
        "horizon": 4,
        "start": np.array([0.2, 0.0]),
    }
    return LinearSystem(**(fields | changes))


def random_system(seed, states, inputs, vertices, **changes):
    """Return a system that is drawn: mildly unstable, its vertices some percent apart, with an LQR
    gain of their mean and disturbances of some percent."""
    random = np.random.default_rng(seed)
    A = np.linalg.qr(random.normal(size=(states, states)))[0] * random.uniform(0.8, 1.05)
    B = random.normal(size=(states, inputs))
    As = A + 0.02 * random.normal(size=(vertices, states, states))
    Bs = B + 0.02 * random.normal(size=(vertices, states, inputs))
    Q = np.eye(states)
    R = np.eye(inputs)
    mean = As.mean(axis=0)
    reach = Bs.mean(axis=0)
    P = solve_discrete_are(mean, reach, Q, R)
    K = -np.linalg.solve(R + reach.T @ P @ reach, reach.T @ P @ mean)
    fields = {
        "A": As,
        "B": Bs,
        "E": np.full(states, 1.0),
        "U": np.full(inputs, 2.0),
        "W": random.uniform(0.002, 0.01, states),
        "Q": Q,
        "R": R,
        "K": K,
        "schedule": random.dirichlet(np.ones(vertices), 5),
        "horizon": 3,
        "terminal_facets": 200,
    }
    return LinearSystem(**(fields | changes))


def stretch(system, states, inputs):
    """Return the system in other units: x and u multiplied by factors."""
    X = np.diag(states)
    back = np.diag(1 / states)
    U = np.diag(inputs)
    of_inputs = np.diag(1 / inputs)
    return LinearSystem(
        A=X @ system.A @ back,
        B=X @ system.B @ of_inputs,
        E=system.E.support(np.eye(system.states)) * states,
        U=system.U.support(np.eye(system.inputs)) * inputs,
        W=system.disturbance_set.support(np.eye(system.states)) * states,
        Q=back @ system.Q @ back,
        R=of_inputs @ system.R @ of_inputs,
        K=None if system.K is None else U @ system.K @ back,
        schedule=system.schedule,
        horizon=system.horizon,
        start=system.start * states,
        terminal_facets=system.terminal_facets,
    )


def mixtures(system, seed=0, count=50):
    """Return (A(th), B(th)) at the vertices and at schedules that are drawn."""
    random = np.random.default_rng(seed)
    weights = np.concatenate(
        [np.eye(len(system.A)), random.dirichlet(np.ones(len(system.A)), count)]
    )
    return [
        (
            sum(w * A for w, A in zip(row, system.A, strict=True)),
            sum(w * B for w, B in zip(row, system.B, strict=True)),
            row,
        )
        for row in weights
    ]
