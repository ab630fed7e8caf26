"""Pictures of the project's README: the motion in the contacts as an animation, and the first screens of both pages.

python -m scenarios.pictures animation out/barrel_cradle.mcap --out scenarios/contact_motion.gif
python -m scenarios.pictures screens demo --out scenarios
"""

import os
import shutil
import subprocess
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from rig.commands.command_line import progress_bar, run
from rig.errors import RigError
from rig.files import write_bytes
from rig.model.layout import left_end_m_by_body
from rig.recording import read, read_truth, truth_path
from rig.viewer.deflection import Deflection, deflection

app = typer.Typer(pretty_exceptions_enable=False)

FRAME_COUNT, FRAME_S = 90, 0.08
"""Number of frames, and time that each is shown, s."""
WIDTH_IN, HEIGHT_IN, DPI = 8.0, 3.0, 90
SCREEN_PX = 1280, 800
COLOURS = {"open": "#8a8a8a", "closed": "#b3411b"}
NODE_COUNT = 60
"""Number of points of a drawn body."""


@app.command()
def animation(
    recording: Annotated[Path, typer.Argument(help="Recording of a rig of beams, with its truth file beside it.")],
    out: Annotated[Path, typer.Option(help="The .gif to write.")],
    start: Annotated[float, typer.Option(help="First second that is shown.")] = 3.0,
    seconds: Annotated[float, typer.Option(help="Seconds of the record that are shown.")] = 0.36,
) -> None:
    """Animate the bodies between their stops: displacements in mm, those of a contact in true scale."""
    with progress_bar(f"drawing {out.name}") as progress:
        record = read(recording)
        displacements = deflection(record, read_truth(truth_path(recording)))
        first_sample = round(start * record.rig.sample_rate_hz)
        sample_indices = first_sample + np.linspace(0, seconds * record.rig.sample_rate_hz, FRAME_COUNT).astype(int)
        if sample_indices[-1] >= displacements.displacement_m.shape[1]:
            raise RigError(f"{recording}: is shorter than {start + seconds:g} s; start earlier")
        largest_mm = 1e3 * float(np.abs(displacements.displacement_m[:, sample_indices]).max())
        frames = []
        for frame_number, sample in enumerate(sample_indices):
            frames.append(_frame(displacements, int(sample), sample / record.rig.sample_rate_hz, largest_mm))
            progress((frame_number + 1) / FRAME_COUNT)
    swatches = [np.asarray(Image.new("RGB", (frames[0].width, 40), colour)) for colour in COLOURS.values()]
    palette = Image.fromarray(np.vstack([*swatches, *(np.asarray(frame) for frame in frames[::9])])).quantize(32)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    gif_bytes = BytesIO()
    frames[0].save(
        gif_bytes, "GIF", save_all=True, append_images=frames[1:], duration=round(1e3 * FRAME_S), loop=0, optimize=True
    )
    write_bytes(gif_bytes.getvalue(), out)
    print(f"{out}: {FRAME_COUNT} frames, {len(gif_bytes.getvalue()) / 1e3:.0f} kB")


def _frame(displacements: Deflection, sample_index: int, time_s: float, largest_mm: float) -> "Image.Image":
    """Picture of a sample: the line of every body, and the two stops of every contact beside what they hold."""
    rig, left_m = displacements.rig, left_end_m_by_body(displacements.rig)
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots()
    for body, colour in zip(rig.bodies, ("#444444", "#1f5fa8"), strict=False):
        x_m = np.linspace(0, body.length_m, NODE_COUNT)
        w_mm = 1e3 * displacements.body_displacement_m(body, x_m, np.array([sample_index]))[:, 0]
        axes.plot(left_m[body.name] + x_m, w_mm, color=colour, lw=5, solid_capstyle="butt", label=body.name, zorder=3)
    for contact, relative_m in zip(rig.contacts, displacements.relative_displacement_m()[:, sample_index], strict=True):
        law, carrier_mm = contact.law, 0.0
        if contact.against is not None:
            carrier_mm = 1e3 * float(displacements.displacement_at(contact.against)[sample_index])
        x_on_drawing_m = left_m[contact.at.body] + contact.at.position_m
        stops_mm = carrier_mm + 1e3 * law.upper_clearance_m, carrier_mm - 1e3 * law.lower_clearance_m
        is_closed = relative_m > law.upper_clearance_m, relative_m < -law.lower_clearance_m
        _draw_stops(axes, x_on_drawing_m, carrier_mm, stops_mm, is_closed)
    axes.set(
        xlim=(-0.03, max(left_m[body.name] + body.length_m for body in rig.bodies) + 0.03),
        ylim=(-1.3 * largest_mm, 1.3 * largest_mm),
        xlabel="along the bodies, m",
        ylabel="displacement, mm",
        title=f"{rig.name} at {time_s:.3f} s: stops are grey while open, red while closed",
    )
    axes.legend(loc="upper right", ncols=2, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def _draw_stops(
    axes: Any, x: float, carrier_mm: float, stops_mm: tuple[float, float], is_closed: tuple[bool, bool]
) -> None:
    for stop_mm, closed in zip(stops_mm, is_closed, strict=True):
        colour = COLOURS["closed" if closed else "open"]
        axes.plot([x, x], [carrier_mm, stop_mm], color=colour, lw=1.2, zorder=2)
        axes.plot([x - 0.03, x + 0.03], [stop_mm, stop_mm], color=colour, lw=6 if closed else 3, zorder=4)


@app.command()
def screens(
    folder: Annotated[Path, typer.Argument(help="Folder that `rig demo` wrote.")],
    out: Annotated[Path, typer.Option(help="Folder for contact_page.png and gap_page.png.")] = Path("scenarios"),
) -> None:
    """Take the first screens of contact.html and gap.html; needs Chromium."""
    browser = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if browser is None:
        raise RigError("there is no Chromium; install it, or say where it is by the variable CHROMIUM")
    for name in ("contact", "gap"):
        page_path = folder / name / f"{name}.html"
        if not page_path.exists():
            raise RigError(f"{page_path}: is not there; make it by `rig demo --out {folder}`")
        with TemporaryDirectory() as folder_path:
            picture_path = Path(folder_path) / "screen.png"
            options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=6000")
            size_option = f"--window-size={SCREEN_PX[0]},{SCREEN_PX[1]}"
            paths = (f"--user-data-dir={folder_path}", f"--screenshot={picture_path}", page_path.resolve().as_uri())
            subprocess.run([browser, *options, size_option, *paths], check=True, capture_output=True, timeout=180)
            screen = Image.open(picture_path).convert("P", palette=Image.Palette.ADAPTIVE, colors=64)
            png_bytes = BytesIO()
            screen.save(png_bytes, "PNG", optimize=True)
        write_bytes(png_bytes.getvalue(), out / f"{name}_page.png")
        print(f"{out / f'{name}_page.png'}: {len(png_bytes.getvalue()) / 1e3:.0f} kB")


if __name__ == "__main__":
    run(app, "scenarios.pictures")
