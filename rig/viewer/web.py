"""Viewer in a browser: rerun's page and the .rrd file, served on the loopback address while the command runs.

rerun's web servers listen on all addresses by default and answer for any host, so a page elsewhere that lets its own
name point here could read the recording. What its program serves on the loopback address is fetched once instead, and
served from here, beside the recording, to requests for this host alone.
"""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.error import URLError
from urllib.parse import quote
from urllib.request import urlopen

from rig.errors import RigError

LOOPBACK = "127.0.0.1"
RECORDING_PATH = "/recording.rrd"
PAGE_PATHS = ("/", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico")
MAX_FETCH_S = 60.0
"""Time limit for rerun to start and deliver its page, s."""


@dataclass(frozen=True)
class PageFile:
    """A file of rerun's page."""

    content_type: str
    content: bytes


def serve(recording_path: Path, show_address: Callable[[str], None]) -> None:
    """Serve the file to browsers on this computer until interrupted; `show_address` receives the address to open.

    Raises RigError if rerun does not deliver its page.
    """
    file_by_path = fetch_rerun_page()
    with ThreadingHTTPServer((LOOPBACK, 0), _handler_type(recording_path, file_by_path)) as server:
        server_address = f"http://{LOOPBACK}:{server.server_port}"
        show_address(f"{server_address}/?url={quote(server_address + RECORDING_PATH, safe='')}")
        server.serve_forever()


def fetch_rerun_page() -> dict[str, PageFile]:
    """Fetch rerun's page, by path, from its own server, which is then stopped; raise RigError if that fails."""
    deadline_s = time.monotonic() + MAX_FETCH_S
    with _rerun_server() as (port, process):
        while True:
            try:
                return {page_path: _fetch_page_file(f"http://{LOOPBACK}:{port}{page_path}") for page_path in PAGE_PATHS}
            except (URLError, OSError) as error:
                if process.poll() is None and time.monotonic() < deadline_s:
                    time.sleep(0.1)
                    continue
                raise RigError(
                    f"rerun gives no page for the browser ({error}); open the file by: {sys.executable} -m rerun FILE"
                ) from error


def _fetch_page_file(address: str) -> PageFile:
    with urlopen(address, timeout=MAX_FETCH_S) as response:
        return PageFile(response.headers["Content-Type"] or "application/octet-stream", response.read())


@contextmanager
def _rerun_server() -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """Run rerun's web server on the loopback address; yields its port and process."""
    page_port, data_port = free_ports()
    arguments = ["--serve-web", "--web-viewer-port", str(page_port), "--port", str(data_port)]
    with rerun_on_loopback(*arguments) as process:
        yield page_port, process


@contextmanager
def rerun_on_loopback(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run rerun, which listens on all addresses unless told otherwise, on the loopback address; yields its process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "rerun_cli", "--bind", LOOPBACK, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # it starts a program of its own, which is to end with it
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL) if hasattr(os, "killpg") else process.kill()
        process.wait()


def free_ports() -> tuple[int, int]:
    """Two ports of the loopback address that nothing listens on."""
    with socket.create_server((LOOPBACK, 0)) as page_socket, socket.create_server((LOOPBACK, 0)) as data_socket:
        return page_socket.getsockname()[1], data_socket.getsockname()[1]


def _handler_type(recording_path: Path, file_by_path: Mapping[str, PageFile]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            port = self.connection.getsockname()[1]
            request_path, _, _ = self.path.partition("?")
            if self.headers.get("Host") not in {f"{LOOPBACK}:{port}", f"localhost:{port}"}:
                self.send_error(403, "Ask for 127.0.0.1 or localhost")
            elif request_path in file_by_path:
                self._send_headers(file_by_path[request_path].content_type, len(file_by_path[request_path].content))
                with suppress(ConnectionError):  # the browser may leave at any time
                    self.wfile.write(file_by_path[request_path].content)
            elif request_path == RECORDING_PATH and recording_path.is_file():
                with recording_path.open("rb") as stream, suppress(ConnectionError):
                    self._send_headers("application/octet-stream", recording_path.stat().st_size)
                    shutil.copyfileobj(stream, self.wfile)
            else:
                self.send_error(404)

        def _send_headers(self, content_type: str, content_length: int) -> None:
            self.send_response(200)
            self.send_header("Content-Type", content_type)
            self.send_header("Content-Length", str(content_length))
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    return Handler
