"""A written page, served to the browsers of this machine."""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError

_HOST = "127.0.0.1"


@checked
def serve(
    page: str | os.PathLike[str],
    *,
    port: int = 0,
    open_browser: bool = True,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Serve a page to this machine alone, until Ctrl-C.

    Nothing but the page is served, on 127.0.0.1; for `port` 0 at any free one. `ready` is called
    with the address once it can be opened.
    """
    check_count("port", port, low=0, high=65535)
    if not Path(page).is_file():
        raise InvalidInputError("page", "be a file", repr(str(page)))
    handler = _handler(Path(page).read_bytes())
    try:
        server = ThreadingHTTPServer((_HOST, port), handler)
    except OSError as error:
        raise InvalidInputError(
            "port", "be one to listen on", f"{port} ({error})", advice="0 takes any that is free"
        ) from error
    with server:
        url = f"http://{_HOST}:{server.server_port}/"
        try:
            if ready is not None:
                ready(url)
            if open_browser:
                webbrowser.open(url)
            server.serve_forever()
        except KeyboardInterrupt:  # how one leaves
            return


def _handler(content: bytes) -> type[BaseHTTPRequestHandler]:
    """What answers to a request for ``/`` of a browser of this machine, and to no other."""

    class Handler(BaseHTTPRequestHandler):
        def handle(self) -> None:
            with suppress(ConnectionError):  # a browser may leave before all is sent
                super().handle()

        def do_GET(self) -> None:  # named by http.server
            if self._may_be_sent():
                self.wfile.write(content)

        def do_HEAD(self) -> None:
            self._may_be_sent()

        def _may_be_sent(self) -> bool:
            """Answer with all that comes before the page; without it where it is refused."""
            # A page from elsewhere may have its name resolved to this machine, and then counts as
            # one of this server to the browser: but its requests name it.
            port = self.connection.getsockname()[1]
            names = (_HOST, "localhost")
            hosts = {f"{name}:{port}" for name in names} | (set(names) if port == 80 else set())
            if self.headers.get("Host", "").lower() not in hosts:
                self.send_error(HTTPStatus.FORBIDDEN)
                return False
            if self.path != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
                return False
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            self.end_headers()
            return True

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    return Handler
