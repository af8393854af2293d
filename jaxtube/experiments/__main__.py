"""`python -m jaxtube.experiments`, or `jaxtube`: sets what jax has to be told before it is
imported, then runs the command line."""

import sys
from typing import NoReturn

from jaxtube.experiments import environment

try:
    from jaxtube.experiments.cli import INTERRUPTED_LINE, main
except ModuleNotFoundError as error:
    sys.exit(
        f"{sys.executable}: {error.name} is not installed there; give the python of the "
        "environment that jaxtube was installed in, such as .venv/bin/python"
    )
from jaxtube.experiments.run.exit_codes import ExitCode


def start() -> NoReturn:
    """Run the command line in a process of its own, as `jaxtube` does, and end that process."""
    environment.print_any_character()
    environment.use_float64()
    environment.use_one_thread_for_linear_algebra()
    environment.compile_quickly()
    environment.keep_compiled_programs()
    environment.search_garbage_rarely()
    environment.end_after_interrupt(INTERRUPTED_LINE, ExitCode.INTERRUPTED)
    code = main()
    if code == ExitCode.INTERRUPTED:
        environment.leave(code)
    sys.exit(code)


if __name__ == "__main__":
    start()
