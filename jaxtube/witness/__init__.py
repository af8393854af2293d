"""A log as the witness of a scenario: whether the slips, sideslip and noise that a scenario allows
explain how a robot really moved."""
