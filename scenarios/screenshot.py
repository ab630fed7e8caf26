"""Picture of an .rrd file without a screen: python -m scenarios.screenshot FILE.rrd --at 3.4 --out FILE.png

`--view model`, `--view close_up/contact_1` or any other takes one view, as large as the window, instead of the whole
window; without `--out` it prints which views there are. Needs a Vulkan driver; on Debian without a graphics card:
mesa-vulkan-drivers and libvulkan1.
"""

import argparse
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from rerun.experimental import ViewerClient

from rig.errors import RigError
from rig.files import check_source, write_bytes
from rig.viewer.drawing import TIMELINE
from rig.viewer.web import LOOPBACK, free_ports, rerun_on_loopback

TIMEOUT_S = 240.0
SETTLE_S = 2.0


def screenshot(rrd: Path, at_s: float, view: str | None = None) -> bytes:
    """PNG of the viewer's window, or of one view, at a time of the record, once two pictures in a row are equal."""
    with _opened(rrd) as viewer:
        viewer.set_time(TIMELINE, duration=at_s, play_state="paused")
        view_id = None if view is None else _maximize_view(viewer, view)
        picture, deadline_s = b"", time.monotonic() + TIMEOUT_S
        while time.monotonic() < deadline_s:
            time.sleep(SETTLE_S)
            earlier_picture, picture = picture, _picture(viewer, view_id)
            if picture and picture == earlier_picture:
                return picture
    raise TimeoutError(f"{rrd}: the viewer still draws after {TIMEOUT_S:g} s")


def _picture(viewer: ViewerClient, view_id: str | None) -> bytes:
    """PNG of the window or a view; nothing where a busy machine did not draw it in time."""
    with suppress(TimeoutError):
        return bytes(viewer.take_screenshot(view_id))
    return b""


def view_names(rrd: Path) -> list[str]:
    """Origins of the views, each the name of one for `screenshot`."""
    with _opened(rrd) as viewer:
        return _origins(viewer)


@contextmanager
def _opened(rrd: Path) -> Iterator[ViewerClient]:
    check_source(rrd)
    port, _ = free_ports()
    deadline_s = time.monotonic() + TIMEOUT_S
    with rerun_on_loopback("--headless", "--hide-welcome-screen", "--port", str(port)) as process:
        while not _listens(port):
            if process.poll() is not None or time.monotonic() > deadline_s:
                raise RigError("rerun does not start without a screen; it needs a Vulkan driver (mesa-vulkan-drivers)")
            time.sleep(0.2)
        viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
        viewer.open(str(rrd.resolve()))
        while time.monotonic() < deadline_s and not viewer.get_state().views:
            time.sleep(1.0)
        yield viewer


def _listens(port: int) -> bool:
    with suppress(OSError):
        socket.create_connection((LOOPBACK, port)).close()
        return True
    return False


def _origins(viewer: ViewerClient) -> list[str]:
    return sorted(view.origin.strip("/") for view in viewer.get_state().views)


def _maximize_view(viewer: ViewerClient, origin: str) -> str:
    """Fill the window with a view, which may be behind a tab; return its id."""
    for view in viewer.get_state().views:
        if view.origin.strip("/") == origin.strip("/"):
            blueprint = viewer.get_blueprint("recording").blueprint
            blueprint["/viewport"]["ViewportBlueprint"]["maximized"] = str(view.view_id)
            viewer.set_blueprint(blueprint, "recording")
            return str(view.view_id)
    raise RigError(f"there is no view {origin!r}; there are {', '.join(_origins(viewer))}")


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="A picture of an .rrd file, taken without a screen.")
    parser.add_argument("rrd", type=Path)
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of the record")
    parser.add_argument("--out", type=Path, help="the .png to write; without it the names of the views are printed")
    parser.add_argument("--view", help="one view instead of the window")
    options = parser.parse_args(words)
    try:
        if options.out is None:
            print("\n".join(view_names(options.rrd)))
        else:
            write_bytes(screenshot(options.rrd, options.at, options.view), options.out)
    except (RigError, TimeoutError) as error:
        sys.exit(f"scenarios.screenshot: {error}")


if __name__ == "__main__":
    main()
