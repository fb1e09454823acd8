"""How each fault looks to the official clients."""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable
from typing import Any

import cv2
import httpx2
import numpy as np
import openai
import pytest
from google.genai import errors, types

from stand_ins.asked import Image, decode, encode
from stand_ins.clients import (
    chat,
    edit,
    edited,
    gemini_client,
    generate,
    openai_client,
    paint,
    pictures,
    respond,
    scene,
)
from stand_ins.model_server import Fault, ModelServer, Picture

HANG_S = 0.3


def test_a_mask_of_another_size_is_not_taken() -> None:
    mask = bytes(cv2.imencode(".png", np.zeros((8, 8, 4), dtype=np.uint8))[1])
    with (
        ModelServer(paint) as server,
        openai_client(server) as client,
        pytest.raises(openai.BadRequestError, match="does not match"),
    ):
        edit(client, mask=("mask.png", mask, "image/png"))


@pytest.mark.parametrize(
    ("fault", "error", "status", "code"),
    [
        (Fault.RATE_LIMIT, openai.RateLimitError, 429, "rate_limit_exceeded"),
        (Fault.SERVER_ERROR, openai.InternalServerError, 500, None),
        (Fault.UNAUTHORIZED, openai.AuthenticationError, 401, "invalid_api_key"),
        (Fault.REFUSAL, openai.BadRequestError, 400, "moderation_blocked"),
    ],
)
def test_errors_of_openai(fault: Fault, error: type[openai.APIStatusError], status: int, code: str | None) -> None:
    with ModelServer(paint, faults=[fault, None], retry_after_s=7) as server, openai_client(server) as client:
        with pytest.raises(error) as raised:
            edit(client)
        assert (raised.value.status_code, raised.value.code) == (status, code)
        assert raised.value.response.headers.get("retry-after") == ("7" if status == 429 else None)
        assert edited(edit(client)).shape == scene().shape


@pytest.mark.parametrize(
    ("fault", "error", "code", "says"),
    [
        (Fault.RATE_LIMIT, errors.ClientError, 429, "'retryDelay': '7s'"),
        (Fault.SERVER_ERROR, errors.ServerError, 500, "INTERNAL"),
        (Fault.UNAUTHORIZED, errors.ClientError, 400, "API_KEY_INVALID"),
    ],
)
def test_errors_of_gemini(fault: Fault, error: type[errors.APIError], code: int, says: str) -> None:
    with ModelServer(paint, faults=[fault, None], retry_after_s=7) as server, gemini_client(server) as client:
        with pytest.raises(error) as raised:
            generate(client, draw=True)
        assert raised.value.code == code
        assert says in str(raised.value)
        assert len(pictures(generate(client, draw=True))) == 1


def test_a_refusal_in_words() -> None:
    with ModelServer(paint, faults=[Fault.REFUSAL] * 3) as server:
        with openai_client(server) as client:
            reply = respond(client)
            assert reply.output_text == ""
            assert "can't assist" in reply.output[-1].content[0].refusal
            message = chat(client).choices[0].message
            assert message.content is None
            assert "can't assist" in message.refusal
        with gemini_client(server) as client:
            refused = generate(client, draw=False)
            assert refused.text is None
            assert refused.prompt_feedback is not None
            assert refused.prompt_feedback.block_reason == types.BlockedReason.PROHIBITED_CONTENT


def test_a_refusal_to_draw_of_gemini() -> None:
    with ModelServer(paint, faults=[Fault.REFUSAL]) as server, gemini_client(server) as client:
        reply = generate(client, draw=True)
        assert pictures(reply) == []
        assert reply.candidates is not None
        assert reply.candidates[0].finish_reason == types.FinishReason.IMAGE_SAFETY


def test_nothing_is_said() -> None:
    with ModelServer(paint, faults=[Fault.NO_CONTENT] * 5) as server:
        with openai_client(server) as client:
            assert respond(client).output_text == ""
            assert chat(client).choices[0].message.content == ""
            assert edit(client).data[0].b64_json == ""
        with gemini_client(server) as client:
            assert generate(client, draw=False).text is None
            assert pictures(generate(client, draw=True)) == []


def test_words_where_a_picture_was_asked_for() -> None:
    with ModelServer(paint, faults=[Fault.TEXT_ONLY] * 2) as server:
        with openai_client(server) as client:
            assert edit(client).data == []
        with gemini_client(server) as client:
            reply = generate(client, draw=True)
            assert pictures(reply) == []
            assert "not draw" in (reply.text or "")


def test_half_a_picture_and_one_of_another_shape() -> None:
    with ModelServer(paint, faults=[Fault.TRUNCATED_PNG, Fault.WRONG_SIZE] * 2) as server:
        with openai_client(server) as client:
            torn = base64.b64decode(edit(client).data[0].b64_json)
            shapes = [edited(edit(client)).shape]
        with gemini_client(server) as client:
            also_torn = pictures(generate(client, draw=True))[0]
            shapes.append(decode(pictures(generate(client, draw=True))[0]).shape)
    whole = encode(paint(Picture(scene(), None, "")))
    assert torn == also_torn == whole[: len(whole) // 2]
    assert shapes == [(64, 128, 3), (64, 128, 3)]


@pytest.mark.parametrize("ask", [respond, chat, edit])
def test_a_hang_of_openai_ends_at_the_clients_timeout(ask: Callable[[openai.OpenAI], Any]) -> None:
    with (
        ModelServer(paint, faults=[Fault.HANG]) as server,
        openai_client(server, HANG_S) as client,
        pytest.raises(openai.APITimeoutError),
    ):
        ask(client)


def test_a_hang_of_gemini_ends_at_the_clients_timeout() -> None:
    with (
        ModelServer(paint, faults=[Fault.HANG]) as server,
        gemini_client(server, HANG_S) as client,
        pytest.raises(httpx2.ReadTimeout),
    ):
        generate(client, draw=False)


def test_a_hang_ends_with_the_server_and_leaves_no_thread() -> None:
    before = set(threading.enumerate())
    asked = threading.Event()
    raised: list[type[Exception]] = []

    class Telling(list[Any]):
        def append(self, item: Any) -> None:
            super().append(item)
            asked.set()

    def ask() -> None:
        try:
            respond(client)
        except openai.APIConnectionError as error:
            raised.append(type(error))

    with ModelServer(paint, faults=[Fault.HANG]) as server, openai_client(server) as client:
        server.requests = Telling()
        waiting = threading.Thread(target=ask)
        waiting.start()
        assert asked.wait(60)
        server.__exit__()
        waiting.join(60)
    assert raised == [openai.APIConnectionError]
    assert set(threading.enumerate()) == before


def test_faults_for_pictures_leave_words_alone() -> None:
    faults = [Fault.SERVER_ERROR, Fault.SERVER_ERROR]
    with ModelServer(paint, faults=faults, faults_for="image") as server, openai_client(server) as client:
        for _ in faults:
            assert respond(client).output_text
            with pytest.raises(openai.InternalServerError):
                edit(client)
        assert edited(edit(client)).shape == scene().shape


def test_a_fault_of_pictures_waits_for_one() -> None:
    with ModelServer(paint, faults=[Fault.TEXT_ONLY]) as server, openai_client(server) as client:
        assert respond(client).output_text
        assert edit(client).data == []


def test_the_clients_own_retries_see_the_faults_pass() -> None:
    with ModelServer(paint, faults=[Fault.RATE_LIMIT] * 2, retry_after_s=0) as server:
        with gemini_client(server, attempts=3) as client:
            assert len(pictures(generate(client, draw=True))) == 1
        assert len(server.requests) == 3


def test_a_broken_painter_is_told() -> None:
    def broken(picture: Picture) -> Image:
        raise ValueError("no axis")

    with (
        ModelServer(broken) as server,
        openai_client(server) as client,
        pytest.raises(openai.InternalServerError, match="ValueError: no axis"),
    ):
        edit(client)


def test_an_unknown_path_is_not_found() -> None:
    with ModelServer(paint) as server, openai_client(server) as client, pytest.raises(openai.NotFoundError):
        client.images.generate(model="draws", prompt="A rod.")
