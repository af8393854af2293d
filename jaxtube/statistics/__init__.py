"""Statistics of many laps: `montecarlo.montecarlo`."""
