"""Geometry of the 3D view: positions of bodies, contacts and forces, frame by frame."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace

from rig.model.components import DIRECTIONS
from rig.model.contact_laws import ContactLaw, stop_positions_m_and_sides
from rig.model.contact_laws.annular import Annular
from rig.model.description import Body, Contact, Rig, Station
from rig.model.layout import left_end_m_by_body
from rig.viewer.deflection import Deflection

USUAL_FRAME_COUNT = 6000
FRAME_RATE_RANGE_HZ = (60.0, 600.0)
MAX_FRAME_COUNT = 60_000
"""Largest number of frames; records of more than a thousand seconds have fewer than 60 per second."""
BODY_NODE_COUNT = 61
LARGEST_DEFLECTION_SHARE = 0.25
"""Largest deflection by default, as a share of the extent."""
MASS_PITCH_M = 0.6
"""Distance between the middles of masses that stand side by side, m."""
RING_CORNER_COUNT = 49
JAW_CORNERS_BY_SIDE = {1: [0, 1], -1: [3, 2]}
"""Corners of a fork at its upper and its lower stop: at the tip, then at the carrier."""


NodeValues = Float[np.ndarray, "frames nodes"]


@dataclass(frozen=True)
class Stage:
    """Geometry in metres: x along the bodies, y in depth, z is the deflection times the magnification.

    In space a deflection in z of the rig comes out of the depth, towards the eye.
    Bodies are arranged in depth, the last one in front; the left end of each is at x = left_ends_m. Masses without a
    beam stand side by side instead.
    """

    deflection: Deflection
    left_ends_m: dict[str, float]
    extent_m: float
    magnification: float
    sample_rate_hz: float
    frame_samples: Int[np.ndarray, " frames"]
    """Samples that are drawn."""

    @property
    def rig(self) -> Rig:
        return self.deflection.rig

    @property
    def centre_m(self) -> float:
        if self.masses_alone:
            return (min(self.left_ends_m.values()) + max(self.left_ends_m.values())) / 2
        return min(self.left_ends_m.values()) + self.extent_m / 2

    @property
    def masses_alone(self) -> bool:
        return _has_only_masses(self.rig)

    @property
    def frame_rate_hz(self) -> float:
        frame_step_samples = self.frame_samples[1] - self.frame_samples[0] if self.frame_samples.size > 1 else 1
        return self.sample_rate_hz / float(frame_step_samples)

    @cached_property
    def time_s(self) -> Float[np.ndarray, " frames"]:
        return self.frame_samples / self.sample_rate_hz

    def depth_m(self, body_name: str) -> float:
        body_index = [body.name for body in self.rig.bodies].index(body_name)
        return 0.0 if self.masses_alone else -0.1 * self.extent_m * body_index

    def point(self, station: Station) -> Float[np.ndarray, "frames 3"]:
        """Moving position of a station."""
        displacements_m = (self.deflection.displacement_at(replace(station, direction=axis)) for axis in DIRECTIONS)
        up_m, towards_eye_m = (self.magnification * shift_m[self.frame_samples, None] for shift_m in displacements_m)
        return self._points_on_body(np.full(up_m.shape, station.position_m), station.body, up_m, towards_eye_m)[:, 0]

    def rest_line(self, body: Body) -> Float[np.ndarray, "ends 3"]:
        """Neutral line of a body at rest, slightly longer than the body."""
        overhang_m = 0.03 * self.extent_m + self._half_size_m(body)
        end_x_m = np.array([[-overhang_m, body.length_m + overhang_m]])
        return self._points_on_body(end_x_m, body.name, np.zeros((1, 2)))[0]

    def strips(self, body: Body) -> Float[np.ndarray, "frames nodes 3"]:
        """Outline of a body: the neutral line of a beam, the square of a mass."""
        frame_samples = self.frame_samples
        if body.length_m:
            x_m, z_m = np.linspace(0, body.length_m, BODY_NODE_COUNT), np.zeros(BODY_NODE_COUNT)
            up_m, towards_eye_m = (
                self.deflection.body_displacement_m(body, x_m, frame_samples, axis).T for axis in DIRECTIONS
            )
        else:
            x_m, z_m = self._half_size_m(body) * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
            displacements_m = (self.deflection.displacement_at(Station(body.name, 0.0, axis)) for axis in DIRECTIONS)
            up_m, towards_eye_m = (displacement_m[frame_samples, None] for displacement_m in displacements_m)
        x_m = np.broadcast_to(x_m, (frame_samples.size, x_m.size))
        up_m, towards_eye_m = z_m + self.magnification * up_m, self.magnification * towards_eye_m + 0 * x_m
        return self._points_on_body(x_m, body.name, up_m, towards_eye_m)

    def centre(self, body: Body) -> Float[np.ndarray, "frames 3"]:
        """Moving centre of a mass."""
        return self.point(Station(body.name))

    def half_sizes(self, body: Body) -> Float[np.ndarray, " 3"]:
        """Half the width, depth and height of the block of a mass."""
        return self._half_size_m(body) * np.array([1.0, 0.6, 1.0])

    def label(self, body: Body) -> Float[np.ndarray, "frames 3"]:
        """Position of a body's name: on the block of a mass, beyond the left or, alternately, right end of a beam.

        Names at one end stand one below the other and do not move.
        """
        body_index = [body.name for body in self.rig.bodies].index(body.name)
        if not body.length_m:
            return self.centre(body) - np.array([0, 0, 0.5 * self._half_size_m(body)])
        label_x_m = body.length_m + 0.07 * self.extent_m if body_index % 2 else -0.07 * self.extent_m
        label_z_m = -0.07 * self.extent_m * (body_index // 2)
        label_position = np.array([self.left_ends_m[body.name] + label_x_m, self.depth_m(body.name), label_z_m])
        return np.broadcast_to(label_position, (self.frame_samples.size, 3))

    def force_origin(self, station: Station) -> Float[np.ndarray, "frames 3"]:
        """Moving point at which the arrow of a force begins: on the station, or on top of a mass."""
        return self.point(station) + np.array([0, 0, self._half_size_m(self.rig.body(station.body))])

    def wall_corners(self, body: Body) -> Float[np.ndarray, "corners 3"] | None:
        """Wall at a clamped end; None for other bodies."""
        if not body.clamped:
            return None
        depth_m, height_m = 0.04 * self.extent_m * np.array([[-1, 1, 1, -1, -1], [-2, -2, 2, 2, -2]])
        x_m = np.full(5, self.left_ends_m[body.name])
        return np.stack([x_m, self.depth_m(body.name) + depth_m, height_m], axis=1)

    def is_side_by_side(self, contact: Contact) -> bool:
        """True for a contact of two masses side by side: a tongue of one between two stops of the other."""
        return self.masses_alone and contact.against is not None

    def tip(self, contact: Contact) -> Float[np.ndarray, "frames 3"]:
        """Moving point that strikes the stops: the station, the nearer edge of a mass, or the end of its tongue.

        Several contacts of two masses share the gap between them.
        """
        tip_points = self.point(contact.at)
        if self.is_annular(contact):
            return tip_points
        if contact.against is None:
            _, half_depth_m, half_height_m = self.half_sizes(self.rig.body(contact.at.body))
            tip_points[:, 1] -= half_depth_m
            tip_points[:, 2] += half_height_m * np.sign(tip_points[:, 2])
        if contact.against is not None and self.masses_alone:
            bodies = {contact.at.body, contact.against.body}
            sharing_names = [c.name for c in self.rig.contacts if c.against and {c.at.body, c.against.body} == bodies]
            gap_share = (sharing_names.index(contact.name) + 1) / (len(sharing_names) + 1)
            facing_side_x_m, gap_width_m = self._facing_side_and_gap_m(contact.at.body, contact.against.body)
            tip_points[:, 0] = facing_side_x_m + gap_share * gap_width_m
        return tip_points

    def fork(self, contact: Contact, law: ContactLaw) -> Float[np.ndarray, "frames 4 3"]:
        """Fork with the stops of a contact, fixed to the opposite body or to the ground."""
        tip_points, half_size_m = self.tip(contact), self._half_size_m(self.rig.body(contact.at.body))
        jaw_points = np.repeat(tip_points[:, None], 4, axis=1)
        if contact.against is None:
            # open towards the other masses
            open_direction = -1.0 if self.left_ends_m[contact.at.body] > self.centre_m else 1.0
            jaw_points[..., 0] += open_direction * (half_size_m + 0.05 * self.extent_m) * np.array([1, -1, -1, 1])
            carrier_z_m = np.zeros(self.frame_samples.size)
        else:
            carrier_z_m = self.point(contact.against)[:, 2]
            if self.masses_alone:
                facing_side_x_m, gap_width_m = self._facing_side_and_gap_m(contact.at.body, contact.against.body)
                jaw_points[:, 1:3, 0], half_size_m = facing_side_x_m + gap_width_m, 0.0
                jaw_points[:, [0, 3], 0] -= 0.1 * gap_width_m
            else:
                jaw_points[:, 1:3, 1] = self.depth_m(contact.against.body)
        jaw_points[..., 2] = carrier_z_m[:, None]
        for wall_m, side in stop_positions_m_and_sides(law):
            jaw_points[:, JAW_CORNERS_BY_SIDE[side], 2] += self.magnification * wall_m + side * half_size_m
        for side in {-1, 1} - set(law.sides):  # drawn without a jaw, up to its carrier
            tip_corner, carrier_corner = JAW_CORNERS_BY_SIDE[side]
            jaw_points[:, tip_corner] = jaw_points[:, carrier_corner]
        return jaw_points

    def is_annular(self, contact: Contact) -> bool:
        """True if a contact is annular in the rig; its law is then drawn over the distance from its centre."""
        return self.rig.contact(contact.name).law.spatial

    def ring(self, contact: Contact) -> Float[np.ndarray, "frames corners 3"]:
        """Ring of an annular contact about the point that moves in it, and the line to its carrier."""
        angle_rad = np.linspace(-np.pi / 2, 1.5 * np.pi, RING_CORNER_COUNT)
        radius_m = self.magnification * contact.law.clearance_m + self._half_size_m(self.rig.body(contact.at.body))
        centre_points = np.zeros((self.frame_samples.size, 3))
        centre_points[:, 0] = self.left_ends_m[contact.at.body] + contact.at.position_m
        circle_points = radius_m * np.stack([0 * angle_rad, -np.sin(angle_rad), np.cos(angle_rad)], axis=1)
        carrier_points = centre_points[:, None]
        if contact.against is not None:
            carrier_points = self.point(contact.against)[:, None]
            centre_points[:, 1:] = carrier_points[:, 0, 1:] - [self.depth_m(contact.against.body), 0.0]
        centre_points[:, 1] += self.depth_m(contact.at.body)
        law = self.rig.contact(contact.name).law
        if isinstance(law, Annular):
            centre_points[:, 1:] += self.magnification * np.array([-law.center_z_m, law.center_y_m])
        ring_points = centre_points[:, None] + circle_points
        return ring_points if contact.against is None else np.concatenate([ring_points, carrier_points], axis=1)

    def _facing_side_and_gap_m(self, body_name: str, other_body_name: str) -> tuple[float, float]:
        """Side of a mass that faces another one, x, and the way from there to the other, both m."""
        body_x_m = self.left_ends_m[body_name]
        distance_to_other_m = self.left_ends_m[other_body_name] - self.left_ends_m[body_name]
        half_size_m = np.copysign(self._half_size_m(self.rig.body(body_name)), distance_to_other_m)
        return body_x_m + half_size_m, distance_to_other_m - 2 * half_size_m

    def _half_size_m(self, body: Body) -> float:
        return 0.0 if body.length_m else 0.12 * self.extent_m

    def _points_on_body(
        self, x_m: NodeValues, body_name: str, z_m: NodeValues, towards_eye_m: NodeValues | float = 0.0
    ) -> Float[np.ndarray, "frames nodes 3"]:
        depth_m = np.full(z_m.shape, self.depth_m(body_name)) - towards_eye_m
        return np.stack([self.left_ends_m[body_name] + x_m, depth_m, z_m], axis=2)


def stage(deflection: Deflection, sample_rate_hz: float, magnification: float | None) -> Stage:
    """Stage for these displacements; by default the largest deflection is drawn as a quarter of the extent.

    There are 6000 frames, but at least 60 and at most 600 in a second, and never more than 60 000.
    """
    rig = deflection.rig
    if _has_only_masses(rig):
        left_ends_m = {body.name: MASS_PITCH_M * body_index for body_index, body in enumerate(rig.bodies)}
        extent_m = max(1.0, MASS_PITCH_M * len(rig.bodies))
    else:
        left_ends_m = left_end_m_by_body(rig)
        extent_m = max(left_ends_m[body.name] + body.length_m for body in rig.bodies) - min(left_ends_m.values())
    max_motion_m = float(np.abs(deflection.displacement_m).max(initial=0.0))
    if magnification is None:
        magnification = (
            _round_down_to_1_2_5(LARGEST_DEFLECTION_SHARE * extent_m / max_motion_m) if max_motion_m > 0 else 1.0
        )
    sample_count = deflection.displacement_m.shape[1]
    usual_frame_hz, most_hz = (count * sample_rate_hz / sample_count for count in (USUAL_FRAME_COUNT, MAX_FRAME_COUNT))
    frame_rate_hz = min(np.clip(usual_frame_hz, *FRAME_RATE_RANGE_HZ), most_hz)
    frame_samples = np.arange(0, sample_count, max(1, round(sample_rate_hz / frame_rate_hz)))
    return Stage(deflection, left_ends_m, extent_m, magnification, sample_rate_hz, frame_samples)


def _has_only_masses(rig: Rig) -> bool:
    return not any(body.length_m for body in rig.bodies)


def _round_down_to_1_2_5(value: float) -> float:
    """Largest of 1, 2 and 5 times a power of ten not above the value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(decade * max(multiple for multiple in (1, 2, 5) if multiple * decade <= value * (1 + 1e-9)))
