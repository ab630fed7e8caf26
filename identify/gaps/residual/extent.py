"""The part of a recording that the diagnosis looks at: beginning, length, and highest frequency."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.contacts.separation import driven_to_hz
from identify.gaps.residual.ringing import rings_to_hz
from identify.signals.beginning import QUIET_S, at_rest_until
from identify.signals.kinematics import kinematics
from identify.signals.spectra import force_band
from rig.errors import RigError
from rig.model.description import Rig, Sensor, contact_stations
from rig.model.sensing import PASSBAND
from rig.model.tolerances import Tolerances
from rig.recording import Recording

TAPER_S = 0.5
LEFT_OUT_S, SHARE_LEFT_OUT = 4.5, 0.45
"""At the record's end, where the taper, and integration, falsify every residual; of a record at most this share."""
FADED, SHARE_FADED = 1.5, 0.1
"""What is left out at a faded end where nothing is integrated, and at a faded beginning where nothing rings either, as
a multiple of the fade; which is no longer than this share of the record."""
RELEASED_S = 2.0
"""At the start of a free decay of elastic bodies with contacts: a period of `CORNER_HZ`."""
SETTLES_S = 0.05
"""So long before the force a quiet start ends."""
REACH = 1.6
"""The diagnosis looks up to this multiple of the force's highest frequency."""
OF_MOST, MOST = 2.0, 0.9
"""But no further than this multiple of the frequency below which so much of the force's power lies: a hammer's falls
slowly with the frequency."""
SHORTEST_S, SHORTEST_WHOLE_S = 10.0, 1.0
"""No record is shorter; the second holds of one that counts from its first sample on and is not integrated."""
DECAYED, LEAST_S = 0.03, 4.0
"""A record counts until its last second with more than this share of the loudest one's acceleration, and at least for
so long: what contacts of a rig do that has come to rest, accelerometers do not show."""


@dataclass(frozen=True)
class Beginning:
    """The beginning of a record, and what of it has to be integrated.

    integrates: the relative displacements at contacts follow from other derivatives. from_the_blow: a free motion that
    is estimated with its beginning; it counts from the first sample on where there are no contacts. free: all bodies
    are masses that nothing holds, so that nothing rings.
    excited_from is the first sample at which a force acts; the quiet samples before it tell the noise.
    """

    zero_known: bool
    contacts: bool
    integrates: bool
    from_the_blow: bool
    free: bool
    excited_from: int
    quiet_samples: int
    faded_s: float
    duration_s: float

    @property
    def quiet(self) -> bool:
        return self.quiet_samples > 0

    @property
    def left_out_s(self) -> tuple[float, float]:
        """Seconds left out at the beginning and at the end."""
        rings = not self.free and (self.contacts or not self.from_the_blow)
        at_end_s = min(LEFT_OUT_S, SHARE_LEFT_OUT * self.duration_s) if rings else FADED * self.faded_s
        if self.quiet:
            return 0.0, at_end_s
        if self.from_the_blow:
            return RELEASED_S * self.contacts, at_end_s
        return at_end_s if self.free else LEFT_OUT_S, at_end_s


def beginning_of(recording: Recording, sensors: tuple[Sensor, ...]) -> Beginning:
    rig, rate = recording.rig, recording.rig.sample_rate_hz
    zero_known = all(s.measures.order == 0 for s in sensors)
    contacts, elastic = bool(rig.contacts), not any(b.is_mass for b in rig.bodies)
    integrates = contacts and not zero_known
    excited_from = at_rest_until(recording.forces_n, (recording.values_of(s) for s in sensors), rate)
    before = excited_from - round(SETTLES_S * rate)
    from_the_blow = not np.any(recording.forces_n) and not integrates and (elastic or not contacts)
    faded_s = 2 * TAPER_S if zero_known and not from_the_blow else TAPER_S
    return Beginning(
        zero_known=zero_known,
        contacts=contacts,
        integrates=integrates,
        from_the_blow=from_the_blow,
        free=zero_known and all(is_free(rig, b.name) for b in rig.bodies),
        excited_from=excited_from,
        quiet_samples=before if before > QUIET_S * rate else 0,
        faded_s=faded_s if contacts else min(faded_s, SHARE_FADED * recording.duration_s),
        duration_s=recording.duration_s,
    )


def check_length(recording: Recording, beginning: Beginning) -> None:
    """Raises RigError if a record is too short."""
    whole = not beginning.contacts and (beginning.quiet or beginning.from_the_blow)
    shortest_s = SHORTEST_WHOLE_S if whole else SHORTEST_S
    if recording.duration_s < shortest_s:
        raise RigError(
            f"the record lasts {recording.duration_s:.3g} s; the diagnosis needs {shortest_s:g} s, better "
            f"{'some' if whole else '30'} s or more"
        )


def high_hz_of(
    recording: Recording,
    sensors: tuple[Sensor, ...],
    densities: Float[np.ndarray, " sensors"],
    tolerances: Tolerances,
    low_hz: float,
) -> float:
    """Up to where the diagnosis looks; raises RigError if nothing above `low_hz` is excited."""
    rate = recording.rig.sample_rate_hz
    if np.any(recording.forces_n):
        excited_hz = _excited_hz(recording.forces_n, rate)
    elif recording.rig.contacts:
        excited_hz = REACH * driven_to_hz(kinematics(recording, sensors[0].quantity, least_order=0))
    else:
        rows = np.stack([recording.values_of(s) for s in sensors])
        excited_hz = REACH * rings_to_hz(rows, rate, sensors[0].measures.order, densities)
    high_hz = min(excited_hz, PASSBAND * rate, tolerances.highest_hz or np.inf)
    if high_hz <= low_hz:
        raise RigError(
            f"the force excites the rig up to {high_hz:.2g} Hz alone; the diagnosis needs more than {low_hz:g} Hz: "
            "look at the force's channel"
        )
    return high_hz


def _excited_hz(forces_n: Float[np.ndarray, "forces samples"], rate_hz: float) -> float:
    """Up to where a force is taken to excite the rig."""
    return max(
        min(REACH * force_band(row, rate_hz)[1], OF_MOST * force_band(row, rate_hz, 1 - MOST)[1])
        for row in forces_n
        if np.any(row)
    )


def is_free(rig: Rig, body: str) -> bool:
    """True if a body is a mass that nothing holds."""
    own = rig.body(body)
    held = [s.station for s in rig.springs] + [s for c in rig.contacts for s in contact_stations(c)]
    return own.is_mass and bool(own.rigid_modes) and all(s.body != body for s in held)


def decayed_s(rows: Float[np.ndarray, "sensors times"], rate_hz: float) -> float:
    """End of the last second in which the rig still moves, s; raises RigError if it never does."""
    second = max(1, round(min(1.0, rows.shape[1] / rate_hz / 4) * rate_hz))
    whole = rows.shape[1] // second
    power = (rows[:, : whole * second] ** 2).sum(axis=0).reshape(whole, second).mean(axis=1)
    moving = np.flatnonzero(power > DECAYED**2 * power.max())
    if not moving.size:
        raise RigError("the sensors show no motion; look at their channels")
    last = int(moving[-1]) + 1
    return np.inf if last == whole else last * second / rate_hz
