"""The command `replay`: `command.run`."""
