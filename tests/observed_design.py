"""A design that acts on an estimate of an error that is measured with noise, as overrides of
`certified`."""

NOISY = ["noise.longitudinal_m=0.005", "noise.lateral_m=0.005", "noise.heading_deg=0.2"]
OBSERVED = [
    *NOISY,
    "controller.observer_gain=[0.45, 0.22, 0.9]",
    "controller.tracking_gains=[9.99, 8.435, 9.368]",
    "operating.longitudinal_m=0.131",
    "operating.lateral_m=0.238",
    "operating.heading_deg=14.95",
    "operating.speed_deficit_min_mps=-0.36",
    "operating.speed_deficit_max_mps=0.406",
    "operating.yaw_rate_deficit_radps=0.947",
    "operating.turning_longitudinal_m=0.138",
    "operating.turning_yaw_rate_radps=1.151",
]
