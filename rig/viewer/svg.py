"""Shapes of a technical drawing as SVG elements; x to the right and y down, in pixels."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from rig.files import write_bytes
from rig.viewer.palette import INK

GREY, STEEL = "#888", "#d4d9e0"
Point = tuple[float, float]


@dataclass
class Drawing:
    """SVG elements, and the corners that determine the size of the drawing."""

    elements: list[str] = field(default_factory=list)
    corners: list[Point] = field(default_factory=list)

    def line(self, *points: Point, colour: str = INK, width: float = 1.5, dashed: bool = False, fill: str = "") -> None:
        """Draw a polyline; closed if it is filled."""
        self.corners += points
        tag, dash_attribute = ("polygon" if fill else "polyline"), ' stroke-dasharray="4 3"' if dashed else ""
        points_text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        style_attributes = f'fill="{fill or "none"}" stroke="{colour}" stroke-width="{width}"{dash_attribute}'
        self.elements.append(f'<{tag} points="{points_text}" {style_attributes}/>')

    def text(
        self,
        x: float,
        y: float,
        words: str,
        colour: str = INK,
        anchor: str = "start",
        rotation_deg: int = 0,
        size: int = 12,
    ) -> None:
        width = 0.6 * size * len(words)  # of a letter, about
        left_x = x + {"start": 0.0, "middle": -width / 2, "end": -width}[anchor]
        self.corners += [(x, y - width), (x + width, y)] if rotation_deg else [(left_x, y - size), (left_x + width, y)]
        transform_attribute = f' transform="rotate({rotation_deg} {x:.1f} {y:.1f})"' if rotation_deg else ""
        place_attributes = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}"{transform_attribute}'
        halo_attributes = 'paint-order="stroke" stroke="white" stroke-width="3"'
        self.elements.append(f'<text {place_attributes} fill="{colour}" {halo_attributes}>{escape(words)}</text>')

    def box(
        self, left_x: float, top_y: float, right_x: float, bottom_y: float, fill: str = STEEL, dashed: bool = False
    ) -> None:
        self.line((left_x, top_y), (right_x, top_y), (right_x, bottom_y), (left_x, bottom_y), fill=fill, dashed=dashed)

    def dot(self, x: float, y: float, colour: str, radius: float = 3.0) -> None:
        self.corners.append((x, y))
        self.elements.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{colour}"/>')

    def arrow(self, tail: Point, tip: Point, colour: str = INK, line_width: float = 2.0) -> None:
        """Draw a vertical or horizontal arrow."""
        (x0, y0), (x, y) = tail, tip
        head_length = 4 + 2 * line_width
        axis_direction = ((x > x0) - (x < x0), (y > y0) - (y < y0))
        head_base = (x - head_length * axis_direction[0], y - head_length * axis_direction[1])
        head_half_width = (head_length / 2 * axis_direction[1], head_length / 2 * axis_direction[0])
        self.line(tail, head_base, colour=colour, width=line_width)
        head_wings = (
            (head_base[0] - head_half_width[0], head_base[1] - head_half_width[1]),
            (head_base[0] + head_half_width[0], head_base[1] + head_half_width[1]),
        )
        self.line(tip, *head_wings, colour=colour, width=1.0, fill=colour)

    def ground(self, x: float, y: float, width: float = 36.0, upwards: bool = False) -> None:
        """Draw a horizontal line hatched on its outer side."""
        self.line((x - width / 2, y), (x + width / 2, y))
        hatch_end_y = y - 8 if upwards else y + 8
        for k in range(int(width // 9)):
            hatch_x = x - width / 2 + 9 * (k + 1)
            self.line((hatch_x, y), (hatch_x - 7, hatch_end_y), width=1.0, colour=GREY)

    def wall(self, x: float, y: float, half_height: float) -> None:
        """Draw a vertical line hatched on its left."""
        self.line((x, y - half_height), (x, y + half_height), width=2.5)
        for k in range(int(2 * half_height // 9)):
            hatch_y = y - half_height + 9 * (k + 1)
            self.line((x, hatch_y - 7), (x - 8, hatch_y), width=1.0, colour=GREY)

    def spring(self, x: float, top_y: float, bottom_y: float) -> None:
        coil_step = (bottom_y - top_y) / 8
        coil_points: Sequence[Point] = [(x + (7 if k % 2 else -7), top_y + coil_step * (k + 0.5)) for k in range(1, 7)]
        self.line((x, top_y), (x, top_y + coil_step), *coil_points, (x, bottom_y - coil_step), (x, bottom_y))

    def pin(self, x: float, top_y: float, bottom_y: float) -> None:
        """Draw a support, the triangle of a pin."""
        self.line((x, top_y), (x - 12, bottom_y), (x + 12, bottom_y), (x, top_y))

    def damper(self, x: float, top_y: float, bottom_y: float) -> None:
        piston_y = (top_y + bottom_y) / 2
        self.line((x, top_y), (x, piston_y))
        self.line((x - 7, piston_y), (x + 7, piston_y), width=2.5)
        self.line((x - 9, piston_y - 8), (x - 9, piston_y + 8), (x + 9, piston_y + 8), (x + 9, piston_y - 8))
        self.line((x, piston_y + 8), (x, bottom_y))

    def write(self, path: Path, margin: float = 20.0) -> None:
        """Write the SVG file, sized to its content; raise RigError if it cannot be written."""
        corner_xs, corner_ys = zip(*self.corners, strict=True)
        left_x, top_y = min(corner_xs) - margin, min(corner_ys) - margin
        width, height = max(corner_xs) + margin - left_x, max(corner_ys) + margin - top_y
        svg_head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{left_x:.1f} {top_y:.1f} {width:.1f} {height:.1f}" '
            f'width="{width:.0f}" height="{height:.0f}" font-family="sans-serif">'
        )
        background = f'<rect x="{left_x:.1f}" y="{top_y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="white"/>'
        write_bytes("\n".join([svg_head, background, *self.elements, "</svg>", ""]).encode(), path)
