"""The command `guarantee`: `command.run`."""
