"""Closed loops over the whole reference: `simulate.simulate`."""
