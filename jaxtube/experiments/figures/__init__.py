"""The command `figures`: `command.run`."""
