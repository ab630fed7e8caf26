"""NIFO in space: in the modal equations of either direction the force of a ring over its stiffness is a further input.

With the symbols of `annular_law`, q and the components in one direction,

    q'' + 2 zeta omega_0 q' + omega_0^2 q = phi_F F - sum_j phi_j k_j p_j
    p = max(0, r - d) (e + mu tanh(v_t / v_0) t)

so that each direction by itself tells the stiffness of every ring over frequency. Damping stands in the deviation from
the spectral mean. Contacts of one direction keep their penetration.
"""

from functools import partial

import numpy as np
from jaxtyping import Float

from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import CENTER, DAMPING, REST, STIFFNESS, ring_force_n
from identify.contacts.paper_methods import PaperMethods, SignalsByLaw, paper_methods, signals_by_law
from identify.contacts.separation import Separation
from identify.contacts.space_contacts import SpaceContacts
from identify.signals.law_evaluation import evaluated_law, law_step_s
from identify.signals.spectra import Averaging


def space_nifo(contacts: SpaceContacts, averaging: Averaging) -> tuple[PaperMethods, ...]:
    """Results of NIFO in y and in z; methods that fail are in the notes."""
    rate_hz = contacts.separations[0].motion.sample_rate_hz
    rings = {name: _ring_signals(estimate, rate_hz) for name, estimate in contacts.annular.items()}
    return tuple(
        paper_methods(
            separation.rig,
            separation.motion,
            _signals_in_direction(separation, contacts, {name: signals[:, axis] for name, signals in rings.items()}),
            (None,) * len(separation.rig.contacts),
            single_contacts=set(),
            averaging=averaging,
            equation=None,
            with_surfaces=False,
        )
        for axis, separation in enumerate(contacts.separations)
    )


def _ring_signals(estimate: AnnularEstimate, rate_hz: float) -> Float[np.ndarray, "3 2 samples"]:
    """Relative displacement less the centre, force less that at rest, and spring force with its friction over the
    stiffness, in y and z."""
    values = estimate.values.copy()
    values[CENTER] = 0.0
    motion, step_s = np.concatenate([estimate.eta_m, estimate.rate_m_per_s]), law_step_s(rate_hz)
    force_n = evaluated_law(partial(ring_force_n, values, step_s=step_s), motion, rate_hz)
    undamped = values.copy()
    undamped[[STIFFNESS, DAMPING]] = 1.0, 0.0
    force_over_stiffness_m = evaluated_law(partial(ring_force_n, undamped, step_s=step_s), motion, rate_hz)
    return np.stack([estimate.eta_m, force_n - values[REST, None], force_over_stiffness_m])


def _signals_in_direction(
    separation: Separation, contacts: SpaceContacts, ring_signals: dict[str, Float[np.ndarray, "3 samples"]]
) -> SignalsByLaw:
    """Signals of the contacts of a plane rig: of rings in its direction, and of contacts of one direction."""
    signals = signals_by_law(separation, contacts.plane)
    for contact_index, contact in enumerate(separation.rig.contacts):
        if contact.name in ring_signals:
            eta_m, force_n, force_over_stiffness_m = ring_signals[contact.name]
            signals.eta_m[contact_index] = eta_m
            signals.force_n[contact_index] = force_n
            signals.force_over_stiffness_m[contact_index] = force_over_stiffness_m
    return signals
