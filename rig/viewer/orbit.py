"""An annular contact in the viewer: its motion as an orbit in a ring, and as a distance from the centre over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float

from rig.model.contact_laws import ContactLaw
from rig.viewer.drawing import pixels, send_labels, send_static
from rig.viewer.palette import SOURCES

CIRCLE_ANGLES_RAD = np.linspace(0, 2 * np.pi, 97)


@dataclass(frozen=True)
class Orbit:
    """Relative displacement of an annular contact in y and z, less the centre of its ring."""

    eta_m: Float[np.ndarray, "2 samples"]

    @property
    def radius_m(self) -> Float[np.ndarray, " samples"]:
        return np.hypot(*self.eta_m)

    @property
    def points_mm(self) -> Float[np.ndarray, "samples 2"]:
        """Points of the close-up, as seen along the bodies from the left: z to the right, y upwards."""
        return 1e3 * np.stack([self.eta_m[1], -self.eta_m[0]], axis=1)

    def angle_deg(self, sample: int) -> float:
        """Angle of the motion, from y towards z."""
        return float(np.degrees(np.arctan2(self.eta_m[1, sample], self.eta_m[0, sample])))


def send_rings(
    stream: rr.RecordingStream, entity_path: str, radial_laws: Sequence[tuple[str, ContactLaw]], reach_mm: float
) -> None:
    """Send a circle with its label for the ring of every law, by its source."""
    for law_index, (law_source, law) in enumerate(radial_laws):
        radius_mm, colour, law_path = 1e3 * law.upper_clearance_m, SOURCES[law_source], f"{entity_path}/{law_source}"
        circle_points_mm = radius_mm * np.stack([np.cos(CIRCLE_ANGLES_RAD), np.sin(CIRCLE_ANGLES_RAD)], axis=1)
        send_static(stream, law_path, rr.LineStrips2D([circle_points_mm], colors=[colour], radii=pixels(1.5)))
        label_position = [1.85 * reach_mm, (0.3 * law_index - 0.8) * reach_mm]
        send_labels(stream, f"{law_path}/radius", [label_position], [f"{law_source} {radius_mm:.4g} mm"], colour)
