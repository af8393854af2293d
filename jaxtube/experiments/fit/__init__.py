"""The command `fit`: `command.run`."""
