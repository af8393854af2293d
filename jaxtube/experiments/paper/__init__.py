"""The command `paper`: `command.run`."""
