"""Access rules for queries: a topic that acts answers only its exact key, its own payload type and allowed clients."""

from __future__ import annotations

import time

import zenoh

from bus.errors import Refused
from bus.sample import Asked
from bus.seal import Seal
from bus.topics import Topic, encoding_of

_UNTYPED = frozenset({"zenoh/bytes", "zenoh/string", "zenoh/serialized", "application/json", "text/json", "text/plain"})
"""Encodings of programs that set none of ours; only the payload itself is then checked."""


def source_of(said: zenoh.Query | zenoh.Sample) -> str:
    """Return the session id that a query or sample names as its source; "" when it names none."""
    return str(said.source_info.source_id.zid) if said.source_info is not None else ""


def is_sealed(said: zenoh.Query | zenoh.Sample, seal: Seal | None) -> bool:
    """Whether the query or sample carries a valid seal: its session holds our secret (`bus.seal`)."""
    source, attached = said.source_info, said.attachment
    if seal is None or source is None or attached is None:
        return False
    payload = said.payload.to_bytes() if said.payload is not None else b""
    return seal.fits(attached.to_bytes(), str(said.key_expr), source_of(said), source.source_sn, payload)


def asked(query: zenoh.Query, seal: Seal | None) -> Asked:
    """Collect the facts about ``query`` that access and answering need.

    Args:
        seal: checks the query's seal; None where this process shares no secret with the cell.
    """
    source = query.source_info
    key = str(query.key_expr)
    return Asked(
        verb=key.rpartition("/")[2],
        is_exact="*" not in key,
        encoding=str(query.encoding or ""),
        has_payload=query.payload is not None and len(query.payload) > 0,
        takes_any_key=query.accepts_replies() == zenoh.ReplyKeyExpr.ANY,
        source=source_of(query),
        number=source.source_sn if source is not None else 0,
        is_sealed=is_sealed(query, seal),
        received_s=time.monotonic(),
    )


def refusal(topic: Topic, question: Asked, cell: str | None, *, needs_seal: bool = False) -> Refused | None:
    """Return why ``question`` may not be answered on ``topic``; None when it may, and for a topic that only reads.

    Args:
        cell: session id of the cell; None behind a router, where only certificates identify a client.
        needs_seal: this process shares a secret with the cell, so the cell's queries must be sealed.
    """
    if not topic.acts:
        return None
    if not question.is_exact:
        return Refused(f"{topic.key!r} acts: it answers no pattern.", "Ask for its exact key.", code="EXACT_KEY")
    if topic.acts == "cell":
        return _refusal_of_stranger(topic, question, cell, needs_seal)
    typed = encoding_of(topic.asks)
    if not question.has_payload:
        text = f"{topic.key!r} acts: it needs a payload of {typed!r}."
        return Refused(text, "Send at least {}; the fields: the query `schema`.", code="NO_PAYLOAD")
    if question.encoding not in _UNTYPED and question.encoding != typed:
        text = f"{topic.key!r} takes {typed!r}, not {question.encoding!r}."
        return Refused(text, "Set that encoding.", code="WRONG_ENCODING")
    return None


def _refusal_of_stranger(topic: Topic, question: Asked, cell: str | None, needs_seal: bool) -> Refused | None:
    """Refuse a query on a topic for the cell only, unless it is typed and comes, sealed where needed, from the cell."""
    is_typed = question.has_payload and question.encoding == encoding_of(topic.asks)
    is_cell = question.source != "" and cell in (None, question.source) and question.is_sealed >= needs_seal
    if is_typed and is_cell:
        return None
    advice = "Command the cell instead: cell/CELL_ID/command/VERB (docs/states.md)."
    return Refused(f"{topic.key!r} acts, and is for the cell's own session.", advice, code="NOT_THE_CELL")
