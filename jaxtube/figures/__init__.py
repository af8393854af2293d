"""Figures of laps, sets and usage, one function each."""
