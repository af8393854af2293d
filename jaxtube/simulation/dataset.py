"""Laps as an xarray Dataset: named dimensions, coordinates, units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxtube.coordinates import INPUT_NAMES, NAMES, SI_UNITS
from jaxtube.simulation.rollout import Trajectory


def import_xarray() -> Any:
    """Return xarray.

    Raises:
        ImportError: where it is not installed; the message says how to.
    """
    try:
        import xarray
    except ImportError as error:
        raise ImportError("xarray is not installed; pip install 'jaxtube[results]'") from error
    return xarray


def make_dataset(trajectory: Trajectory, dt: float, attributes: Mapping[str, str | int]) -> Any:
    """Return laps as an xarray Dataset.

    Args:
        trajectory: time first, then the laps.
        dt: period, s.
        attributes: of the whole, such as the seed.

    Raises:
        ImportError: as `import_xarray`.
    """
    diagnostics = trajectory.diagnostics
    by_error = ("instant", "lap", "coordinate")
    by_wheel = ("period", "lap", "wheel")
    by_period = ("period", "lap")
    instants, count, _ = trajectory.errors.shape
    variables = {
        "errors": (by_error, trajectory.errors, {"long_name": "true tracking errors"}),
        "measured": (by_error, trajectory.measured, {"long_name": "measured tracking errors"}),
        "inputs": (("period", "lap", "input"), trajectory.inputs),
        "wheels": (by_wheel, trajectory.wheels, {"units": "m/s"}),
        "demanded": (by_wheel, trajectory.demanded, {"units": "m/s"}),
        "qp_status": (by_period, diagnostics.status),
        "qp_residual": (by_period, diagnostics.residual),
        "active": (by_period, diagnostics.active),
        "backup": (by_period, diagnostics.backup),
    }
    coordinates = {
        "instant": ("instant", dt * np.arange(instants), {"units": "s"}),
        "period": ("period", dt * np.arange(instants - 1), {"units": "s"}),
        "lap": ("lap", np.arange(count)),
        "coordinate": ("coordinate", list(NAMES)),
        "unit": ("coordinate", list(SI_UNITS)),
        "input": ("input", list(INPUT_NAMES)),
        "wheel": ("wheel", ["right", "left"]),
    }
    return import_xarray().Dataset(variables, coordinates, dict(attributes))
