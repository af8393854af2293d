"""The command `tune`: `command.run`."""
