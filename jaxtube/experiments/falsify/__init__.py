"""The command `falsify`: `command.run`."""
