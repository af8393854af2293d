"""What a certificate says in words: its W, and what it takes for granted; part of
`check_certificate`, of the standard library alone."""

from math import degrees

from check_intervals import pick

ROBOT = ("period", "track", "lever_arm")


def is_of_robot(certificate):
    """Return whether W is said to be proved."""
    return all("cells" in band for band in certificate["bands"])


def show_disturbance(band):
    """Return the sizes of W in words."""
    yaw, box = pick(band["disturbance"], "yaw", "box")
    return f"kick, box: {', '.join(f'{float(each):.6g}' for each in (yaw, *box))} rad, m, m, rad"


def list_assumptions(certificate):
    """Yield in words what is taken for granted."""
    of_robot = is_of_robot(certificate)
    for band in () if of_robot else certificate["bands"]:
        yield f"{band['name']}: w lies in W ({show_disturbance(band)}), proved of no robot"
    for wheel, slips in certificate["slips"].items():
        for least, most, *seen in slips:
            shown = f"where {float(seen[0]):.6g} to {float(seen[1]):.6g} is compensated"
            if "measured" in certificate:
                constant, share = map(float, certificate["measured"][wheel])
                shown = f"measured within {constant:.4g} and {share:.4g} of it"
            yield f"{wheel} slip {float(least):.6g} to {float(most):.6g}, {shown}"
    if "learning" in certificate:
        change = float(certificate["learning"]["change"])
        yield f"a slip changes by at most {change:.4g} from one period to the next"
        yield "compensated is the centre of an interval in that of check_learning, the slip in it"
    T, b, lever = map(float, pick(certificate, *ROBOT))
    yield f"a robot of two wheels, {b:.6g} m apart, commanded every {T:.6g} s"
    if of_robot:
        slide = float(certificate["sideslip"])
        yield f"which slides by {slide:.4g} of its speed at most, and {lever:.4g} m by its yaw rate"
    how = "the way of check_motion" if of_robot else "V - u1 -+ (b/2) u2"
    yield f"wheels (right, left) are asked for {how} over ground, by the slip that is compensated"
    late = certificate.get("lateness")
    x, y, heading = map(float, late["noise"] if late else certificate["noise"])
    shown = f"{x:.4g} m, {y:.4g} m, {degrees(heading):.4g} deg"
    whose = "the robot's errors from where the reference was a latency before" if late else "errors"
    yield f"{whose} measured within {shown} in the robot's frame, without delay"
    if "estimate" in certificate:
        gain = ", ".join(f"{float(share):.6g}" for share in certificate["estimate"]["gain"])
        yield f"acted on is the estimate of check_estimate, at first what is measured, L = {gain}"
    for band in certificate["bands"]:
        for region in band["regions"]:
            shown = ", ".join(f"{float(speed):.6g}" for speed in region)
            kind = "right, left" if len(region) == 2 else "least, greatest; of their mean as well"
            yield f"{band['name']}: reference wheel speeds {shown} m/s ({kind})"
    if late:
        yield from list_lags(late, *certificate["bands"])
    elif of_robot:
        yield "slips, wheel speeds and reference constant over a period; wheels obey at once"
    if "cost" in certificate:
        yield "P, Q and R are those of the cost of the plans"
    yield f"what is proved holds at the ends of periods{show_latency(late)}, nothing in between"
    if "plans" not in certificate:
        yield "the law u = K e commands; the first measured error lies in the set of its band"
        return
    tolerance = float(certificate["plans"]["tolerance"])
    yield "the controller solves the QPs of this file, along the reference that they are in"
    yield f"plans that command miss no row of their QP by more than {tolerance:.3g} of its length"
    yield "a plan is found where there is one, in 64 bits, and its first input is commanded"
    yield "the first measured error lies within the caps of its band and has a plan"


def show_latency(late):
    """Return when else a promise holds of wheels that lag, in words."""
    if not late:
        return ""
    latency = float(sum(late["nominal"]))
    when = f"and {latency:.6g} s later, against where the reference was or is by then as late"
    return f" for the committed pose, and for the robot, then {when}"


def list_lags(late, band):
    """Yield in words what is taken for granted of wheels that lag, in their only band."""
    lags = show_range(late["lag"])
    yield f"both wheels lag by one constant time of {lags} s, linearly, without limits"
    delays = show_range(late["delay"])
    yield f"a command arrives {delays} s late, at both wheels at once, each by a delay of its own"
    yield "slips, commands and reference constant over a period"
    lag, delay = map(float, late["nominal"])
    shown = f"a lag of {lag:.6g} s and a delay of {delay:.6g} s"
    yield f"acted on is the committed pose of check_lag, for {shown}"
    right, left = map(show_range, pick(late["wheels"], "right", "left"))
    ranges = f"wheels {right} (right), {left} (left), body {show_range(late['speeds'])} m/s"
    yield f"commands before the start, and until a latency after the end, are as between: {ranges}"
    low, high = map(float, band["u2"])
    deficit = f"u2 of {low:.6g} to {high:.6g} rad/s"
    yield f"they turn at the yaw rate of the reference then, within its speeds, less {deficit}"
    yield "and are made for slips that are compensated as they are later"


def show_range(ends):
    """Return a range in words."""
    low, high = map(float, ends)
    return f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"
