"""A mass under its weight in a ring, which two shakers move: the smallest rig in space."""

from rig.model.contact_laws.annular import Annular
from rig.model.description import Contact, Rig, Station
from rig.model.oscillator import Oscillator
from rig.model.sensing import named_sensor

RING = Annular(clearance_m=1e-3, stiffness_n_per_m=2e5, damping_n_s_per_m=20.0, friction_coefficient=0.15)
PLACES = tuple(Station("mass", 0.0, direction) for direction in "yz")
MASS_IN_RING = Rig(
    name="mass in a ring",
    bodies=(Oscillator(name="mass", mass_kg=2.0, frequency_hz=0.0, damping_ratio=0.0),),
    contacts=(Contact(name="ring", at=Station("mass"), law=RING),),
    force_at=PLACES,
    sensors=tuple(named_sensor(place, "acceleration", 1e-3) for place in PLACES),
    sample_rate_hz=2048.0,
    gravity_m_per_s2=9.81,
)
