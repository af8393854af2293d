"""Plants: `protocol.Plant` and its implementations in `slipping`, `linear` and `imperfect`."""
