"""From any measured quantity to displacement, velocity and acceleration."""

import msgspec
import numpy as np
import pytest

from identify.kinematics import CORNER_HZ, Kinematics, acceleration_noise, kinematics, slow_acceleration
from rig.contact import DeadZone
from rig.description import Contact, Rig, Sensor, Station
from rig.errors import RigError
from rig.oscillator import Oscillator
from rig.recording import Channels, Recording, Signals
from rig.sensors import PASSBAND

RATE_HZ = 512.0
DURATION_S = 16.0
MASS = Station("mass")
ORDERS = {"displacement": 0, "velocity": 1, "acceleration": 2}
TONES = ((3e-3, 1.3, 0.2), (1e-3, 17.0, 1.0), (2e-5, 150.0, 2.0))
"""Amplitude (m), frequency (Hz), phase."""
SLOW = ((5e-3, 0.1, 0.4),)


def moved(order, time_s, tones=TONES):
    """The order-th derivative of tones that set in over three seconds after the first; the product rule written out."""
    phase = np.pi / 2 * np.clip((time_s - 1) / 3, 0, 1)
    rate = np.where((time_s > 1) & (time_s < 4), np.pi / 6, 0.0)
    s, c = np.sin(phase), np.cos(phase)
    rise = (s**8, 8 * rate * s**7 * c, 8 * rate**2 * (7 * s**6 * c**2 - s**8))
    total = np.zeros(time_s.size)
    for amplitude, frequency_hz, shift in tones:
        omega = 2 * np.pi * frequency_hz
        tone = [amplitude * omega**n * np.sin(omega * time_s + shift + n * np.pi / 2) for n in range(3)]
        total += {
            0: rise[0] * tone[0],
            1: rise[1] * tone[0] + rise[0] * tone[1],
            2: rise[2] * tone[0] + 2 * rise[1] * tone[1] + rise[0] * tone[2],
        }[order]
    return total


def sensor(quantity, **chain):
    return Sensor(name=quantity, station=MASS, quantity=quantity, **chain)


def recorded(*sensors, tones=TONES, duration_s=DURATION_S, rng=None, quiet_s=1.0):
    """What these sensors of one mass deliver: gain times the motion of delay_s ago, and noise."""
    law = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4)
    rig = Rig(
        name="r",
        bodies=(Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01),),
        contacts=(Contact(name="stop", at=MASS, against=None, law=law),),
        force_at=MASS,
        sensors=sensors,
        sample_rate_hz=RATE_HZ,
    )
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    groups = {"force": (["force"], [(time_s >= quiet_s) * 1.0])}
    for s in sensors:
        delivered = s.gain * moved(ORDERS[s.quantity], time_s - s.delay_s, tones)
        if rng is not None:
            delivered += s.noise_density * np.sqrt(RATE_HZ / 2) * rng.standard_normal(time_s.size)
        names, rows = groups.setdefault(s.quantity, ([], []))
        names.append(s.name)
        rows.append(delivered)
    signals = {
        quantity: Signals(Channels(quantity, "", tuple(names), (MASS,) * len(names), RATE_HZ), 0.0, np.stack(rows))
        for quantity, (names, rows) in groups.items()
    }
    return Recording(rig, signals, {})


def rows(motion: Kinematics):
    return {
        "displacement": motion.displacement_m[0],
        "velocity": motion.velocity_m_per_s[0],
        "acceleration": motion.acceleration_m_per_s2[0],
    }


def errors(motion, tones=TONES):
    """rms of the error over rms of the motion, by quantity."""
    time_s = np.arange(motion.force_n.size) / RATE_HZ
    true = {quantity: moved(order, time_s, tones) for quantity, order in ORDERS.items()}
    return {q: float(np.std(row - true[q]) / np.std(true[q])) for q, row in rows(motion).items()}


@pytest.mark.parametrize("quantity", ORDERS)
def test_one_quantity_gives_the_others(quantity):
    motion = kinematics(recorded(sensor(quantity)))
    assert motion.trusted_hz == (0.0 if quantity == "displacement" else CORNER_HZ, PASSBAND * RATE_HZ)
    print(quantity, errors(motion), motion.force_n.size/RATE_HZ)
    assert max(errors(motion).values()) < 1e-3
