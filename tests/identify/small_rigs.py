"""The smallest rig in space, and the smallest on a shaken base: a mass in a ring, and one between stops on a table."""

from rig.model.contact_laws import DeadZone
from rig.model.contact_laws.annular import Annular
from rig.model.description import ON_GROUND, Contact, Rig, Station
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
STOPS = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=4e4, damping_n_s_per_m=4.0)
MASS_ON_TABLE = Rig(
    name="mass on a table",
    bodies=(Oscillator(name="mass", mass_kg=2.0, frequency_hz=12.0, damping_ratio=0.02),),
    contacts=(Contact(name="stops", at=Station("mass"), law=STOPS),),
    sensors=tuple(named_sensor(station, "acceleration", 5e-4) for station in (ON_GROUND, Station("mass"))),
    sample_rate_hz=1024.0,
)
