"""The statistics of a Monte Carlo run as a NetCDF file, which xarray and others open."""

from __future__ import annotations

from pathlib import Path

from jaxtube.atomic import write_atomically
from jaxtube.scenario.refusal import refusal
from jaxtube.statistics.montecarlo import MonteCarlo


def require_libraries() -> None:
    """Raise ScenarioError, one line, where xarray, or what it writes NetCDF with, is not
    installed."""
    try:
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
        import xarray  # noqa: F401
    except ImportError as error:
        problem = f"{error.name} is not installed"
        cure = "pip install 'jaxtube[results]'"
        raise refusal("command line", "--netcdf", True, problem, cure) from None


def save(path: Path, run: MonteCarlo) -> None:
    """Write the dataset of a run as NetCDF; the file appears complete or not at all.

    Raises:
        ScenarioError: as `require_libraries`.
        OSError: where the file cannot be written.
    """
    require_libraries()
    dataset = run.to_xarray()
    write_atomically(path, lambda file: dataset.to_netcdf(file.name, engine="h5netcdf"))
