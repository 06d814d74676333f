"""The page, served to this machine alone."""

import json
import socket
import struct
import sys
import threading
from http.client import HTTPConnection
from pathlib import Path
from queue import SimpleQueue

import pytest

from spectra_kit.cli import main
from spectra_kit.errors import InvalidInputError
from spectra_kit.show.explorer.serve import serve


def answer(port, path="/", method="GET", **headers):
    """The status, the length that is promised, and the body that come back."""
    connection = HTTPConnection("127.0.0.1", port, timeout=5)
    connection.putrequest(method, path, skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    with response:
        found = response.status, response.headers["Content-Length"], response.read()
    connection.close()
    return found


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "demo.html"
    path.write_bytes(b"<p>" + bytes(range(256)) * 4096)
    return path


def test_the_page_and_nothing_else_is_served_to_this_machine(page, capfd):
    told, content = SimpleQueue(), page.read_bytes()
    options = {"open_browser": False, "ready": told.put}
    threading.Thread(target=serve, args=(page,), kwargs=options, daemon=True).start()
    port = int(told.get(timeout=10).rsplit(":", 1)[1].strip("/"))
    size = str(len(content))
    for host in (f"127.0.0.1:{port}", f"LOCALHOST:{port}"):
        assert answer(port, Host=host) == (200, size, content)
        assert answer(port, method="HEAD", Host=host) == (200, size, b"")
        for path in ("/demo.html", "/../demo.html", "/?x", "/etc/passwd"):
            assert answer(port, path, Host=host)[0] == 404
            assert answer(port, path, "HEAD", Host=host)[0] == 404
    # A name of elsewhere that leads to this machine, another port, and no name at all.
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", "127.0.0.1:1", ""):
        status, _, body = answer(port, Host=host)
        assert (status, content in body) == (403, False)
    assert answer(port)[0] == 403
    assert answer(port, method="POST", Host=f"127.0.0.1:{port}")[0] == 501
    # One that leaves, by a reset, before the page is sent: nothing is said of it.
    with socket.create_connection(("127.0.0.1", port), timeout=5) as left:
        left.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        left.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        left.recv(1)
    assert answer(port, Host=f"127.0.0.1:{port}") == (200, size, content)
    assert capfd.readouterr() == ("", "")
    if sys.platform.startswith("linux"):  # where all of 127/8 is this machine
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(("127.0.0.2", port), timeout=5)


def test_what_cannot_be_served_is_refused(page, monkeypatch):
    with pytest.raises(InvalidInputError, match="`page` must be a file"):
        serve(page.with_name("none.html"))
    with pytest.raises(InvalidInputError, match=r"`port` must be in \[0, 65535\], got 70000"):
        serve(page, port=70000)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InvalidInputError, match=f"`port` must be one to listen on, got {port}"):
            serve(page, port=port)

    def unreadable(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "read_bytes", unreadable)
    with pytest.raises(PermissionError, match=r"demo\.html"):  # it is not the port's fault
        serve(page)


def test_the_browser_opens_the_page_until_ctrl_c(page, monkeypatch):
    opened = []

    def opens(url):
        opened.append(url)
        raise KeyboardInterrupt

    monkeypatch.setattr("webbrowser.open", opens)
    serve(page, ready=opened.append)
    assert opened[0] == opened[1]
    assert opened[0].startswith("http://127.0.0.1:")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", int(opened[0][17:-1])), timeout=5)


def test_the_command_serves_what_it_has_written(tmp_path, monkeypatch, capsys):
    def opens(url):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", opens)
    options = ["--points", "500", "-k", "4", "--solver", "none", "--serve", "--json"]
    assert main(["explore", "demo", *options]) == 0
    assert json.loads(capsys.readouterr().out)["url"].startswith("http://127.0.0.1:")
    assert (tmp_path / "demo.html").is_file()
