"""The command `coverage`: `command.run`."""
