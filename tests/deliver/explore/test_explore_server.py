"""The server of ``fastcoil explore``: for this machine alone, and with a sentence for what goes wrong."""

import asyncio
import http.client
import importlib.util
import re
import signal
import socket
import subprocess
import sys
import time
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


FEW = "from fastcoil.deliver.explore import server\nserver._PAGES, server._IDLE = 3, 2500"


@pytest.fixture(scope="module")
def program():
    """The program, with few pages at a time and little patience."""
    with exploring("lbnl", before=FEW) as found:
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


def opened(address):
    """The text of the page, as soon as there may be one more."""
    end = time.monotonic() + 60
    while (found := answer(address))[0] == 503 and time.monotonic() < end:
        time.sleep(0.2)
    assert found[0] == 200
    return found[1]


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
    assert answer(address, "/ws", **HANDSHAKE, Origin=f"http://localhost:{port}")[0] == 101
    for path in ("/?bokeh-session-id=mine", "/?kp=0.05&bokeh-token=mine", "/autoload.js", "/metadata"):
        assert answer(address, path)[0] == 404, path
    assert answer(address, Bokeh_Session_Id="mine")[0] == 404
    for taken_for in ("image", "iframe", "script", "empty"):
        assert answer(address, Sec_Fetch_Dest=taken_for)[0] == 404
    # an address of this machine that is not the one served: one that listens everywhere would answer
    with pytest.raises(OSError):  # noqa: PT011 — refused, or not there at all
        socket.create_connection(("127.0.0.2", port), timeout=5)


@pytest.mark.kernel
def test_pages_are_limited_and_given_back_when_nobody_is_connected(program):
    _, address = program
    answers = [answer(address) for _ in range(6)]
    assert {status for status, _ in answers} == {200, 503}
    said = "3 pages of fastcoil explore are open: close one, and load this one again in half a minute."
    assert answers[-1] == (503, said)
    assert "fastcoil" in opened(address)


@pytest.mark.kernel
def test_a_port_that_is_taken_is_refused_in_a_sentence(program):
    port = urlsplit(program[1]).port
    found = CliRunner().invoke(main, ["explore", "--no-browser", "--port", str(port)])
    assert found.exit_code == 2
    assert found.output.startswith(f"fastcoil: port {port} cannot be used (Address already in use")
    assert f"give another one above 1023, such as --port {port + 1}\n" in found.output


@pytest.mark.kernel
def test_a_message_that_is_none_of_the_page_ends_the_connection(program):
    """What is then said in the terminal the next test sees: a line, no traceback."""
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    _, address = program
    token = re.search('"token":"([^"]+)"', opened(address))[1]
    where = HTTPRequest(f"{address.replace('http', 'ws', 1)}ws", headers={"Origin": address.rstrip("/")})

    async def received():
        connection = await websocket_connect(where, subprotocols=["bokeh", token])
        for part in ('{"msgid": "1", "msgtype": "NOTHING"}', "{}", "{}"):
            await connection.write_message(part)
        found = [await connection.read_message() for _ in range(4)]  # three of the greeting
        connection.close()
        await asyncio.sleep(0.1)  # for the socket
        return found

    assert asyncio.run(received())[-1] is None


@pytest.mark.kernel
def test_sigterm_ends_it_as_ctrl_c_does(program):
    process, _ = program
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=30)
    assert out == "Ended.\n"
    assert set(err.splitlines()) <= {"fastcoil: a request or message that is not of this page was refused"}
    assert process.returncode == 0


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


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of open files")
def test_too_few_open_files_are_refused_in_a_sentence():
    command = f'ulimit -n 40; exec "{sys.executable}" -m fastcoil explore --no-browser --port 0'
    ran = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=120, check=False)
    assert (ran.returncode, "Traceback" in ran.stderr) == (2, False)
    assert "only 40 files may be open: allow 64 or more, with ulimit -n 64" in ran.stderr
