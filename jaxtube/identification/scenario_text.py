"""The scenario that an identified robot makes: `identified.toml`, every value with its source.

Intervals are rounded outwards. The reference is only a start: a figure-eight in the middle of the
speeds that were driven, whose circles are so wide that both wheels stay between the slowest and the
fastest of them.

Source: new.
"""

from __future__ import annotations

import math

from jaxtube.identification.commented_toml import (
    Line,
    round_down,
    round_near,
    round_up,
    write_comment,
    write_table,
)
from jaxtube.identification.findings import Findings, Noise
from jaxtube.identification.identify import Identified
from jaxtube.identification.words import say_promise, say_sample
from jaxtube.recordings.fingerprint import find_fingerprint
from jaxtube.scenario.tree import Constraints

MIDDLE_SPEED = 0.6
"""Of the fastest wheel speed: the speed of the reference that a search starts from."""

RADIUS_BY_TRACK = 5.0
"""Radius of the reference by effective track: wheels then differ from the speed by a tenth."""

BOX_SPARE = 1.02
"""By which the box of reference wheel speeds is wider than those of the circles."""

ROOM_BY_NOISE = 4.0
"""Half width of an error set by the bound of the noise, at least."""

LEAST_EXPLAINED_BY_LAG = 0.8
"""Of the wheels' spread, for a lag that is counted with."""

LATE_S = 0.01
"""From which on late poses count."""

SURE_EXPLAINED = 0.95
"""The same for the track width that commands are made to wheel speeds with."""


def write_scenario(
    identified: Identified,
    findings: Findings | None,
    track_width: float | None,
) -> str:
    """Return the text of identified.toml.

    Args:
        identified: of the windows.
        findings: of the log, None for a table of windows.
        track_width: between the wheels, m; None where it is not known.
    """
    head = [
        f"What was identified of {identified.windows.path}.",
        f"Its box of slips {say_promise(identified)}.",
        say_sample(identified),
        *_say_fingerprint(identified.windows.path),
        "Other wheel speeds, turns on the spot, reversing and other ground are not covered. "
        "Reference and controller are a start to search from.",
        *(f"To settle: {point}." for point in list_open_points(findings)),
    ]
    tables = {
        "robot": _robot(identified, findings, track_width),
        "slip": _slip(identified),
        "noise": _noise(findings.noise if findings else None),
        "constraints": _constraints(findings.noise if findings else None),
        "reference": _reference(identified),
        "initial": [
            Line("x_m", "0.0", "on the path"),
            Line("y_m", "0.0", ""),
        ],
        "disturbance": [Line("bound", '"computed"', "W is computed from all of the above")],
        "controller": _controller(),
    }
    header = "\n".join(write_comment(paragraph) for paragraph in head)
    texts = [header, *(write_table(name, lines) for name, lines in tables.items() if lines)]
    return "\n\n".join(texts) + "\n"


def _say_fingerprint(path: str) -> list[str]:
    """Return what tells this log from others, so that it is not taken for a witness of itself."""
    fingerprint = find_fingerprint(path)
    return [f"SHA-256 of the file begins with {fingerprint}."] if fingerprint else []


def list_open_points(findings: Findings | None) -> list[str]:
    """Return what the file does not know of a robot, and a certificate from it counts on."""
    points = []
    if findings is None or findings.noise is None:
        points.append(
            "noise: not identified, and 0 in the file: give the bound of your localisation"
        )
    response = findings.response if findings else None
    if response is None or response.explained < LEAST_EXPLAINED_BY_LAG:
        points.append(
            "robot.wheel_lag_s: not identified, and 0 in the file: give the least and the greatest"
        )
    if findings is not None and findings.clock.offset > LATE_S:
        late = findings.clock.offset
        points.append(
            f"robot.command_delay_s: poses are stamped {late:.3f} s after the wheels moved so, and "
            "the file takes it that the controller gets them in time; where it gets them as late, "
            f"add {late:.3f} to both ends"
        )
    return points


def find_track_width(
    identified: Identified, findings: Findings | None, given: float | None
) -> tuple[float, str]:
    """Return the distance between the wheels that a scenario names, m, and where it comes from."""
    if given is not None:
        return given, "between the wheels, as given"
    response = findings.response if findings else None
    if response is None or response.track_width is None:
        return identified.geometry.track, "not known (--track-m gives it): the effective one"
    if response.explained < SURE_EXPLAINED:
        return identified.geometry.track, "not known (--track-m gives it): the effective one"
    return response.track_width, "with which the robot's own driver makes commands to wheel speeds"


def _robot(
    identified: Identified, findings: Findings | None, track_width: float | None
) -> list[Line]:
    geometry = identified.geometry
    fitted = len(set(identified.windows.command[identified.fits].tolist()))
    width, said = find_track_width(identified, findings, track_width)
    return [
        Line("track_width_m", round_near(width), said),
        Line(
            "effective_track_m",
            round_near(geometry.track),
            f"{geometry.track / width:.3g} times that, +- {round_near(geometry.track_error)} m "
            f"(one standard deviation), fitted to {fitted} commands that the promise leaves out",
        ),
        Line(
            "lever_arm_m",
            round_near(geometry.lever_arm),
            f"v_y = {-geometry.lever_arm:+.4f} omega, +- {round_near(geometry.lever_arm_error)} m "
            "(one standard deviation), fitted to the same",
        ),
        *_lag(findings),
        Line(
            "wheel_speed_min_mps",
            round_up(identified.least_wheel),
            "slowest wheel that the promise covers",
        ),
        Line(
            "wheel_speed_max_mps",
            round_down(identified.fastest_wheel),
            "fastest wheel of the windows",
        ),
    ]


def _lag(findings: Findings | None) -> list[Line]:
    response = findings.response if findings else None
    if response is None or response.explained < LEAST_EXPLAINED_BY_LAG:
        reason = "no commands in the log, or too few changes of them"
        if response is not None:
            reason = (
                "a first-order lag explains only "
                f"{100 * max(response.explained, 0.0):.0f} % of how wheels follow commands"
            )
        said = f"NOT IDENTIFIED ({reason}): give the wheels' own, least and greatest"
        return [Line("wheel_lag_s", "[0.0, 0.0]", said)]
    least, greatest = response.lag_interval
    lines = [
        Line(
            "wheel_lag_s",
            f"[{round_down(least)}, {round_up(greatest)}]",
            f"wheels behind commands, first order: {response.lag:.3g} s in common, this is 90 % of "
            f"what {response.changes} changes vary; not part of the promise",
        )
    ]
    assert findings is not None
    if response.delay > findings.wheel_period:
        least = round_down(response.delay - findings.wheel_period)
        greatest = round_up(response.delay)
        said = "dead time of the commands, less the time between two rows; not part of the promise"
        lines.append(Line("command_delay_s", f"[{least}, {greatest}]", said))
    return lines


def _slip(identified: Identified) -> list[Line]:
    box = identified.widened_box
    margin = identified.choices.margin
    beyond = f", and {margin:g} that is not promised" if margin else ""
    noise = identified.slip_noise
    of_noise = (
        ""
        if noise is None
        else f"; pose noise alone spreads them by {noise:.2g} (one standard deviation)"
    )
    kind = {
        "each": "extremes of the windows that count",
        "alike": "extremes of both wheels in the windows that count",
        "scaled": "box of the fitted commands, blown up around the windows that count",
    }[identified.choices.box]
    lines = [
        Line(name, f"[{round_down(least)}, {round_up(greatest)}]", f"{kind}{beyond}{of_noise}")
        for name, (least, greatest) in (("right", box.right), ("left", box.left))
    ]
    said = (
        "greatest lateral speed by forward speed in the same windows, beside that of the lever "
        f"arm; {identified.geometry.crab:+.2g} of it is constant"
    )
    return [*lines, Line("sideslip", round_up(box.sideslip), said)]


def _noise(noise: Noise | None) -> list[Line]:
    if noise is None:
        said = "NOT IDENTIFIED: give the bound of your localisation"
        return [
            Line("frame", '"world"', ""),
            Line("longitudinal_m", "0.0", said),
            Line("lateral_m", "0.0", said),
            Line("heading_deg", "0.0", said),
        ]
    place, turn = noise.bound
    said = (
        f"that 99.5 % of {noise.poses} poses keep about parabolas through seven neighbours; slower "
        "drift of the localisation does not show in it"
    )
    degrees = round_up(math.degrees(turn))
    return [
        Line("frame", '"world"', ""),
        Line("longitudinal_m", round_up(place), said),
        Line("lateral_m", round_up(place), "the same"),
        Line("heading_deg", degrees, "the same"),
    ]


def _constraints(noise: Noise | None) -> list[Line]:
    """Return an error set that noise leaves something of; nothing where the usual one does."""
    if noise is None:
        return []
    place, turn = noise.bound
    usual = Constraints()
    return [
        Line(name, round_up(ROOM_BY_NOISE * bound), f"{ROOM_BY_NOISE:g} times the noise, a start")
        for name, bound in (
            ("longitudinal_m", place),
            ("lateral_m", place),
            ("heading_deg", math.degrees(turn)),
        )
        if ROOM_BY_NOISE * bound > getattr(usual, name)
    ]


def _reference(identified: Identified) -> list[Line]:
    speed = MIDDLE_SPEED * identified.fastest_wheel
    radius = RADIUS_BY_TRACK * identified.geometry.track
    differ = BOX_SPARE / (2 * RADIUS_BY_TRACK)
    slowest = max(speed * (1 - differ), identified.least_wheel)
    return [
        Line("radius_m", round_near(radius), f"{RADIUS_BY_TRACK:g} effective tracks, a start"),
        Line("speed_mps", round_near(speed), f"{MIDDLE_SPEED:g} of the fastest wheel, a start"),
        Line("wheel_speed_min_mps", round_down(slowest), "of the circles, with a little to spare"),
        Line("wheel_speed_max_mps", round_up(speed * (1 + differ)), "the same"),
    ]


def _controller() -> list[Line]:
    return [
        Line("dt_s", "0.1", "as in the scenario `certified`, and all that follows"),
        Line("error_weight", "[1.0, 3.0, 1.0]", ""),
        Line("input_weight", "[0.3, 0.3]", ""),
        Line("model", '"exact_jacobian"', ""),
        Line("input_map", '"x_exact"', ""),
        Line("tube", '"sequence"', ""),
        Line("terminal", '"T-A"', ""),
    ]
