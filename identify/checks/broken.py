"""A broken tolerance in words."""

from identify.checks.findings import Cause, Finding, spoken
from identify.checks.pulls import Broken
from identify.linear.nuisance import THE_FORCE


def broken_finding(found: Broken) -> Finding:
    """Finding in words."""
    what, size = found.what, found.size * found.what.unit
    asked = f"({abs(found.size):.0f} tolerances)"
    if what.kind == "clock":
        return Finding(
            cause="clock",
            evidence=f"all modes of all bodies lie {100 * size:+.2g} % off the frequencies of rig.json",
            mend="check the sampling rate: a clock that is off shifts all frequencies alike",
        )
    if what.kind == "force gain":
        return Finding(
            cause="gain",
            channels=("force" if what.of == THE_FORCE else what.of,),
            evidence=f"{what.of} is {100 * size:+.2g} % off what all sensors imply {asked}",
            mend="calibrate the load cell, or check all masses of rig.json",
        )
    if what.kind == "force delay":
        return Finding(
            cause="delay",
            channels=(what.of,),
            evidence=f"{spoken(what.of)} comes {1e3 * abs(size):.2g} ms {'late' if size > 0 else 'early'} against all "
            "sensors",
            mend="synchronise the force's clock with the sensors'",
        )
    if what.kind in ("mass", "density"):
        return Finding(
            cause="mass",
            of=what.of,
            evidence=f"{what.of} moves as if its {what.kind} were {100 * size:+.2g} % off rig.json {asked}",
            mend="weigh it and correct rig.json",
        )
    if what.kind in ("frequency", "damping"):
        return Finding(
            cause="frequency" if what.kind == "frequency" else "damping",
            of=what.of,
            evidence=f"the {what.kind} of {what.of} is {100 * size:+.2g} % off rig.json {asked}",
            mend="fit rig.json to a modal test, or widen its tolerance if it is known no better",
        )
    sizes = {
        "gain": f"is {100 * size:+.2g} % off in gain against the others and the model",
        "position": f"moves as if it stood {1e3 * size:+.3g} mm from its station",
        "delay": f"comes {1e3 * abs(size):.2g} ms {'late' if size > 0 else 'early'} against the others",
        "high-pass": f"is high-passed at about {abs(size):.2g} Hz",
    }
    mends = {
        "gain": "calibrate it again",
        "position": "measure its place and correct rig.json",
        "delay": f"set delay_s = {size:.2g} in rig.json, or synchronise its clock",
        "high-pass": "take the coupling off, or widen high_pass_hz of its tolerance",
    }
    causes: dict[str, Cause] = {"gain": "gain", "position": "station", "delay": "delay", "high-pass": "filtered"}
    return Finding(
        cause=causes[what.kind],
        channels=(what.of,),
        evidence=f"{what.of} {sizes[what.kind]} {asked}",
        mend=mends[what.kind],
    )
