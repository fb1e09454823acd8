"""Whatever a provider sends, through the real clients: an answer, or a MODEL_* failure that quotes what came."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.baselines.flat import flat_object
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.redaction import keep_secret
from config.load import load_station
from config.perception import HostedSettings
from perception.geometry.window import encode_png
from perception.models.budget import Budget
from perception.models.exchange import Line
from perception.models.gemini import GeminiProvider
from perception.models.hosted import HostedModel
from perception.models.openai import OpenAIProvider
from perception.observed_object import Answer, ObservedObject

KEY = "sk-0123456789abcdef"
MODEL_CODES = {code for code in Code if code.startswith("MODEL_")}
PICTURE = base64.b64encode(encode_png(np.zeros((64, 64, 3), np.uint8), 128)).decode()
APIS = ("responses", "chat", "edit", "gemini words", "gemini picture")
GOOD: dict[str, Any] = {
    "responses": {
        "output": [
            {"type": "reasoning", "summary": []},
            {"type": "message", "content": [{"type": "output_text", "text": "Here."}]},
        ],
        "usage": {"input_tokens": 5, "output_tokens": 7, "output_tokens_details": {"reasoning_tokens": 2}},
    },
    "chat": {
        "choices": [{"message": {"content": "Here.", "refusal": None}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 5, "completion_tokens": 7},
    },
    "edit": {"data": [{"b64_json": PICTURE}], "usage": {"input_tokens": 5, "output_tokens": 7}},
    "gemini words": {
        "candidates": [{"content": {"parts": [{"text": "Here."}]}, "finishReason": "STOP"}],
        "usageMetadata": {"promptTokenCount": 5, "candidatesTokenCount": 5, "thoughtsTokenCount": 2},
    },
    "gemini picture": {
        "candidates": [{"content": {"parts": [{"inlineData": {"mimeType": "image/png", "data": PICTURE}}]}}],
        "usageMetadata": {"promptTokenCount": 5, "candidatesTokenCount": 7},
    },
}
Send = Callable[..., Answer]


@pytest.fixture(scope="module")
def observed_object() -> ObservedObject:
    mask = np.zeros((90, 120), bool)
    mask[30:60, 40:80] = True
    return flat_object(np.full((90, 120, 3), 90, np.uint8), mask, 0.001, load_station())


@pytest.fixture(scope="module")
def send(observed_object: ObservedObject, tmp_path_factory: pytest.TempPathFactory) -> Send:
    """Asks over ``api`` a server that sends ``body``."""
    folder, next_one = tmp_path_factory.mktemp("spend"), list[httpx2.Response]()
    models = {api: model(api, lambda _: next_one.pop(), folder) for api in APIS}

    def ask(api: str, body: bytes, status: int = 200, content_type: str = "application/json") -> Answer:
        next_one[:] = [httpx2.Response(status, content=body, headers={"Content-Type": content_type})]
        if api in ("edit", "gemini picture"):
            return models[api].render(observed_object, "Draw.", Cancel())
        return models[api].direct(observed_object, "Say.", Cancel())

    return ask


def model(api: str, serve: Callable[[httpx2.Request], httpx2.Response], folder: Path) -> HostedModel:
    how = HostedSettings(
        text_model="t",
        image_model="i",
        base_url="http://models.example/v1",
        text_api="chat" if api == "chat" else "responses",
        size_px=256,
        attempts=1,
    )
    line = Line(lambda _deadline: httpx2.MockTransport(serve))
    provider = (GeminiProvider if api.startswith("gemini") else OpenAIProvider)(how, KEY, line)
    return HostedModel(provider, how, Budget(how, folder / "spend.jsonl"))


def failure(send: Send, *how: Any) -> CycleFailure:
    with pytest.raises(CycleFailure) as caught:
        send(*how)
    return caught.value


# --- what is good -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("api", APIS)
def test_a_good_answer_is_taken_with_its_usage(api: str, send: Send) -> None:
    answer = send(api, json.dumps(GOOD[api]).encode())
    assert answer.text == "Here." or answer.image_png == base64.b64decode(PICTURE)
    assert (answer.usage.input_tokens, answer.usage.output_tokens, answer.usage.is_complete) == (5, 7, True)


@pytest.mark.parametrize(
    "usage", [None, {}, {"input_tokens": 5}, {"input_tokens": None}, [], "7", {"input_tokens": -1}]
)
def test_a_usage_that_is_missing_or_partial_counts_as_what_is_known(usage: object, send: Send) -> None:
    answer = send("responses", json.dumps(GOOD["responses"] | {"usage": usage}).encode())
    known = usage.get("input_tokens") if isinstance(usage, dict) else None
    assert answer.text == "Here." and not answer.usage.is_complete
    assert answer.usage.input_tokens == max(known or 0, 0)


@pytest.mark.parametrize(
    "written",
    [
        base64.encodebytes(base64.b64decode(PICTURE)).decode(),
        PICTURE.replace("+", "-").replace("/", "_").rstrip("="),
        f"data:image/png;base64,{PICTURE}",
        f"data:image/webp;charset=utf-8;base64,{PICTURE}\r\n",
        f" \n{PICTURE}",
    ],
    ids=["lines", "urlsafe", "data", "data of another mime", "blanks"],
)
@pytest.mark.parametrize("api", ["edit", "gemini picture"])
def test_a_picture_in_base64_is_read_however_it_is_written(api: str, written: str, send: Send) -> None:
    body = json.dumps(GOOD[api]).replace(json.dumps(PICTURE), json.dumps(written))
    assert send(api, body.encode()).image_png == base64.b64decode(PICTURE)


def test_what_is_no_base64_is_no_picture(send: Send) -> None:
    body = json.dumps({"data": [{"b64_json": "no picture, sorry!"}]}).encode()
    assert failure(send, "edit", body).failure is Code.MODEL_BAD_IMAGE


# --- what is odd ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("api", APIS)
@pytest.mark.parametrize(
    ("body", "quoted"),
    [
        (b"<!doctype html><html><body>It works!</body></html>", "It works!"),
        (b"", "nothing"),
        (b'{"output": [', '{"output": ['),
        (b"null", "null"),
        (b"[]", "[]"),
        (b"[[[" + b"[" * 100_000, "[[["),
        (b"7" * 5000, "777"),
        (b"\xff\xfe\x00\xd8", "�"),
        (b'{"error": {"message": "model is loading [/INST]"}}', "model is loading [/INST]"),
        (b'{"error": "out of memory"}', "out of memory"),
    ],
    ids=["html", "empty", "torn", "null", "list", "deep", "long number", "bytes", "error", "error text"],
)
def test_a_body_that_is_no_answer_is_quoted(api: str, body: bytes, quoted: str, send: Send) -> None:
    ended = failure(send, api, body)
    assert ended.failure is Code.MODEL_UNAVAILABLE and quoted in ended.text and len(ended.text) < 400


@pytest.mark.parametrize(
    ("status", "body", "code"),
    [
        (302, b"", Code.MODEL_UNAVAILABLE),
        (400, b'{"error": {"message": "no", "code": "content_filter"}}', Code.MODEL_REFUSED),
        (401, b"<html>", Code.MODEL_ACCESS),
        (404, b"[]", Code.MODEL_ACCESS),
        (429, b'{"error": [null]}', Code.MODEL_QUOTA),
        (429, b'[{"error": {"details": [{"retryDelay": "1.2.3s"}, 4, null]}}]', Code.MODEL_QUOTA),
        (502, b"<html><h1>502 Bad Gateway</h1></html>", Code.MODEL_UNAVAILABLE),
        (200, b'{"error": {"code": 429, "message": "slowly"}}', Code.MODEL_QUOTA),
    ],
)
@pytest.mark.parametrize("api", APIS)
def test_a_status_has_its_code_whatever_its_body(api: str, status: int, body: bytes, code: Code, send: Send) -> None:
    assert failure(send, api, body, status).failure is code


_LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.just(PICTURE)
_JSON = st.recursive(
    _LEAF, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
)


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, one in inner for place in _places(one, (*path, key)))]


def _replaced(value: Any, path: tuple[Any, ...], by: Any) -> Any:
    if not path:
        return by
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = _replaced(copy[path[0]], path[1:], by)
    return copy


@st.composite
def _distorted(draw: st.DrawFn) -> tuple[str, bytes]:
    """A good answer of one API, with something else in one or two places."""
    api = draw(st.sampled_from(APIS))
    body = GOOD[api]
    for _ in range(draw(st.integers(1, 2))):
        body = _replaced(body, draw(st.sampled_from(_places(body))), draw(_JSON))
    return api, json.dumps(body).encode()


@given(how=_distorted())
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_a_distorted_answer_ends_as_an_answer_or_a_code(how: tuple[str, bytes], send: Send) -> None:
    _ends_well(send, *how, 200, "application/json")


@given(
    api=st.sampled_from(APIS),
    body=st.binary(max_size=60) | _JSON.map(lambda value: json.dumps(value).encode()),
    status=st.sampled_from([200, 201, 204, 299, 302, 400, 418, 429, 500, 599]),
    content_type=st.sampled_from(["application/json", "text/html", "text/event-stream", "application/json; charset=x"]),
)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_body_with_any_status_ends_as_an_answer_or_a_code(
    api: str, body: bytes, status: int, content_type: str, send: Send
) -> None:
    _ends_well(send, api, body, status, content_type)


def _ends_well(send: Send, *how: Any) -> None:
    try:
        answer = send(*how)
    except CycleFailure as ended:
        assert ended.failure in MODEL_CODES and len(ended.text) < 1500
        ended.text.encode()
    else:
        answer.text.encode()


# --- the key ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("api", APIS)
@pytest.mark.parametrize("status", [200, 400, 401, 500])
@pytest.mark.parametrize(
    "body",
    [
        f"<p>Authorization: Bearer {KEY}</p>",
        json.dumps({"error": {"message": f"Incorrect API key provided: {KEY}"}}),
        json.dumps({"error": "".join(f"\\u{ord(sign):04x}" for sign in KEY)}).replace("\\\\", "\\"),
        json.dumps({KEY: {"headers": [f"Bearer {KEY}"]}}),
    ],
    ids=["page", "error", "escaped", "echo"],
)
def test_a_key_that_comes_back_is_not_passed_on(api: str, status: int, body: str, send: Send) -> None:
    keep_secret(KEY)
    assert KEY not in failure(send, api, body.encode(), status).text


@pytest.mark.parametrize("api", ["responses", "chat", "gemini words"])
def test_a_key_in_the_models_words_is_hidden(api: str, send: Send) -> None:
    keep_secret(KEY)
    answer = send(api, json.dumps(GOOD[api]).replace("Here.", f"Your key is {KEY}.").encode())
    assert answer.text == "Your key is (secret)."


def test_a_picture_whose_file_holds_the_key_is_not_kept(send: Send) -> None:
    keep_secret(KEY)
    drawn = base64.b64encode(base64.b64decode(PICTURE) + KEY.encode()).decode()
    body = json.dumps(GOOD["edit"] | {"data": [{"b64_json": drawn}]}).encode()
    assert failure(send, "edit", body).failure is Code.MODEL_BAD_IMAGE


def test_a_redirect_takes_the_key_to_nobody_else(observed_object: ObservedObject, tmp_path: Path) -> None:
    asked: list[str] = []

    def serve(request: httpx2.Request) -> httpx2.Response:
        asked.append(request.url.host)
        return httpx2.Response(307, headers={"Location": "http://elsewhere.example/v1/responses"})

    for api in ("responses", "gemini words"):
        with pytest.raises(CycleFailure, match=r"elsewhere\.example"):
            model(api, serve, tmp_path).direct(observed_object, "Say.", Cancel())
    assert set(asked) == {"models.example"}
