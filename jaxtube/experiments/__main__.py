"""`python -m jaxtube.experiments`: sets what jax has to be told before it is imported, then runs
the command line."""

import sys

from jaxtube.experiments import environment
from jaxtube.experiments.cli import INTERRUPTED_LINE, main
from jaxtube.experiments.run.exit_codes import ExitCode

if __name__ == "__main__":
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
