"""The viewer in a browser: rerun's own page and the .rrd file, served by this process for as long as it runs."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

import rerun as rr
from rerun_bindings import get_app_url

NAME = "/recording.rrd"


def serve(path: Path, say: Callable[[str], None]) -> None:
    """Serves the file to browsers on this computer, says the address to open, and goes on until it is interrupted.

    Both servers are threads of this process, so that none outlives it. Only the page may read the file; the server of
    the page, which has no data, listens on all addresses.
    """
    rr.start_web_viewer_server(0)
    page = get_app_url()
    with ThreadingHTTPServer(("127.0.0.1", 0), _handler(path, page)) as server:
        say(f"{page}?url={quote(f'http://127.0.0.1:{server.server_port}{NAME}', safe='')}")
        server.serve_forever()


def _handler(path: Path, page: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                if self.path != NAME:
                    raise FileNotFoundError
                stream = path.open("rb")
            except OSError:
                self.send_error(404)
                return
            with stream, suppress(ConnectionError):  # the browser may leave at any time
                self.send_response(200)
                self.send_header("Content-Type", "application/octet-stream")
                self.send_header("Content-Length", str(path.stat().st_size))
                self.send_header("Access-Control-Allow-Origin", page)
                self.end_headers()
                shutil.copyfileobj(stream, self.wfile)

        def log_message(self, *_: object) -> None:
            """Nothing on the screen."""

    return Handler
