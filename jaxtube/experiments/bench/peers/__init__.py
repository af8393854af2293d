"""Solvers beside which the batched one is measured: `catalogue.find_peers`."""
