"""What each figure of a run folder shows, and how it is read."""

from __future__ import annotations

CAPTIONS = {
    "trajectories": "Paths in the world, whole and magnified where they begin and lie apart.",
    "errors": "Tracking errors over time: median, and the band that holds all laps. Dashed: E.",
    "wheel_speeds": "Wheel speeds over time, the whole lap and its beginning, beside the "
    "reference.",
    "margins": "How much of its limit each lap left unused where it came nearest: 0 is the limit, "
    "below it the lap left E.",
    "tube_sections": "Sections of the tubes. A smaller one leaves more room to the plan.",
    "tightened_sets": "What is left of the limits, stage by stage, once the tube is taken off.",
    "terminal_set": "The set in which plans must end, with the largest invariant set around it.",
    "stress_terminal_set": "The terminal set of the design under stress.",
    "realisations_in_tube": "How far plans that were followed deviate from their prediction: dots "
    "outside a section are what the tube does not cover.",
    "stress": "Starts all over the feasible set: the largest share of a limit over time, and the "
    "starts from which laps leave E.",
    "sets": "Limits, tube and terminal set of the design, projected onto pairs of errors.",
    "violations": "Shares of laps and steps with each event, with their exact bounds.",
    "error_quantiles": "Quantiles of the errors over the laps at each step, and the largest of "
    "all.",
    "disturbance": "How the disturbance w is distributed, against the set W that is assumed or "
    "proved.",
    "map": "How often each error was met: where laps spend their time, and the limits around it.",
    "tube_cloud": "Deviations of followed plans, against the sections of the tube.",
    "coverage": "Starts of the laps over the feasible set, and where laps from there left E.",
    "worst": "The lap that used most of E: path, errors, wheels, slips and disturbances.",
    "laws": "Shares of laps and steps outside W and E under each law, design by design.",
    "slip_over_time": "Slips of each window over the log.",
    "slip_by_speed": "Slips by wheel speed, with the box that is promised.",
    "ground_by_wheel": "Speeds over ground by wheel speed: the slope is 1 less the slip.",
    "box": "Where the sides of the box of slips come from.",
    "prediction": "Motion predicted with what was identified, beside what was measured.",
    "learning": "The objective over the iterations, on the laps tuned on and on others.",
    "tube": "The tube before and after.",
    "parameters": "Weights and gains over the iterations.",
    "front": "Error against effort of what was tried.",
    "comparison": "Ways to tune, on paths that tuning never saw.",
    "frontier": "How the tube fills its caps towards the border, and the border by a second "
    "quantity.",
    "beyond": "What laps use of W and E as the robot becomes less perfect.",
    "histograms": "How the disturbances of the log are distributed, against the scenario's sets.",
    "slips": "Slips of the log's windows, against what the scenario allows.",
    "path": "The path, its missions and their speeds.",
    "feasible_set": "The feasible set by the horizon, beside the largest control invariant set.",
    "latency": "Time of a single step: how often it takes longer than so much.",
    "scale": "Speed by laps, cores, share of active rows, and horizon.",
    "qp_accuracy": "Accuracy against time of the solvers.",
}
"""By name of the figure."""


def find_caption(name: str) -> str:
    """Return the caption of a figure; "" for one that its title explains."""
    return CAPTIONS.get(name, "")
