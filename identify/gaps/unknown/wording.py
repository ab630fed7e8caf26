"""One sentence on an unmeasured force."""

from identify.gaps.unknown.force import UnknownForce

ALONE = 0.5
"""A force is random if it is at least this share of itself before the excitation begins."""


def sentence(found: UnknownForce) -> str:
    """Such as "a force at 50.0 Hz, 1.4 N, on the cradle near 0.80 m"."""
    if found.kind == "sensor":
        return f"a fault of sensor {found.sensor}: its signal does not follow the motion"
    if found.kind == "distributed":
        changes = " and ".join(
            f"of the {body} by {100 * growth.value:+.2g} %"
            for body, growth in zip(found.bodies, found.growth, strict=True)
        )
        return f"a stiffness that changes over the record, {changes}"
    where = f"on the {found.body} near {found.position_m.value:.2f} m"
    if found.kind == "pair":
        where = (
            f"between the {found.body} near {found.position_m.value:.2f} m and the {found.against_body} near "
            f"{found.against_position_m:.2f} m"
        )
    if found.frequency_hz is not None:
        return f"a force at {found.frequency_hz:.1f} Hz, {found.amplitude_n:.2g} N, {where}"
    if not found.law:
        low, high = found.band_hz
        when = {"always": "", "in contact": ", while contacts are closed", "growing with time": ", growing with time"}
        what = "a random force" if found.before_excitation > ALONE else "a force by no law that was tried,"
        return f"{what} from {low:.3g} to {high:.3g} Hz, {found.rms.value:.2g} N rms, {where}{when[found.when]}"
    return f"{_LAWS[found.law_name].format(where=where)}, {found.law}"


_LAWS = {
    "Coulomb friction": "friction {where}",
    "viscous damping": "a force {where} that grows with the velocity",
    "quadratic drag": "a force {where} that grows with the square of the velocity",
    "cubic damping": "a force {where} that grows with the cube of the velocity",
    "power of the velocity": "a force {where} that grows with a power of the velocity",
    "linear spring": "a spring {where}",
    "cubic spring": "a spring {where} whose stiffness changes with the displacement",
    "softening spring": "a softening spring {where}",
    "stop": "a stop {where}",
    "stop on one side": "a stop on one side {where}",
}
"""By the name of the law."""
