"""What a command says on the standard error beside what it waits for."""

BARS = ("simulating", "tuning", "drawing", "attacking", "searching", "driving")
"""First words of the bars of progress."""


def leave_out_waits(error: str) -> list[str]:
    """Return the lines of the standard error that tell of no wait."""
    lines = [line for line in error.splitlines() if line.strip()]
    return [line for line in lines if not line.endswith(" ...") and not line.startswith(BARS)]
