"""Geometry of the 3D view: positions of bodies, contacts and forces, frame by frame."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from rig.model.contact_laws import ContactLaw, walls_m
from rig.model.description import Body, Contact, Rig, Station
from rig.model.layout import left_ends
from rig.viewer.deflection import Deflection

FRAMES = 6000
FRAME_RATES_HZ = (60.0, 600.0)
MAX_FRAMES = 60_000
"""Largest number of frames; records of more than a thousand seconds have fewer than 60 per second."""
NODES = 61
LARGEST_DEFLECTION = 0.25
"""Largest deflection by default, as a share of the extent."""
MASS_PITCH_M = 0.6
"""Distance between the middles of masses that stand side by side, m."""
JAWS = {1: [0, 1], -1: [3, 2]}
"""Corners of a fork at its upper and its lower stop: at the tip, then at the carrier."""


@dataclass(frozen=True)
class Stage:
    """Geometry in metres: x along the bodies, y in depth, z is the deflection times the magnification.

    Bodies are arranged in depth, the last one in front; the left end of each is at x = left_m. Masses without a beam
    stand side by side instead.
    """

    deflection: Deflection
    left_m: dict[str, float]
    extent_m: float
    magnification: float
    sample_rate_hz: float
    frames: Int[np.ndarray, " frames"]
    """Samples that are drawn."""

    @property
    def rig(self) -> Rig:
        return self.deflection.rig

    @property
    def centre_m(self) -> float:
        if self.masses_alone:
            return (min(self.left_m.values()) + max(self.left_m.values())) / 2
        return min(self.left_m.values()) + self.extent_m / 2

    @property
    def masses_alone(self) -> bool:
        return _masses_alone(self.rig)

    @property
    def frame_rate_hz(self) -> float:
        return self.sample_rate_hz / float(self.frames[1] - self.frames[0] if self.frames.size > 1 else 1)

    @cached_property
    def time_s(self) -> Float[np.ndarray, " frames"]:
        return self.frames / self.sample_rate_hz

    def depth(self, body: str) -> float:
        return 0.0 if self.masses_alone else -0.1 * self.extent_m * [b.name for b in self.rig.bodies].index(body)

    def point(self, station: Station) -> Float[np.ndarray, "frames 3"]:
        """Moving position of a station."""
        z = self.magnification * self.deflection.displacement_at(station)[self.frames]
        return self._placed(np.full((z.size, 1), station.position_m), station.body, z[:, None])[:, 0]

    def rest_line(self, body: Body) -> Float[np.ndarray, "ends 3"]:
        """Neutral line of a body at rest, slightly longer than the body."""
        reach = 0.03 * self.extent_m + self._half(body)
        x = np.array([[-reach, body.length_m + reach]])
        return self._placed(x, body.name, np.zeros((1, 2)))[0]

    def strips(self, body: Body) -> Float[np.ndarray, "frames nodes 3"]:
        """Outline of a body: the neutral line of a beam, the square of a mass."""
        if body.length_m:
            x, z = np.linspace(0, body.length_m, NODES), np.zeros(NODES)
            deflection_m = self.deflection.of_body(body, x, self.frames).T
        else:
            x, z = self._half(body) * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
            deflection_m = self.deflection.displacement_at(Station(body.name))[self.frames, None]
        return self._placed(
            np.broadcast_to(x, (self.frames.size, x.size)), body.name, z + self.magnification * deflection_m
        )

    def centre(self, body: Body) -> Float[np.ndarray, "frames 3"]:
        """Moving centre of a mass."""
        return self.point(Station(body.name))

    def half_sizes(self, body: Body) -> Float[np.ndarray, " 3"]:
        """Half the width, depth and height of the block of a mass."""
        return self._half(body) * np.array([1.0, 0.6, 1.0])

    def label(self, body: Body) -> Float[np.ndarray, "frames 3"]:
        """Position of a body's name: on the block of a mass, beyond the left or, alternately, right end of a beam.

        Names at one end stand one below the other and do not move.
        """
        number = [b.name for b in self.rig.bodies].index(body.name)
        if not body.length_m:
            return self.centre(body) - np.array([0, 0, 0.5 * self._half(body)])
        beyond = body.length_m + 0.07 * self.extent_m if number % 2 else -0.07 * self.extent_m
        below = -0.07 * self.extent_m * (number // 2)
        place = np.array([self.left_m[body.name] + beyond, self.depth(body.name), below])
        return np.broadcast_to(place, (self.frames.size, 3))

    def force_origin(self, station: Station) -> Float[np.ndarray, "frames 3"]:
        """Moving point at which the arrow of a force begins: on the station, or on top of a mass."""
        return self.point(station) + np.array([0, 0, self._half(self.rig.body(station.body))])

    def support(self, body: Body) -> Float[np.ndarray, "corners 3"] | None:
        """Wall at a clamped end; None for other bodies."""
        if not body.clamped:
            return None
        y, z = 0.04 * self.extent_m * np.array([[-1, 1, 1, -1, -1], [-2, -2, 2, 2, -2]])
        return np.stack([np.full(5, self.left_m[body.name]), self.depth(body.name) + y, z], axis=1)

    def stands_beside(self, contact: Contact) -> bool:
        """True for a contact of two masses side by side: a tongue of one between two stops of the other."""
        return self.masses_alone and contact.against is not None

    def tip(self, contact: Contact) -> Float[np.ndarray, "frames 3"]:
        """Moving point that strikes the stops: the station, the nearer edge of a mass, or the end of its tongue.

        Several contacts of two masses share the gap between them.
        """
        tip = self.point(contact.at)
        if contact.against is None:
            _, depth, half = self.half_sizes(self.rig.body(contact.at.body))
            tip += np.stack([0 * tip[:, 2], np.full(len(tip), -depth), half * np.sign(tip[:, 2])], axis=1)
        if contact.against is not None and self.masses_alone:
            ends = {contact.at.body, contact.against.body}
            shared = [c.name for c in self.rig.contacts if c.against and {c.at.body, c.against.body} == ends]
            share = (shared.index(contact.name) + 1) / (len(shared) + 1)
            start, across_m = self._between(contact.at.body, contact.against.body)
            tip[:, 0] = start + share * across_m
        return tip

    def fork(self, contact: Contact, law: ContactLaw) -> Float[np.ndarray, "frames 4 3"]:
        """Fork with the stops of a contact, fixed to the opposite body or to the ground."""
        tip, half = self.tip(contact), self._half(self.rig.body(contact.at.body))
        jaws = np.repeat(tip[:, None], 4, axis=1)
        if contact.against is None:
            open_side = -1.0 if self.left_m[contact.at.body] > self.centre_m else 1.0  # towards the other masses
            jaws[..., 0] += open_side * (half + 0.05 * self.extent_m) * np.array([1, -1, -1, 1])
            carrier = np.zeros(self.frames.size)
        else:
            carrier = self.point(contact.against)[:, 2]
            if self.masses_alone:
                start, across_m = self._between(contact.at.body, contact.against.body)
                jaws[:, 1:3, 0], half = start + across_m, 0.0
                jaws[:, [0, 3], 0] -= 0.1 * across_m
            else:
                jaws[:, 1:3, 1] = self.depth(contact.against.body)
        jaws[..., 2] = carrier[:, None]
        for wall_m, side in walls_m(law):
            jaws[:, JAWS[side], 2] += self.magnification * wall_m + side * half
        for side in {-1, 1} - set(law.sides):  # drawn without a jaw, up to its carrier
            tip_corner, carrier_corner = JAWS[side]
            jaws[:, tip_corner] = jaws[:, carrier_corner]
        return jaws

    def _between(self, body_name: str, other_name: str) -> tuple[float, float]:
        """Side of a mass that faces another one, x, and the way from there to the other, both m."""
        middle_m, to_other_m = self.left_m[body_name], self.left_m[other_name] - self.left_m[body_name]
        half = np.copysign(self._half(self.rig.body(body_name)), to_other_m)
        return middle_m + half, to_other_m - 2 * half

    def _half(self, body: Body) -> float:
        return 0.0 if body.length_m else 0.12 * self.extent_m

    def _placed(
        self, x_m: Float[np.ndarray, "frames nodes"], body: str, z_m: Float[np.ndarray, "frames nodes"]
    ) -> Float[np.ndarray, "frames nodes 3"]:
        return np.stack([self.left_m[body] + x_m, np.full(z_m.shape, self.depth(body)), z_m], axis=2)


def stage(deflection: Deflection, sample_rate_hz: float, magnification: float | None) -> Stage:
    """Stage for these displacements; by default the largest deflection is drawn as a quarter of the extent.

    There are 6000 frames, but at least 60 and at most 600 in a second, and never more than 60 000.
    """
    rig = deflection.rig
    if _masses_alone(rig):
        left_m = {body.name: MASS_PITCH_M * number for number, body in enumerate(rig.bodies)}
        extent_m = max(1.0, MASS_PITCH_M * len(rig.bodies))
    else:
        left_m = left_ends(rig)
        extent_m = max(left_m[b.name] + b.length_m for b in rig.bodies) - min(left_m.values())
    largest = float(np.abs(deflection.displacement_m).max(initial=0.0))
    if magnification is None:
        magnification = _rounded_down(LARGEST_DEFLECTION * extent_m / largest) if largest > 0 else 1.0
    samples = deflection.displacement_m.shape[1]
    rate = min(np.clip(FRAMES * sample_rate_hz / samples, *FRAME_RATES_HZ), MAX_FRAMES * sample_rate_hz / samples)
    frames = np.arange(0, samples, max(1, round(sample_rate_hz / rate)))
    return Stage(deflection, left_m, extent_m, magnification, sample_rate_hz, frames)


def _masses_alone(rig: Rig) -> bool:
    return not any(body.length_m for body in rig.bodies)


def _rounded_down(value: float) -> float:
    """Largest of 1, 2 and 5 times a power of ten not above the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)))
