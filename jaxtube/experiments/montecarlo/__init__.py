"""The command `montecarlo`: `command.run`."""
