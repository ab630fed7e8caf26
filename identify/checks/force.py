"""What is wrong with the measured force, by the force that all sensors imply."""

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Finding
from identify.checks.prediction import driven_by
from identify.checks.relations import FOLLOWS, bandwise, relation, usual_factor
from identify.checks.spectra import Spectra


def force_finding(
    spectra: Spectra, implied: Complex[np.ndarray, " lines"], weight: Float[np.ndarray, " lines"]
) -> Finding:
    """What is wrong with the measured force, by the force that all sensors imply."""
    driven = driven_by(spectra)
    omega, measured, implied, weight = (x[driven] for x in (spectra.omega, spectra.force, implied, weight))
    own = relation(omega, measured, implied, weight)
    gains, left, middle = bandwise(omega, measured, implied, weight)
    size = np.abs(gains)
    if left < 0.3 and 1 - own.coherence > 2.5 * left and size.max() > 1.25 * size.min():
        falls = size[-1] < size[0]
        return Finding(
            cause="filtered",
            channels=("force",),
            evidence=f"the force is {size[0]:.3g} times what all sensors imply at {middle[0] / (2 * np.pi):.3g} Hz and "
            f"{size[-1]:.3g} times at {middle[-1] / (2 * np.pi):.3g} Hz: "
            f"{'it' if falls else 'all sensors'} went through "
            "a low-pass",
            mend="undo the filter, or put the force and the sensors through the same",
        )
    if own.coherence < FOLLOWS:
        return Finding(
            cause="force",
            channels=("force",),
            evidence=f"the force channel explains {100 * max(own.coherence, 0):.2g} % of the force that moves the rig "
            "by all sensors",
            mend="check that it is the channel of the load cell, and of this record",
        )
    if own.gain < 0:
        return Finding(
            cause="polarity",
            channels=("force",),
            evidence=f"the force has the opposite sign of what all sensors imply (gain {own.gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    units = usual_factor(own.gain)
    if units:
        return Finding(
            cause="units",
            evidence=f"all sensors deliver {1 / own.gain:.4g} times what the force and the masses of rig.json make",
            mend=f"correct the unit of the sensors or of the force in the import map; it looks like {units}",
        )
    if abs(own.delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=("force",),
            evidence=f"the force comes {1e3 * abs(own.delay_s):.3g} ms {'late' if own.delay_s > 0 else 'early'} "
            "against all sensors",
            mend="synchronise the force's clock with the sensors', or shift its column",
        )
    return Finding(
        cause="gain",
        channels=("force",),
        evidence=f"the force is {own.gain:.4g} times what all sensors and the masses of rig.json imply",
        mend="calibrate the load cell, or check all masses of rig.json",
    )
