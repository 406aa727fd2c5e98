"""The server of ``fastcoil explore``: for this machine alone, and with a sentence for what goes wrong."""

import http.client
import importlib.util
import re
import signal
import socket
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner
from helpers.browsers import exploring

from fastcoil.cli.main import main

pytestmark = pytest.mark.skipif(importlib.util.find_spec("bokeh") is None, reason="bokeh is not installed")
HANDSHAKE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "bokeh",
}  # fmt: skip


@pytest.fixture(scope="module")
def program():
    with exploring("lbnl") as found:
        yield found


def answer(address, path="/", **headers):
    """(status, text) of what a program that sends these headers is given."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=30)
    try:
        connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        response = connection.getresponse()
        return response.status, "" if response.status == 101 else response.read().decode()
    finally:
        connection.close()


@pytest.mark.kernel
def test_it_is_there_for_this_machine_alone(program):
    _, address = program
    port = urlsplit(address).port
    status, page = answer(address)
    assert status == 200
    for tag in ("src=", "href="):
        assert all(rest.startswith(('"/static/', '"data:')) for rest in page.split(tag)[1:])
    assert answer(address, Host=f"somebody.example:{port}")[0] == 404
    assert answer(address, "/ws", **HANDSHAKE, Origin="http://somebody.example")[0] == 404
    assert answer(address, "/ws", **HANDSHAKE, Origin=f"http://localhost:{port + 1}")[0] == 404
    assert answer(address, Origin="http://somebody.example")[0] == 404
    assert answer(address, Origin=f"http://localhost:{port}")[0] == 200
    # a socket says where it comes from, and nobody else names a session
    assert answer(address, "/ws", **HANDSHAKE)[0] == 404
    token = re.search('"token":"([^"]+)"', page)[1]
    ours = HANDSHAKE | {"Sec-WebSocket-Protocol": f"bokeh, {token}"}
    assert answer(address, "/ws", **ours, Origin=f"http://localhost:{port}")[0] == 101
    for path in ("/?bokeh-session-id=mine", "/?kp=0.05&bokeh-token=mine", "/autoload.js", "/metadata"):
        assert answer(address, path)[0] == 404, path
    assert answer(address, Bokeh_Session_Id="mine")[0] == 404
    for taken_for in ("image", "iframe", "script", "empty"):
        assert answer(address, Sec_Fetch_Dest=taken_for)[0] == 404
    # an address of this machine that is not the one served: one that listens everywhere would answer
    with pytest.raises(OSError):  # noqa: PT011 — refused, or not there at all
        socket.create_connection(("127.0.0.2", port), timeout=5)


@pytest.mark.kernel
def test_a_port_that_is_taken_is_refused_in_a_sentence(program):
    port = urlsplit(program[1]).port
    found = CliRunner().invoke(main, ["explore", "--no-browser", "--port", str(port)])
    assert found.exit_code == 2
    assert found.output.startswith(f"fastcoil: port {port} cannot be used (Address already in use")
    assert f"give another one above 1023, such as --port {port + 1}\n" in found.output


@pytest.mark.kernel
def test_sigterm_ends_it_as_ctrl_c_does(program):
    process, _ = program
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "Ended.\n", "")


def test_without_the_extra_there_is_the_command_that_installs_it(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == "bokeh" else find(name, *more))
    found = CliRunner().invoke(main, ["explore"])
    assert found.exit_code == 2
    assert found.output == "fastcoil: explore needs the package bokeh: pip install 'fastcoil[explore]'\n"


def test_what_cannot_be_explored_is_refused_before_a_page_is_there(tmp_path):
    found = CliRunner().invoke(main, ["explore", str(tmp_path / "mine.toml"), "--no-browser"])
    assert found.exit_code == 2
    assert "no such file, folder or preset" in found.output
