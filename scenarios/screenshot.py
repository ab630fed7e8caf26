"""A picture of an .rrd file without a screen: python -m scenarios.screenshot FILE.rrd --at 3.4 --out FILE.png

`--view model`, `--view close_up/contact_1` or `--view phase/contact_1` takes one view instead of the whole window;
`--view list` prints what there is. Needs a Vulkan driver; on Debian without a graphics card: mesa-vulkan-drivers and
libvulkan1.
"""

import argparse
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient

from rig.errors import RigError
from rig.viewer.drawing import TIMELINE

PATIENCE_S = 120.0
SETTLE_S = 5.0


def screenshot(rrd: Path, at_s: float, view: str | None = None) -> bytes:
    """The viewer's window, or one view, at that time of the record, as PNG, once two pictures in a row are equal."""
    with _opened(rrd) as viewer:
        viewer.set_time(TIMELINE, duration=at_s, play_state="paused")
        chosen = None if view is None else _view_id(viewer, view)
        picture, until = b"", time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            time.sleep(SETTLE_S)
            last, picture = picture, viewer.take_screenshot(chosen)
            if picture == last:
                return picture
    raise TimeoutError(f"{rrd}: the viewer still draws after {PATIENCE_S:g} s")


def views(rrd: Path) -> list[str]:
    """The origins of the views, each the name of one for `screenshot`."""
    with _opened(rrd) as viewer:
        return _origins(viewer)


@contextmanager
def _opened(rrd: Path) -> Iterator[ViewerClient]:
    program = str(Path(sys.executable).with_name("rerun"))  # beside Python, should no environment be active
    with ViewerClient.spawn(
        headless=True, port=_free_port(), hide_welcome_screen=True, executable_path=program
    ) as viewer:
        viewer.open(str(rrd.resolve()))
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until and not viewer.get_state().views:
            time.sleep(1.0)
        yield viewer


def _origins(viewer: ViewerClient) -> list[str]:
    return [view.origin.strip("/") for view in viewer.get_state().views]


def _view_id(viewer: ViewerClient, origin: str) -> str:
    for view in viewer.get_state().views:
        if view.origin.strip("/") == origin.strip("/"):
            return str(view.view_id)
    raise RigError(f"there is no view {origin!r}; there are {', '.join(_origins(viewer))}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    parser = argparse.ArgumentParser(description="A picture of an .rrd file, taken without a screen.")
    parser.add_argument("rrd", type=Path)
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of the record")
    parser.add_argument("--out", type=Path, help="the .png to write")
    parser.add_argument("--view", help="one view instead of the window; `list` prints them")
    chosen = parser.parse_args()
    try:
        if chosen.view == "list":
            print("\n".join(views(chosen.rrd)))
        elif chosen.out is None:
            parser.error("the following arguments are required: --out")
        else:
            chosen.out.write_bytes(screenshot(chosen.rrd, chosen.at, chosen.view))
    except (RigError, TimeoutError) as error:
        sys.exit(f"scenarios.screenshot: {error}")


if __name__ == "__main__":
    main()
