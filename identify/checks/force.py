"""Findings on the measured force, by the force that all sensors imply."""

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Finding, spoken
from identify.checks.prediction import driven_by
from identify.checks.relations import FOLLOWS, bandwise, relation, usual_factor
from identify.checks.spectra import Spectra


def force_finding(
    spectra: Spectra, number: int, implied: Complex[np.ndarray, " lines"], weight: Float[np.ndarray, " lines"]
) -> Finding:
    """Finding on the measured force of that number, by the one that all sensors, and other forces, imply."""
    name, several = spectra.force_names[number], len(spectra.forces) > 1
    force = spoken(name)
    driven = driven_by(spectra.forces)[number]
    omega, measured, implied, weight = (x[driven] for x in (spectra.omega, spectra.forces[number], implied, weight))
    own = relation(omega, measured, implied, weight)
    gains, left, middle = bandwise(omega, measured, implied, weight)
    size = np.abs(gains)
    if left < 0.3 and 1 - own.coherence > 2.5 * left and size.max() > 1.25 * size.min():
        falls = size[-1] < size[0]
        return Finding(
            cause="filtered",
            channels=(name,),
            evidence=f"{force} is {size[0]:.3g} times what all sensors imply at {middle[0] / (2 * np.pi):.3g} Hz and "
            f"{size[-1]:.3g} times at {middle[-1] / (2 * np.pi):.3g} Hz: "
            f"{'it' if falls else 'all sensors'} went through "
            "a low-pass",
            mend="undo the filter, or put the force and the sensors through the same",
        )
    if own.coherence < FOLLOWS:
        return Finding(
            cause="force",
            channels=(name,),
            evidence=f"{name if several else 'the force channel'} explains {100 * max(own.coherence, 0):.2g} % of the "
            "force that moves the rig by all sensors",
            mend="check that it is the channel of the load cell, and of this record",
        )
    if own.gain < 0:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{force} has the opposite sign of what all sensors imply (gain {own.gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    units = usual_factor(own.gain)
    if units:
        factor, whose = (own.gain, "it") if several else (1 / own.gain, "the sensors or of the force")
        evidence = f"{name} is {factor:.4g} times what all sensors and the other forces imply"
        if not several:
            evidence = f"all sensors deliver {factor:.4g} times what the force and the masses of rig.json make"
        return Finding(
            cause="units",
            channels=(name,) if several else (),
            evidence=evidence,
            mend=f"correct the unit of {whose} in the import map; it looks like {units}",
        )
    if abs(own.delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{force} comes {1e3 * abs(own.delay_s):.3g} ms {'late' if own.delay_s > 0 else 'early'} "
            "against all sensors",
            mend="synchronise the force's clock with the sensors', or shift its column",
        )
    return Finding(
        cause="gain",
        channels=(name,),
        evidence=f"{force} is {own.gain:.4g} times what all sensors and the masses of rig.json imply",
        mend="calibrate the load cell, or check all masses of rig.json",
    )
