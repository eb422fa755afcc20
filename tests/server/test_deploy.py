"""The guide to deployment: what it shows is sound, as the programs say that it is for."""

import json
import re
import shlex
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from reverie_eval.server.opening import acting
from reverie_eval.server.settings import Settings, load_settings
from reverie_eval_cli.commands.serve import serve
from tests.conftest import COMMAND, REPOSITORY
from tests.support.ports import free_port
from tests.support.processes import Laptop
from tests.support.serving import GOOD, NO_TLS, OPEN, OWNER, PEOPLE, Serving, populate
from tests.support.waiting import PATIENCE, wait_until

PAGE = (REPOSITORY / "docs" / "how-to" / "deploy.md").read_text()


def blocks(language: str) -> list[str]:
    """Return the page's blocks in a language."""
    found = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert found
    return found


def program(name: str) -> str:
    """Return where a program is, beside Python or on the path; skips the test if it is nowhere."""
    beside = str(Path(sys.executable).parent)
    return shutil.which(name, path=beside) or shutil.which(name) or pytest.skip(f"no {name} here")


def accepts(*words: str) -> None:
    """Check the words after ``reverie-eval`` of a command that serves."""
    command, *arguments = words
    assert command == "serve"
    serve.make_context("serve", list(arguments))


def test_the_service_unit_is_sound(tmp_path: Path) -> None:
    (unit,) = blocks("ini")
    words = shlex.split(re.findall(r"^ExecStart=(.*)$", unit, re.MULTILINE)[0])
    accepts(*words[1:])
    # Processes that score are neither sent SIGTERM while uploads are finished, nor reason to stop.
    assert {"KillMode=mixed", "OOMPolicy=continue"} <= set(unit.splitlines())
    file = tmp_path / "reverie-eval.service"
    file.write_text(unit.replace(words[0], f'"{COMMAND}"'))
    verified = subprocess.run(
        [program("systemd-analyze"), "verify", file], capture_output=True, text=True, check=False
    )
    assert str(file.name) not in verified.stderr
    assert verified.returncode == 0, verified.stderr


def test_the_configuration_of_nginx_is_sound(tmp_path: Path) -> None:
    server, _ = blocks("nginx")
    nginx = program("nginx")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        [
            *(program("openssl"), "req", "-x509", "-nodes", "-newkey", "ec"),
            *("-pkeyopt", "ec_paramgen_curve:prime256v1", "-subj", "/CN=eval.example.org"),
            *("-keyout", str(key), "-out", str(certificate)),
        ],
        capture_output=True,
        check=True,
    )
    for name, file in (("fullchain", certificate), ("privkey", key)):
        server = re.sub(rf"/etc/\S*/{name}\.pem", str(file), server)
    server = server.replace("listen 443", "listen 8443")
    file = tmp_path / "nginx.conf"
    file.write_text(f"pid {tmp_path}/pid; error_log stderr; events {{}} http {{ {server} }}")
    tested = subprocess.run(
        [nginx, "-t", "-q", "-p", tmp_path, "-c", file], capture_output=True, text=True, check=False
    )
    assert tested.returncode == 0, tested.stderr


def test_participants_submit_below_a_path_of_nginx(folder: Path, tmp_path: Path) -> None:
    _, location = blocks("nginx")
    (tmp_path / "home").mkdir()
    laptop = Laptop(tmp_path / "home")
    (laptop.folder / "submit.json").write_bytes(GOOD)
    port = free_port()
    address = f"http://127.0.0.1:{port}/reverie"
    with acting(load_settings(folder), "test") as transaction:
        token = populate(transaction, PEOPLE)[OWNER]
    with laptop.serving(folder, variables={"REVERIE_EVAL_PUBLIC_ADDRESS": address}) as server:
        location = location.replace("http://127.0.0.1:8000", server.url)
        with nginx_with(f"server {{ listen 127.0.0.1:{port}; {location} }}", port, tmp_path):
            laptop.shell(f"echo {token} | '{COMMAND}' login --server {address}")
            words = ["submit", "submit.json", "--split", OPEN, "--method", "Walker", "--publish"]
            laptop.run(*words)
            assert "Walker" in laptop.run("leaderboard", "--split", OPEN).out
            receipt = "submit.json.receipt.json"
            assert "genuine" in laptop.run("verify", receipt, "--submission", "submit.json").out
            page = httpx.get(f"{address}/splits/{OPEN}", timeout=PATIENCE, verify=NO_TLS)
            assert 'href="/reverie/guide"' in page.text
            bare = httpx.get(address, timeout=PATIENCE, verify=NO_TLS, follow_redirects=True)
            assert str(bare.url).startswith(f"{address}/")
            signed_in = httpx.post(  # as a browser that sends no Sec-Fetch-Site
                f"{address}/sign-in",
                data={"token": token},
                headers={"Origin": f"http://127.0.0.1:{port}"},
                timeout=PATIENCE,
                verify=NO_TLS,
            )
            assert signed_in.status_code == HTTPStatus.SEE_OTHER, signed_in.text


@contextmanager
def nginx_with(servers: str, port: int, folder: Path) -> Iterator[None]:
    """Run nginx in a folder until the end, once it listens."""
    paths = " ".join(
        f"{kind}_temp_path {folder}/{kind};"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    file = folder / "nginx.conf"
    file.write_text(
        f"pid {folder}/pid; error_log stderr; daemon off; master_process off; "
        f"events {{}} http {{ access_log off; {paths} {servers} }}"
    )
    with subprocess.Popen([program("nginx"), "-p", folder, "-c", file]) as process:

        def listens() -> bool:
            assert process.poll() is None
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", port)) == 0

        try:
            wait_until(listens)
            yield
        finally:
            process.terminate()


@pytest.mark.parametrize("number", range(3))
def test_the_configuration_of_caddy_is_sound(number: int, tmp_path: Path) -> None:
    file = tmp_path / "Caddyfile"
    file.write_text(blocks("caddyfile")[number])
    command = [program("caddy"), "validate", "--adapter", "caddyfile", "--config", str(file)]
    validated = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        env={"HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path)},
    )
    assert validated.returncode == 0, validated.stderr


def test_the_container_starts_the_server() -> None:
    (steps,) = blocks("dockerfile")
    entry, command = (
        json.loads(re.findall(rf"^{name} (.*)$", steps, re.MULTILINE)[0])
        for name in ("ENTRYPOINT", "CMD")
    )
    assert entry == [COMMAND.name]
    accepts(*command)


def test_the_manifest_is_sound(
    server: Serving, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (manifest,) = blocks("yaml")
    deployment, service = yaml.safe_load_all(manifest)
    pod: dict[str, Any] = deployment["spec"]["template"]
    assert pod["metadata"]["labels"] == deployment["spec"]["selector"]["matchLabels"]
    assert pod["metadata"]["labels"] == service["spec"]["selector"]
    (container,) = pod["spec"]["containers"]
    accepts(*container["args"])
    port = int(container["args"][container["args"].index("--port") + 1])
    assert container["ports"] == [{"containerPort": port}]
    assert service["spec"]["ports"][0]["targetPort"] == port
    assert container["livenessProbe"]["tcpSocket"]["port"] == port
    probe = container["readinessProbe"]["httpGet"]
    assert probe["port"] == port
    assert server.client.get(probe["path"]).status_code == 200
    mounted = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    assert mounted.keys() == {volume["name"] for volume in pod["spec"]["volumes"]}
    assert mounted["folder"] == container["args"][1]
    for variable in container["env"]:
        assert variable["name"].removeprefix("REVERIE_EVAL_").lower() in Settings.model_fields
        monkeypatch.setenv(variable["name"], variable["value"])
    assert load_settings(folder).uploads == "s3://reverie/uploads"
