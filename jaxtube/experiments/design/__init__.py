"""The command `design`: `command.run`."""
