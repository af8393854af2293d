"""The command `maps`: `command.run`."""
