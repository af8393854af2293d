"""The command `beyond`: `command.run`."""
