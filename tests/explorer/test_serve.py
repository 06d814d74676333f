"""The page, served to this machine alone."""

import json
import signal
import socket
import struct
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path

import pytest

from spectra_kit.errors import InvalidInputError
from spectra_kit.explorer.serve import serve

COMMAND = [
    *(sys.executable, "-m", "spectra_kit", "explore", "demo", "--points", "500", "-k", "4"),
    *("--solver", "none", "--serve", "--no-browser", "--json"),
]


def answer(port, path="/", **headers):
    """The status and the body that come back."""
    connection = HTTPConnection("127.0.0.1", port, timeout=5)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    with response:
        body = response.read()
    connection.close()
    return response.status, body


def test_the_page_and_nothing_else_is_served_to_this_machine_until_ctrl_c(tmp_path):
    process = subprocess.Popen(
        COMMAND, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        text = ""
        for line in iter(process.stdout.readline, ""):
            text += line
            if line == "}\n":
                break
        assert text, process.stderr.read()
        port = int(json.loads(text)["url"].rsplit(":", 1)[1].strip("/"))
        page = (tmp_path / "demo.html").read_bytes()
        for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"LOCALHOST:{port}"):
            assert answer(port, Host=host) == (200, page)
            for path in ("/demo.html", "/../demo.html", "/?x", "/etc/passwd"):
                assert answer(port, path, Host=host)[0] == 404
        # A name of elsewhere that leads to this machine, another port, and no name at all.
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", "127.0.0.1:1", ""):
            for path in ("/", "/demo.html"):
                status, body = answer(port, path, Host=host)
                assert (status, page in body) == (403, False)
        assert answer(port)[0] == 403
        # One that leaves, by a reset, before the page is sent: nothing is said of it.
        with socket.create_connection(("127.0.0.1", port), timeout=5) as left:
            left.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            left.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            left.recv(1)
        assert answer(port, Host=f"127.0.0.1:{port}") == (200, page)
        if sys.platform.startswith("linux"):  # where all of 127/8 is this machine
            with pytest.raises(OSError, match="refused"):
                socket.create_connection(("127.0.0.2", port), timeout=5)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
        assert (process.returncode, "Traceback" in err) == (0, False)
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(("127.0.0.1", port), timeout=5)
    finally:
        process.kill()
        process.communicate()


def test_what_cannot_be_served_is_refused(tmp_path, monkeypatch):
    page = tmp_path / "page.html"
    with pytest.raises(InvalidInputError, match="`page` must be a file"):
        serve(page)
    page.write_text("<p>")
    with pytest.raises(InvalidInputError, match=r"`port` must be in \[0, 65535\], got 70000"):
        serve(page, port=70000)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InvalidInputError, match=f"`port` must be one to listen on, got {port}"):
            serve(page, port=port)

    def unreadable(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "read_bytes", unreadable)
    with pytest.raises(PermissionError, match=r"page\.html"):  # it is not the port's fault
        serve(page)


def test_the_browser_opens_the_page(tmp_path, monkeypatch):
    page, opened = tmp_path / "page.html", []
    page.write_text("<p>")

    def opens(url):
        opened.append(url)
        raise KeyboardInterrupt

    monkeypatch.setattr("webbrowser.open", opens)
    serve(page, ready=opened.append)
    assert opened[0] == opened[1]
    assert opened[0].startswith("http://127.0.0.1:")
