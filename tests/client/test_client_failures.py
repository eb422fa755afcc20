"""Whatever a participant comes upon: one line that says what it is, no traceback, a status."""

import json
import os
import signal
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from reverie_eval import __version__
from reverie_eval.client import Client, sending
from tests.conftest import SAMPLES
from tests.support.flat_world import Outcome, Run
from tests.support.participants import Proxy, RealServer, Script, answer, problem
from tests.support.ports import free_port
from tests.support.waiting import PATIENCE

pytestmark = pytest.mark.usefixtures("at_home")

SUBMIT = ["submit", str(SAMPLES / "good.json"), "--split", "val_unseen"]
PAGE = b"<html><title>Sign in to the hotel's network</title></html>"


@pytest.fixture(autouse=True)
def _token(at_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "sleep", lambda _: None)
    monkeypatch.setenv("REVERIE_EVAL_TOKEN", "rv_token")


def is_one_line(outcome: Outcome) -> bool:
    """Whether all that is said is one line, in letters, of something that could not be tried."""
    line = outcome.err.removesuffix("\n")
    return (outcome.status, outcome.out) == (2, "") and line.isprintable()


@pytest.mark.parametrize(
    ("reply", "said"),
    [
        pytest.param(
            problem("401 No", "not-signed-in", "this token has expired"),
            "REVERIE_EVAL_TOKEN is not a valid token (this token has expired); correct it, or "
            "unset it to use your login",
            id="token",
        ),
        pytest.param(
            problem("409 No", "not-open", "the organiser has paused submissions"),
            "the organiser has paused submissions",
            id="paused",
        ),
        pytest.param(
            problem("429 No", "quota-spent", "no"),
            "no submissions left; ask the organiser. Nothing was scored",
            id="quota",
        ),
        pytest.param(
            problem("404 No", "not-found", "no such page"),
            "SERVER is not compatible with reverie-eval VERSION (API v1); install the version "
            "that its organiser recommends",
            id="another version",
        ),
        pytest.param(
            answer("200 OK", b'{"splits": []}', "application/json"),
            "SERVER is not compatible with reverie-eval VERSION (API v1); install the version "
            "that its organiser recommends",
            id="another form",
        ),
        pytest.param(
            answer("413 Request Entity Too Large", PAGE),
            "the file is larger than a proxy in front of SERVER accepts (it answered 413 Request "
            "Entity Too Large); leave out fields other than instr_id, trajectory and the answer, "
            "or ask the organiser",
            id="too large for a proxy",
        ),
        pytest.param(
            answer("404 Not Found", PAGE),
            "SERVER is not an evaluation server (it answered 404 Not Found)",
            id="wrong URL",
        ),
        pytest.param(
            answer("200 OK", PAGE),
            "SERVER is not an evaluation server",
            id="page that wants a password",
        ),
        pytest.param(
            answer("307 Go", b"", "text/html", "Location: https://x.org/there/api/v1/splits"),
            "SERVER redirects to https://x.org/there; if that is right, use that URL",
            id="redirect",
        ),
        pytest.param(
            answer("302 Go", b"", "text/html", "Location: /login?next=x"),
            "SERVER redirects to SERVER/login?next=x; if that is right, use that URL",
            id="redirect to a page",
        ),
        pytest.param(
            problem("418 \x1b[2J", "\x1b", "teapot\x1b]0;x\x07\r\n\u202eneila \x9b2J"),
            r"teapot\x1b]0;x\x07\r\n\u202eneila \x9b2J",
            id="terminal's commands",
        ),
        pytest.param(
            answer("418 I\x1b[2J"),
            r"SERVER is not an evaluation server (it answered 418",
            id="and there",
        ),
    ],
)
def test_replies_that_are_no_success(reply: bytes, said: str, run: Run) -> None:
    with Script(reply) as server:
        outcome = run(*SUBMIT, "--server", server.url)
    assert is_one_line(outcome)
    expected = said.replace("SERVER", server.url).replace("VERSION", __version__)
    assert outcome.err.startswith(f"reverie-eval: {expected}")
    if "418" not in said:
        assert outcome.err == f"reverie-eval: {expected}\n"


@pytest.mark.parametrize(
    ("reply", "said"),
    [
        pytest.param(answer("502 Bad Gateway"), "is unavailable (it answered 502 Bad G", id="502"),
        pytest.param(problem("503 No", "stopping", "it is stopping"), "it is stopping", id="503"),
        pytest.param(b"", "the connection was dropped", id="hung up"),
        pytest.param(b"SSH-2.0-OpenSSH_9.2\r\n", "the connection was dropped", id="no HTTP"),
        pytest.param(
            answer("200 OK", b"[]", "application/json", "Content-Encoding: gzip"),
            "the connection was dropped",
            id="damaged",
        ),
    ],
)
def test_what_is_tried_again_is_told(reply: bytes, said: str, run: Run) -> None:
    with Script(reply) as server:
        outcome = run(*SUBMIT, "--server", server.url)
    *notices, last = outcome.err.splitlines()
    assert (outcome.status, outcome.out, len(notices), len(server.requests)) == (2, "", 5, 6)
    assert notices[0].endswith("; retrying in 0.5 s")
    assert all(said in line for line in (*notices, last))
    assert last.startswith("reverie-eval: ")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        pytest.param([], "which server? Name it with --server URL or REVERIE_EVAL_SERVER", id="no"),
        pytest.param(
            ["--server", f"http://127.0.0.1:{free_port()}"],
            "connection refused; no server",
            id="closed",
        ),
        pytest.param(["--server", "https://nowhere.invalid"], "host name not found", id="host"),
        pytest.param(
            ["--server", "http://10.0.0.1"], "is not encrypted: others on the network", id="http"
        ),
        pytest.param(["--server", "x.org"], "'x.org' is not a server URL", id="no URL"),
    ],
)
def test_ways_not_to_reach_a_server(options: list[str], said: str, run: Run) -> None:
    outcome = run(*SUBMIT, *options)
    assert is_one_line(outcome)
    assert said in outcome.err


def test_what_the_organiser_has_to_say_is_passed_on(run: Run) -> None:
    said = {"title": "T", "version": "9", "banner": "closing\x1b[2J at noon", "paused": False}
    rest = {"key_id": "0", "required_metadata": [], "organiser": "", "contact": "", "links": {}}
    server = json.dumps(said | rest).encode()
    replies = [answer("200 OK", content, "application/json") for content in (server, b"[]")]
    with Script(*replies) as script:
        outcome = run("leaderboard", "--server", script.url)
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.splitlines() == [
        rf"{script.url}: closing\x1b[2J at noon",
        f"reverie-eval: {script.url} has no split that accepts submissions",
    ]


class Unwilling(Proxy):
    """Lets nobody change anything."""

    def _serve(self, near: socket.socket) -> None:
        if near.recv(5, socket.MSG_PEEK) == b"PATCH":
            near.recv(1 << 16)
            near.sendall(problem("400 No", "malformed-request", "not today"))
        else:
            super()._serve(near)


def test_what_was_scored_is_shown_though_not_published(
    real_server: RealServer, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_TOKEN", real_server.mint(real_server.newcomer()))
    with Unwilling(real_server.url) as server:
        outcome = run(*SUBMIT, "--publish", "--receipt", "r.json", "--server", server.url)
    assert outcome.status == 2
    assert "RGSPL %" in outcome.out
    assert "\nnot published: " in outcome.out
    assert outcome.err == (
        "scored, but not published: not today; send the same file again, which uses no submission, "
        "with the same options\n"
    )
    assert run(*SUBMIT, "--publish", "--receipt", "r.json", "--server", real_server.url).status == 0


class TlsScript(Script):
    """A server with a certificate that nobody vouches for."""

    def __init__(self, folder: Path, reply: bytes) -> None:
        super().__init__(reply)
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(certificate(folder))
        self.url = self.url.replace("http://127.0.0.1", "https://localhost")

    def _serve(self, near: socket.socket) -> None:
        with self._context.wrap_socket(near, server_side=True) as private:
            super()._serve(private)


def certificate(folder: Path) -> Path:
    """Write a certificate for this machine, with its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    signed = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(datetime.now(UTC) - timedelta(days=1))
        .not_valid_after(datetime.now(UTC) + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .sign(key, hashes.SHA256())
    )
    file = folder / "certificate.pem"
    file.write_bytes(
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        + signed.public_bytes(Encoding.PEM)
    )
    return file


@pytest.fixture
def tls_server(tmp_path: Path) -> Iterator[TlsScript]:
    """Serve no splits over TLS."""
    with TlsScript(tmp_path, answer("200 OK", b"[]", "application/json")) as server:
        yield server


def test_a_certificate_that_nobody_vouches_for(tls_server: TlsScript, run: Run) -> None:
    outcome = run(*SUBMIT, "--server", tls_server.url)
    assert is_one_line(outcome)
    assert ": its TLS certificate is not trusted (self-signed certificate); " in outcome.err


def test_a_certificate_that_the_environment_names(
    tls_server: TlsScript, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also on this machine, which no proxy of the environment leads to."""
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "certificate.pem"))
    with Client(tls_server.url) as client:
        assert client.splits() == []


def test_tls_where_there_is_none(real_server: RealServer, run: Run) -> None:
    outcome = run(*SUBMIT, "--server", real_server.url.replace("http:", "https:"))
    assert is_one_line(outcome)
    assert "the TLS handshake failed" in outcome.err


class Mute(Proxy):
    """Takes an upload, and says nothing."""

    def __init__(self, server: str) -> None:
        super().__init__(server)
        self.has_upload, self.may_hang_up = threading.Event(), threading.Event()

    def _serve(self, near: socket.socket) -> None:
        if near.recv(4, socket.MSG_PEEK) == b"POST":
            self.has_upload.set()
            self.may_hang_up.wait(PATIENCE)
        else:
            super()._serve(near)


def test_an_interrupted_upload_says_what_to_do(real_server: RealServer) -> None:
    """The server never answers the upload; then comes Ctrl-C."""
    token = real_server.mint(real_server.newcomer())
    with Mute(real_server.url) as server:
        process = subprocess.Popen(
            [sys.executable, "-m", "reverie_eval_cli", *SUBMIT, "--server", server.url],
            env=os.environ | {"REVERIE_EVAL_TOKEN": token},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        with process:
            assert server.has_upload.wait(PATIENCE)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE)
            server.may_hang_up.set()
    assert is_one_line(Outcome(process.returncode, out, err))
    assert err.startswith("reverie-eval: interrupted; it may have been scored: send the same file")
