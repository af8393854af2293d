"""The command `animate`: `command.run`."""
