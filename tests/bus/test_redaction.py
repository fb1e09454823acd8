"""Secrets are hidden in foreign texts, however they are written there."""

from __future__ import annotations

import base64
import html
import json
from urllib.parse import quote, quote_plus

import pytest

from bus.errors import ConfigError
from bus.redaction import HIDDEN, holds_secret, keep_secret, keep_secrets_of, quoted, redacted
from bus.secrets import checked_secret

ODD = 'k/ey+with"odd\\<signs>&%=~'


@pytest.mark.parametrize(
    "written",
    [
        ODD,
        json.dumps(ODD),
        json.dumps(ODD).replace("/", "\\/"),
        quote(ODD, safe=""),
        quote(ODD, safe="").lower(),
        quote_plus(ODD),
        html.escape(ODD),
        repr(ODD),
        repr(f"Bearer {ODD}".encode()),
        base64.b64encode(ODD.encode()).decode(),
    ],
)
def test_a_secret_is_hidden_in_every_spelling(written: str) -> None:
    keep_secret(ODD)
    said = redacted(f"Illegal header: <{written}>!")
    assert said.count(HIDDEN) == 1 and len(said) <= len("Illegal header: <b'Bearer '>!") + len(HIDDEN)


def test_a_quotation_is_short_and_printable_and_cut_only_after_the_secret_is_hidden() -> None:
    keep_secret("sk-0123456789abcdef")
    said = quoted("\x1b[31mno\n\tway: sk-0123456789abcdef" + "!" * 500, limit=20)
    assert said == "[31mno way: (secret) ..."


def test_the_password_of_a_proxy_is_a_secret_also_in_its_header() -> None:
    keep_secrets_of("http://anna:pass%2Fword1@proxy.example:3128")
    basic = base64.b64encode(b"anna:pass/word1").decode()
    for text in ("anna:pass/word1", "pass%2Fword1", f"Basic {basic}"):
        assert "word1" not in redacted(text) and basic not in redacted(text)


def test_what_a_server_of_ones_own_takes_for_a_key_is_no_secret() -> None:
    keep_secret("none")
    assert redacted("There is none.") == "There is none."


def test_a_secret_that_is_a_part_of_another_leaves_no_rest_of_it() -> None:
    keep_secret("sk-01234567")
    keep_secret("sk-0123456789abcdef")
    assert redacted("sk-0123456789abcdef") == HIDDEN


def test_bytes_with_a_secret_are_found() -> None:
    keep_secret("sk-0123456789abcdef")
    assert holds_secret(b"\x89PNG tEXt sk-0123456789abcdef") and not holds_secret(b"\x89PNG")


@pytest.mark.parametrize("text", ["sk-1234", "sk-1234\n", "\r\n sk-1234 \t"])
def test_a_key_is_taken_without_what_stands_around_it(text: str) -> None:
    assert checked_secret(text, "The variable K") == "sk-1234"


@pytest.mark.parametrize(
    "text", ["", " \n", "two words", "two\nlines", "“sk-1234”", "sk-1234\0", "\ufeffsk-1234", '"sk-1234"']
)
def test_a_key_that_no_header_can_carry_is_refused_unseen(text: str) -> None:
    with pytest.raises(ConfigError, match="The variable K") as refusal:
        checked_secret(text, "The variable K")
    assert "1234" not in str(refusal.value) and "words" not in str(refusal.value)
