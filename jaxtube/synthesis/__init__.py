"""Designs from a scenario: `design.design`."""
