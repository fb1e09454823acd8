"""The OPC UA door with certificates and users: who comes in, and what a viewer may do."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("asyncua")  # the extra `opcua`

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from benchmarks.guarded import Guarded
from benchmarks.intruder import SHARES
from benchmarks.opcua_intruder import OpcuaIntruder
from benchmarks.tally import Tally
from bus.errors import ConfigError
from cell.cli.network.opcua_keys import make_opcua_keys
from cell.machine.states import State
from cell.opcua.needs import require_package
from cell.opcua.passwords import fits, new_user, read_users
from config.load import load_station
from tests.cell.opcua_bench import Plain, ScriptedCell, connected, serving

pytestmark = pytest.mark.xdist_group("opcua")
Prepare = Callable[[Client], Awaitable[None]]


class Site(NamedTuple):
    """A scripted cell behind a door with certificates, and the passwords of its two users."""

    cell: ScriptedCell
    endpoint: str
    keys: Path
    passwords: dict[str, str]

    def client(self, user: str = "ann", password: str = "", keys: Path | None = None) -> Prepare:
        """Prepares a client with a certificate, and a user unless it is ""."""

        async def prepare(client: Client) -> None:
            folder = keys or self.keys
            await client.set_security(
                SecurityPolicyBasic256Sha256,
                certificate=str(folder / "client.pem"),
                private_key=str(folder / "client-key.pem"),
                server_certificate=str(self.keys / "cell.pem"),
            )
            if user:
                client.set_user(user)
                client.set_password(password or self.passwords.get(user, "x"))

        return prepare


@pytest.fixture(scope="module")
def site(new_endpoint: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    keys = tmp_path_factory.mktemp("opcua")
    make_opcua_keys(keys, [])
    passwords, lines = {}, ["# who may connect"]
    for name, role in (("ann", "operator"), ("vic", "viewer")):
        passwords[name], line = new_user(name, role)
        lines.append(line)
    (keys / "users").write_text("\n".join(lines))
    (keys / "users").chmod(0o600)
    bus, door = new_endpoint(), new_endpoint().replace("tcp/", "opc.tcp://")
    names = {"certificate": "cell.pem", "key": "cell-key.pem", "trusted": "trusted", "users": "users"}
    settings = [f"opcua.{name}={keys / file}" for name, file in names.items()]
    cell = ScriptedCell(bus)
    with serving(load_station(None, [f"bus.endpoint={bus}", f"opcua.endpoint={door}/cell", *settings])) as endpoint:
        yield Site(cell, endpoint, keys, passwords)
    cell.bus.close()


def _refused(site: Site, prepare: Prepare | None, status: type[Exception]) -> None:
    async def run() -> None:
        with pytest.raises(status):
            async with connected(site.endpoint, prepare):
                pass

    asyncio.run(run())


def test_an_operator_with_a_trusted_certificate_commands(site: Site) -> None:
    async def run() -> None:
        async with connected(site.endpoint, site.client()) as plain:
            site.cell.enter(State.STOPPED)
            assert await plain.status("Reset") == "Good"
            assert "opcua-ann-" in site.cell.leases.holder

    asyncio.run(run())
    assert site.cell.lost.get(timeout=30).startswith("opcua-ann-")


def test_a_viewer_looks_and_brings_to_rest_and_no_more(site: Site) -> None:
    async def say(plain: Plain) -> None:
        assert await plain.read("TagID") == "sim"
        for method in ("Reset", "Unhold", "Clear", "Release"):
            assert await plain.status(method) == "BadUserAccessDenied"
        assert await plain.read("LastRefusal.Code") == "NO_RIGHT"
        site.cell.enter(State.EXECUTE)
        for method in ("Hold", "Suspend", "Stop", "Abort"):
            assert await plain.status(method) == "Good"

    async def run() -> None:
        async with connected(site.endpoint, site.client("vic")) as plain:
            await say(plain)

    asyncio.run(run())


@pytest.mark.parametrize(
    ("user", "password", "status"),
    [
        ("ann", "wrong", ua.uaerrors.BadUserAccessDenied),
        ("admin", "x", ua.uaerrors.BadUserAccessDenied),
        ("", "", ua.uaerrors.BadIdentityTokenRejected),
    ],
    ids=["wrong password", "the package's administrator", "nobody"],
)
def test_who_is_not_in_the_file_does_not_come_in(site: Site, user: str, password: str, status: type[Exception]) -> None:
    _refused(site, site.client(user, password), status)


def test_without_a_certificate_there_is_no_session(site: Site) -> None:
    _refused(site, None, Exception)


def test_a_certificate_that_signed_itself_is_not_trusted(site: Site, tmp_path: Path) -> None:
    make_opcua_keys(tmp_path, [])
    _refused(site, site.client(keys=tmp_path), ua.uaerrors.BadCertificateUntrusted)


def test_a_trusted_certificate_cannot_be_shown_over_the_channel_of_another(site: Site, tmp_path: Path) -> None:
    """The trusted one is no secret; the package compares it with nothing."""
    make_opcua_keys(tmp_path, [])
    stolen = x509.load_pem_x509_certificate((site.keys / "client.pem").read_bytes())

    async def prepare(client: Client) -> None:
        await site.client(keys=tmp_path)(client)
        create = client.uaclient.create_session

        async def create_with_the_stolen_one(parameters: ua.CreateSessionParameters) -> ua.CreateSessionResult:
            parameters.ClientCertificate = stolen.public_bytes(Encoding.DER)
            return await create(parameters)

        client.uaclient.create_session = create_with_the_stolen_one

    _refused(site, prepare, ua.uaerrors.BadSecurityChecksFailed)


def test_an_intruder_opens_no_session_and_a_viewer_changes_nothing(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As `benchmarks intruder` does it, ten thousand times."""
    make_opcua_keys(tmp_path, [])
    tally, before = Tally(), len(site.cell.commands)
    guarded = Guarded(site.keys, tmp_path, site.passwords, ())
    with closing(OpcuaIntruder(site.endpoint, guarded, tally, np.random.default_rng(1))) as intruder:
        assert set(intruder.kinds) == {kind for kind in SHARES if kind.startswith("opcua_")}
        for kind in intruder.kinds:
            for _ in range({"opcua_write": 10, "opcua_call": 40}.get(kind, 1)):
                intruder.attempt(kind)
    assert (tally.figures()["accepted_kinds"], tally.cases) == ({}, [])
    assert tally.by_code["OPC UA BadUserAccessDenied"] >= 50
    assert tally.by_code["OPC UA Good"] == 1, "the honest session"
    assert len(site.cell.commands) == before
    assert not [record for record in caplog.records if record.name.startswith("asyncua")], "it fills no log"


def test_another_application_than_the_certificates_is_refused(site: Site) -> None:
    async def prepare(client: Client) -> None:
        await site.client()(client)
        client.application_uri = "urn:somebody:else"

    _refused(site, prepare, ua.uaerrors.BadCertificateUriInvalid)


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        ("ann operator", 0o600, "Line 1"),
        ("ann king " + "0" * 64, 0o600, "Line 1"),
        ("# nobody\n", 0o600, "names nobody"),
        ("", 0o604, "Everybody on this machine can read"),
    ],
)
def test_a_file_of_users_that_is_none_is_refused(tmp_path: Path, content: str, mode: int, words: str) -> None:
    file = tmp_path / "users"
    file.write_text(content)
    file.chmod(mode)
    with pytest.raises(ConfigError, match=words):
        read_users(file)


def test_the_command_line_makes_users_and_certificates(
    in_process: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    made = in_process("opcua", "--user", "ann", "--role", "viewer")
    file = tmp_path / "users"
    file.write_text(made.stdout)
    file.chmod(0o600)
    role, hashed = read_users(file)["ann"]
    assert role == "viewer" and fits(made.stderr.split()[-1], hashed)
    assert in_process("opcua", "--user", "a b").returncode == 2
    assert in_process("opcua", "--user", "ann", "--role", "king").returncode == 2
    assert in_process("keys", str(tmp_path), "--opcua").returncode == 0
    assert {path.name for path in tmp_path.rglob("*.pem")} == {
        "cell.pem",
        "cell-key.pem",
        "client.pem",
        "client-key.pem",
    }
    assert (tmp_path / "cell-key.pem").stat().st_mode & 0o777 == 0o600


def test_without_the_package_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.opcua.needs.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"vlad-cell\[opcua\]"):
        require_package()
