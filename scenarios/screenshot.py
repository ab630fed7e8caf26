"""A picture of an .rrd file without a screen: python -m scenarios.screenshot FILE.rrd --at 3.4 --out FILE.png

Needs a Vulkan driver; on Debian without a graphics card: mesa-vulkan-drivers and libvulkan1.
"""

import argparse
import socket
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from rig.blueprint import TIMELINE

PATIENCE_S = 120.0
SETTLE_S = 5.0


def screenshot(rrd: Path, at_s: float) -> bytes:
    """The viewer's window at that time of the record, as PNG, once two pictures in a row are equal."""
    with ViewerClient.spawn(headless=True, port=_free_port(), hide_welcome_screen=True) as viewer:
        viewer.open(str(rrd.resolve()))
        viewer.set_time(TIMELINE, duration=at_s, play_state="paused")
        picture, until = b"", time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            time.sleep(SETTLE_S)
            last, picture = picture, viewer.take_screenshot()
            if picture == last:
                return picture
    raise TimeoutError(f"{rrd}: the viewer still draws after {PATIENCE_S:g} s")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    parser = argparse.ArgumentParser(description="A picture of an .rrd file, taken without a screen.")
    parser.add_argument("rrd", type=Path)
    parser.add_argument("--at", type=float, required=True, metavar="SECONDS", help="time of the record")
    parser.add_argument("--out", type=Path, required=True, help="the .png to write")
    chosen = parser.parse_args()
    chosen.out.write_bytes(screenshot(chosen.rrd, chosen.at))


if __name__ == "__main__":
    main()
