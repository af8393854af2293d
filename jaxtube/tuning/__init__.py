"""Tuning of weights and gains by gradients through laps and through the tube."""
