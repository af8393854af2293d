"""The command `identify`: `command.run`."""
