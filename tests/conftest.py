"""All tests run in float64 with strict promotion: a silent cast is an error."""

import functools
import gc
import os
import shutil
import tempfile
from pathlib import Path

from jaxtube.experiments import environment

environment.compile_quickly()
environment.use_one_thread_for_linear_algebra()

import jax  # noqa: E402 -- it reads the environment
import pytest  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Programs and designs are kept to the end: to look for garbage among them often finds little.
gc.set_threshold(100_000)

COMPILED = "JAX_COMPILATION_CACHE_DIR"
"""Variable of the environment that names the folder of compiled programs."""
MOST_BYTES = 500_000_000
"""Of compiled programs that are kept from run to run: some seven times those of one run."""
LEFT_OUT = (
    "simplify-while-loops",
    "while-loop-invariant-code-motion",
    "while-loop-constant-sinking",
    "simplify-conditional",
    "tree_reduction_rewriter",
    "reshape-mover",
)
"""Passes of XLA without which a large program is compiled in three quarters of the time; they look
again and again for loops that could run faster."""


def pytest_configure(config):
    """Compile quickly what runs once or twice; long tests compile as users do.

    Both workers, the commands that tests start, and the runs to come share what they compile.
    """
    if config.option.markexpr == "not slow":
        environment.add_xla_flags(f"--xla_disable_hlo_passes={','.join(LEFT_OUT)}")
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # of commands that tests start
        jax.config.update("jax_disable_most_optimizations", True)
    if COMPILED not in os.environ:
        environment.keep_compiled_programs(_find_home_of_programs(config))
        _forget_oldest(Path(os.environ[COMPILED]))
    jax.config.update("jax_compilation_cache_dir", os.environ[COMPILED])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _find_home_of_programs(config) -> Path:
    """Return where compiled programs lie: in pytest's cache, or for this run alone without it."""
    cache = getattr(config, "cache", None)  # absent under `-p no:cacheprovider`
    if cache is not None:
        return cache.mkdir("compiled")
    folder = tempfile.mkdtemp(prefix="jaxtube-compiled-")
    config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
    return Path(folder)


def _forget_oldest(folder: Path) -> None:
    """Remove the oldest programs beyond MOST_BYTES."""
    files = [(path, path.stat()) for path in folder.glob("*")]
    room = MOST_BYTES
    for path, facts in sorted(files, key=lambda file: file[1].st_mtime, reverse=True):
        room -= facts.st_size
        if room < 0:
            path.unlink(missing_ok=True)


# Designs and closed loops that several files look at: computed once, and compiled once for one
# shape.


@pytest.fixture(scope="session")
def paper_design(uncertified):
    """The design of the scenario `paper`, without its certificate."""
    return uncertified("paper")


@pytest.fixture(scope="session")
def certified_paper_design():
    """The design of the scenario `paper`, with its certificate."""
    from jaxtube.scenario import load
    from jaxtube.synthesis.design import design

    return design(load("paper"))


@pytest.fixture(scope="session")
def robust_design():
    """The design of the scenario `robust`, with its certificate."""
    from jaxtube.scenario import load
    from jaxtube.synthesis.design import design

    return design(load("robust"))


@pytest.fixture(scope="session")
def uncertified():
    """Design a scenario under overrides without the certificate, which takes longer than all the
    rest."""
    from jaxtube.scenario import load
    from jaxtube.synthesis.design import design
    from sets.certificate import Certificate

    @functools.cache
    def make(name, *overrides):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("jaxtube.synthesis.design.certify", lambda *sets: Certificate())
            return design(load(name, overrides))

    return make


@pytest.fixture(scope="session")
def edge_starts():
    """Starts of a design's tube-MPC, most of them close to the edge of its feasible set."""
    from jaxtube.synthesis.feasible import boundary, spread_starts

    def draw(design, count, edge_share=0.5):
        points = boundary(
            design.tube_qps, int(design.windows.index[0]), design.problem.error_set, 200, seed=3
        )
        return spread_starts(points, count, 4, edge_share)

    return draw


@pytest.fixture(scope="session")
def stressed(robust_design, edge_starts):
    """Tube-MPC and MPC without tube from the same 256 starts, on the linear plant of `robust` with
    w in W."""
    from jaxtube.simulation import batches, components

    controllers = components.controllers(robust_design)
    plant = components.linear_plant(robust_design)
    starts = edge_starts(robust_design, batches.BATCH)
    return {
        name: batches.run_realisations(controllers[name], plant, starts, 5)
        for name in ("tube_mpc", "plain_mpc")
    }


@pytest.fixture(scope="session")
def paper_laps(paper_design):
    """256 laps of the paper's tube-MPC on the slipping robot."""
    import numpy as np

    from jaxtube.simulation import batches, components

    starts = np.tile(paper_design.problem.initial_error, (batches.BATCH, 1))
    controller = components.controllers(paper_design)["tube_mpc"]
    return batches.run_realisations(controller, components.slipping_robot(paper_design), starts, 0)
