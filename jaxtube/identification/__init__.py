"""From a robot's log to what its guarantee needs: clocks, noise, track, slips, and what of them a
sample can promise."""
