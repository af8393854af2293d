"""The command `path`: `command.run`."""
