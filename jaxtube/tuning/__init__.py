"""Tuning of weights and gains: algorithms around an objective that is expensive to evaluate."""
