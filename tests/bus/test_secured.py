"""Beyond loopback only what is safe: the parsed Zenoh configuration is looked at, and every gap is named."""

from __future__ import annotations

import errno
import json
import re
import shutil
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bus import topics
from bus.errors import ConfigError
from bus.secrets import read_secret
from bus.secured import LEASE_MS, is_loopback, session_config
from bus.session import Bus
from cell.cli.network.tls_keys import make_keys

AWAY = "tls/10.0.0.1:7447"


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, ["10.0.0.1"])
    return folder


def refusal(file: Path | None, *, listen: str = AWAY, connect: str | None = None) -> str:
    with pytest.raises(ConfigError) as error:
        session_config("peer", listen=[listen], connect=[connect] if connect else [], file=file)
    assert error.value.exit_code == 2 and "docs/security.md" in error.value.advice
    return error.value.text


@pytest.fixture
def changed(keys: Path) -> Callable[[str, Any], Path]:
    """The cell's file, with one key of it changed; `None` = taken away."""

    def change(key: str, value: Any) -> Path:
        config = session_config("peer", listen=[AWAY], connect=[], file=keys / "cell.json5")
        tree = json.loads(str(config))
        *path, leaf = key.split(".")
        node = tree
        for part in path:
            node = node[part]
        node[leaf] = value
        file = keys / "changed.json5"
        file.write_text(json.dumps({name: tree[name] for name in ("transport", "access_control")}))
        return file

    return change


@pytest.mark.parametrize("role", ["cell", "router"])
def test_the_files_of_cell_keys_are_safe(keys: Path, role: str) -> None:
    assert session_config("peer", listen=[AWAY], connect=[], file=keys / f"{role}.json5")


@pytest.mark.parametrize("role", ["cell", "node", "operator", "viewer"])
def test_they_find_their_way_out_too(keys: Path, role: str) -> None:
    config = session_config("client", listen=[], connect=[AWAY], file=keys / f"{role}.json5")
    assert json.loads(config.get_json("transport/link/tls/root_ca_certificate")) == str(keys / "ca.pem")


@pytest.mark.parametrize("role", ["cell", "router"])
@pytest.mark.parametrize("rule", ["hear-in", "hear-out"])
def test_a_viewer_may_hear_whatever_is_published(keys: Path, role: str, rule: str) -> None:
    config = zenoh.Config.from_json5((keys / f"{role}.json5").read_text())
    rules = json.loads(config.get_json("access_control/rules"))
    (allowed,) = (one["key_exprs"] for one in rules if one["id"] == rule)
    said = [f"cell/one/{topic.key.format(name='arm')}" for topic in topics.TOPICS if topic.kind == "publish"]
    assert [key for key in said if not any(zenoh.KeyExpr(one).includes(zenoh.KeyExpr(key)) for one in allowed)] == []


def test_our_rules_hold_whatever_the_file_says(keys: Path) -> None:
    file = keys / "loud.json5"
    text = (keys / "cell.json5").read_text().replace("{\n", "{ scouting: { gossip: { enabled: true } },\n", 1)
    file.write_text(text + "\n")
    config = session_config("peer", listen=[AWAY], connect=[], file=file)
    said: Mapping[str, Any] = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "adminspace/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/shared_memory/enabled": False,
        "listen/endpoints": [AWAY],
    }
    assert {key: json.loads(config.get_json(key)) for key in said} == said


def test_only_a_simulation_gives_the_starved_more_time_than_the_lease() -> None:
    def lease_ms(is_slowed: bool) -> int:
        config = session_config("peer", listen=["tcp/127.0.0.1:0"], connect=[], file=None, is_slowed=is_slowed)
        return int(config.get_json("transport/link/tx/lease"))

    assert lease_ms(False) == LEASE_MS and lease_ms(True) >= 60 * LEASE_MS


@pytest.mark.parametrize("endpoint", ["tcp/10.0.0.1:7447", "tcp/0.0.0.0:7447", "udp/127.0.0.1:7447", "ws/10.0.0.1:1"])
def test_in_the_clear_nothing_leaves_loopback_not_even_with_a_good_file(keys: Path, endpoint: str) -> None:
    assert not is_loopback(endpoint)
    assert "neither loopback nor encrypted" in refusal(keys / "cell.json5", listen=endpoint)
    assert "neither loopback nor encrypted" in refusal(keys / "cell.json5", connect=endpoint)


def test_beyond_loopback_a_file_is_needed() -> None:
    assert "no Zenoh file says who may do what" in refusal(None)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("access_control.enabled", False, "access_control.enabled is not true"),
        ("access_control.default_permission", "allow", 'default_permission is not "deny"'),
        ("access_control.subjects", [{"id": "anybody"}], "'anybody' .* means everybody"),
        ("access_control.policies", [], "policies is empty"),
        ("transport.link.tls.enable_mtls", False, "enable_mtls is not true"),
        ("transport.link.tls.root_ca_certificate", None, "root_ca_certificate is not set"),
        ("transport.link.tls.listen_private_key", None, "listen_private_key is not set"),
        ("transport.link.tls.listen_private_key", "operator.key", "cannot be used"),
        ("transport.link.tls.listen_certificate", "absent.pem", "cannot be used"),
    ],
)
def test_what_is_missing_is_named(changed: Callable[[str, Any], Path], key: str, value: Any, says: str) -> None:
    assert re.search(says, refusal(changed(key, value)))


def test_a_file_that_trusts_any_name_is_refused(changed: Callable[[str, Any], Path]) -> None:
    file = changed("transport.link.tls.verify_name_on_connect", False)
    assert "could pose as the cell" in refusal(file, listen="tcp/127.0.0.1:1", connect=AWAY)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    assert "Cannot read" in refusal(tmp_path / "absent.json5")
    (tmp_path / "bad.json5").write_text('{ "acces_control": {} }')
    assert "no Zenoh configuration" in refusal(tmp_path / "bad.json5")


@pytest.mark.parametrize("opened", [Bus.listen, Bus.join])
def test_a_named_file_is_looked_for_on_loopback_too(
    opened: Callable[..., Bus], endpoint: str, keys: Path, tmp_path: Path
) -> None:
    (tmp_path / "bad.json5").write_bytes(b"\xff")
    for name, says in (("absent.json5", "Cannot read the Zenoh file"), ("bad.json5", "no Zenoh configuration")):
        with pytest.raises(ConfigError, match=says) as error:
            opened("test", endpoint, security=tmp_path / name)
        assert name in error.value.text and "docs/security.md" in error.value.advice
    with Bus.listen("test", endpoint, security=keys / "cell.json5") as cell:
        assert not cell.is_secured, "on loopback nobody needs it"


def test_a_file_that_is_not_for_this_user_keeps_nobody_of_this_machine_out(
    endpoint: str, keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(file: Path) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", file)

    monkeypatch.setattr(Path, "read_text", refused)  # root, who may run this, may read everything
    with Bus.listen("test", endpoint, security=keys / "cell.json5") as cell:
        assert not cell.is_secured
    assert "Permission denied" in refusal(keys / "cell.json5"), "beyond loopback it is needed"


def test_a_key_that_everybody_can_read_is_refused(keys: Path, tmp_path: Path) -> None:
    shutil.copytree(keys, tmp_path / "open")
    (tmp_path / "open" / "cell.key").chmod(0o644)
    with pytest.raises(ConfigError, match=r"Everybody .* can read .*cell\.key"):
        session_config("peer", listen=[AWAY], connect=[], file=tmp_path / "open" / "cell.json5")


def test_a_secret_is_private_outside_the_project_and_one_line(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("sk-1234\n")
    file.chmod(0o600)
    assert read_secret(file, "key file") == "sk-1234"
    (tmp_path / ".git").mkdir()
    with pytest.raises(ConfigError, match="would be committed"):
        read_secret(file, "key file")
    (tmp_path / ".git").rmdir()
    file.write_text("two words\n")
    with pytest.raises(ConfigError, match="one line") as error:
        read_secret(file, "key file")
    assert "words" not in str(error.value)


def test_connections_that_say_nothing_keep_no_client_out(endpoint: str) -> None:
    """300 half-open ones: each is dropped after a second, and there is room for more meanwhile."""
    address = ("127.0.0.1", int(endpoint.rpartition(":")[2]))
    with Bus.listen("test", endpoint) as cell, ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(socket.create_connection(address))
        with Bus.join("test", endpoint) as bus:
            bus.announce(topics.NODE_ALIVE, name="sim")
            give_up_s = time.monotonic() + 60
            while cell.alive(topics.NODE_ALIVE) != {"sim"}:
                assert time.monotonic() < give_up_s
