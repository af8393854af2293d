"""The command `bench`: `command.run`."""
