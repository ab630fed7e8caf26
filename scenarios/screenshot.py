"""A picture of an .rrd file without a screen: python -m scenarios.screenshot FILE.rrd --at 3.4 --out FILE.png

`--view model`, `--view close_up/contact_1` or any other takes one view, as large as the window, instead of the whole
window; without `--out` it prints which views there are. Needs a Vulkan driver; on Debian without a graphics card:
mesa-vulkan-drivers and libvulkan1.
"""

import argparse
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rerun.experimental import ViewerClient

from rig.errors import RigError
from rig.files import check_source, write_bytes
from rig.viewer.drawing import TIMELINE

PATIENCE_S = 240.0
SETTLE_S = 2.0


def screenshot(rrd: Path, at_s: float, view: str | None = None) -> bytes:
    """The viewer's window, or one view, at that time of the record, as PNG, once two pictures in a row are equal."""
    with _opened(rrd) as viewer:
        viewer.set_time(TIMELINE, duration=at_s, play_state="paused")
        chosen = None if view is None else _alone(viewer, view)
        picture, until = b"", time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            time.sleep(SETTLE_S)
            last, picture = picture, _picture(viewer, chosen)
            if picture and picture == last:
                return picture
    raise TimeoutError(f"{rrd}: the viewer still draws after {PATIENCE_S:g} s")


def _picture(viewer: ViewerClient, chosen: str | None) -> bytes:
    """PNG of the window or a view; nothing where a busy machine did not draw it in time."""
    with suppress(TimeoutError):
        return bytes(viewer.take_screenshot(chosen))
    return b""


def views(rrd: Path) -> list[str]:
    """The origins of the views, each the name of one for `screenshot`."""
    with _opened(rrd) as viewer:
        return _origins(viewer)


@contextmanager
def _opened(rrd: Path) -> Iterator[ViewerClient]:
    check_source(rrd)
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
    return sorted(view.origin.strip("/") for view in viewer.get_state().views)


def _alone(viewer: ViewerClient, origin: str) -> str:
    """Fills the window with a view, which may stand behind a tab, and tells its id."""
    for view in viewer.get_state().views:
        if view.origin.strip("/") == origin.strip("/"):
            blueprint = viewer.get_blueprint("recording").blueprint
            blueprint["/viewport"]["ViewportBlueprint"]["maximized"] = str(view.view_id)
            viewer.set_blueprint(blueprint, "recording")
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
    parser.add_argument("--out", type=Path, help="the .png to write; without it the names of the views are printed")
    parser.add_argument("--view", help="one view instead of the window")
    chosen = parser.parse_args()
    try:
        if chosen.out is None:
            print("\n".join(views(chosen.rrd)))
        else:
            write_bytes(screenshot(chosen.rrd, chosen.at, chosen.view), chosen.out)
    except (RigError, TimeoutError) as error:
        sys.exit(f"scenarios.screenshot: {error}")


if __name__ == "__main__":
    main()
