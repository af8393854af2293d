"""The exit codes of the command line."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sets.certificate import Certificate


class ExitCode(IntEnum):
    """What a command ends with."""

    DONE = 0
    METRIC_OFF = 1
    """A checked metric is off."""
    NOT_READY = 1
    """`doctor`: something that is needed is missing or wrong."""
    BAD_INPUT = 2
    BROKEN_OFF = 2
    """The descent of `tune` broke off."""
    NO_GUARANTEE = 3
    """A tightened set is empty; or the certificate fails, where one is required."""
    INTERRUPTED = 4
    """Interrupted, or stopped by a full disk; the same command goes on."""


def exit_code(certificate: Certificate, required: bool) -> ExitCode:
    """Return the exit code that a certificate leads to, where one is required."""
    fails = required and not certificate.holds_for_robot
    return ExitCode.NO_GUARANTEE if fails else ExitCode.DONE
