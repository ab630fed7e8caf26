"""Records of cantilevers on which something acts that nobody measured, made in the frequency domain."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from identify.gaps.residual.spectra import record_of
from rig.model.beam import Beam
from rig.model.description import Rig, Sensor, Station
from rig.recording import Recording, Signals
from rig.recording.channels import Channels

RATE_HZ, DURATION_S, PADDED_S = 1024.0, 14.0, 42.0
QUIET_S, RISE_S, BAND_HZ, MODES = 1.0, 0.2, (2.0, 50.0), 12
NOISE, FORCE_NOISE_N = 1e-3, 5e-4
PLACES_M = (0.2, 0.4, 0.55, 0.7, 0.85, 1.0)


@dataclass(frozen=True)
class World:
    """One or two cantilevers with accelerometers and one measured force; gains as exact as a laboratory's."""

    bodies: tuple[str, ...] = ("beam",)
    damping_ratio: float = 0.02
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    @property
    def rig(self):
        section = {"ends": "clamped-free", "width_m": 0.05, "thickness_m": 0.01, "damping_ratio": self.damping_ratio}
        beams = tuple(Beam(name=b, length_m=1.0 + 0.1 * i, **section) for i, b in enumerate(self.bodies))
        sensors = tuple(
            Sensor(name=f"{b}_{1000 * x:.0f}", station=Station(b, x), quantity="acceleration", noise_density=NOISE)
            for b in self.bodies
            for x in PLACES_M
        )
        return Rig(
            name="cantilevers",
            bodies=beams,
            contacts=(),
            force_at=Station(self.bodies[0], 1.0),
            sensors=sensors,
            sample_rate_hz=RATE_HZ,
        )

    @property
    def time_s(self):
        return np.arange(round(PADDED_S * RATE_HZ)) / RATE_HZ

    @property
    def omega(self):
        return 2 * np.pi * np.fft.rfftfreq(self.time_s.size, 1 / RATE_HZ)

    def random_n(self, rms_n, band_hz=BAND_HZ):
        """A random force in a band that lasts until the record has ended."""
        spectrum = np.fft.rfft(self.rng.standard_normal(self.time_s.size))
        hz = self.omega / (2 * np.pi)
        force = np.fft.irfft(spectrum * ((hz > band_hz[0]) & (hz < band_hz[1])), self.time_s.size)
        lasting = (self.time_s < DURATION_S + 2) * rms_n / force.std()
        return force * lasting

    def compliance(self, body, force_position_m, positions_m, stiffer=1.0):
        """Receptances from a force at one position of a body to some others, by modal superposition."""
        modes, zeta = body.frequencies_hz(MODES) * stiffer, body.damping_ratios(MODES)
        natural = 2 * np.pi * modes[:, None]
        receptances = 1 / (natural**2 - self.omega**2 + 2j * zeta[:, None] * natural * self.omega)
        shapes, at_force = (body.shapes(np.asarray(places_m), MODES) for places_m in (positions_m, [force_position_m]))
        return (shapes * at_force[0]) @ receptances

    def displacements(self, forces, stations):
        """Spectra of the displacement (m) at some stations by forces, each a station and a time history (N)."""
        spectra = np.zeros((len(stations), self.omega.size), dtype=complex)
        for station, force in forces:
            for i, place in enumerate(stations):
                if place.body == station.body:
                    body = self.rig.body(place.body)
                    row = self.compliance(body, station.position_m, [place.position_m])[0]
                    spectra[i] += row * np.fft.rfft(force)
        return spectra

    def record(self, rms_n=5.0, unknown=None, spoilt=None):
        """Recording as the sensors give it. `unknown` holds the stations of a force and its law, of time and
        motion; the force is iterated with the motion at its stations until both agree."""
        force = self.random_n(rms_n) * np.sin(np.pi / 2 * np.clip((self.time_s - QUIET_S) / RISE_S, 0, 1)) ** 2
        rig, forces = self.rig, []
        if unknown is not None:
            stations, law = unknown
            history = np.zeros(self.time_s.size)
            for _ in range(40):
                forces = [(s, sign * history) for s, sign in zip(stations, (1.0, -1.0), strict=False)]
                displacements = self.displacements([(rig.force_at, force), *forces], stations)
                relative = displacements[0] - (displacements[1] if len(stations) > 1 else 0.0)
                motion = [np.fft.irfft((1j * self.omega) ** n * relative, self.time_s.size) for n in (0, 1)]
                history = 0.5 * history + 0.5 * law(self.time_s, *motion)
        places = [s.station for s in rig.sensors]
        accelerations = -(self.omega**2) * self.displacements([(rig.force_at, force), *forces], places)
        signals = np.fft.irfft(accelerations, self.time_s.size)
        signals *= 1 + 1e-3 * self.rng.uniform(-1, 1, (len(places), 1))
        if spoilt is not None:
            signals = spoilt(signals)
        count = round(DURATION_S * RATE_HZ)
        signals = signals[:, :count] + NOISE * np.sqrt(RATE_HZ / 2) * self.rng.standard_normal((len(places), count))
        measured = force[:count] + FORCE_NOISE_N * np.sqrt(RATE_HZ / 2) * self.rng.standard_normal(count)
        return record_of(Recording(rig, groups(rig, measured, signals), {}))


def groups(rig, force_n, accelerations):
    names = tuple(s.name for s in rig.sensors)
    stations = tuple(s.station for s in rig.sensors)
    return {
        "force": Signals(Channels("force", "N", ("force",), (rig.force_at,), RATE_HZ), 0.0, force_n[None]),
        "acceleration": Signals(Channels("acceleration", "m/s^2", names, stations, RATE_HZ), 0.0, accelerations),
    }


@pytest.fixture
def world():
    return World()


@pytest.fixture
def two():
    return World(("upper", "lower"))


@pytest.fixture
def damped():
    return World(damping_ratio=0.05)
