"""The official clients against the stand-in: words, pictures, usage."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import openai
import pytest

from stand_ins.asked import Image, decode
from stand_ins.clients import (
    ROD,
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
from stand_ins.drift import Drift
from stand_ins.model_server import ModelServer, Picture


def test_words_of_responses_with_usage() -> None:
    with ModelServer(paint, say=lambda prompt, image: f"{prompt} {image is not None}") as server:
        with openai_client(server) as client:
            reply = respond(client, scene())
            assert respond(client).output_text == "Where? False"
        assert reply.output_text == "Where? True"
        assert reply.usage.output_tokens > reply.usage.output_tokens_details.reasoning_tokens > 0
        assert reply.usage.input_tokens > 258
        asked = server.requests[0]
        assert (asked.path, asked.kind, asked.model, asked.prompt) == ("/v1/responses", "text", "words", "Where?")
        assert asked.image is not None
        assert (asked.image == scene()).all()


def test_words_of_chat_with_usage() -> None:
    with ModelServer(paint, say=lambda prompt, image: "Here.") as server, openai_client(server) as client:
        reply = chat(client)
        assert reply.choices[0].message.content == "Here."
        assert reply.usage.total_tokens == reply.usage.prompt_tokens + reply.usage.completion_tokens > 258
        assert server.requests[0].image is not None


def test_words_of_gemini_with_usage() -> None:
    with ModelServer(paint, say=lambda prompt, image: "Here.") as server, gemini_client(server) as client:
        reply = generate(client, draw=False)
        used = reply.usage_metadata
        assert reply.text == "Here."
        assert used is not None
        assert (used.candidates_token_count, used.thoughts_token_count) == (2, 48)
        assert server.requests[0].model == "gem"


def test_an_edit_of_openai_with_its_mask() -> None:
    seen: list[Picture] = []

    def watch(picture: Picture) -> Image:
        seen.append(picture)
        return paint(picture)

    alpha = np.full((96, 128, 4), 255, dtype=np.uint8)
    alpha[:20, :, 3], alpha[20:40, :, 3] = 0, 1
    mask = ("mask.png", bytes(cv2.imencode(".png", alpha)[1]), "image/png")
    with ModelServer(watch) as server, openai_client(server) as client:
        reply = edit(client, mask=mask, size="128x96")
    assert (edited(reply) == paint(Picture(scene(), None, ""))).all()
    assert reply.usage.input_tokens == 260
    assert reply.usage.output_tokens_details.image_tokens == reply.usage.output_tokens
    assert seen[0].mask is not None
    assert (seen[0].mask == (alpha[..., 3] == 0)).all(), "only where alpha is 0"
    assert seen[0].prompt == server.requests[0].prompt == "A rod."


def test_an_edit_comes_in_the_size_asked_for() -> None:
    with ModelServer(paint) as server, openai_client(server) as client:
        assert edited(edit(client, size="256x192")).shape == (192, 256, 3)


def test_a_picture_of_gemini() -> None:
    with ModelServer(paint) as server, gemini_client(server) as client:
        reply = generate(client, draw=True)
        used = reply.usage_metadata
        assert (decode(pictures(reply)[0]) == paint(Picture(scene(), None, ""))).all()
        assert reply.text == "Here is the edited picture."
        assert used is not None
        assert (used.candidates_token_count or 0) > 1290
        assert (server.requests[0].kind, server.requests[0].mask) == ("image", None)


def test_no_connection_outlives_the_server() -> None:
    before = set(threading.enumerate())
    with ModelServer(paint) as server, openai_client(server) as client:
        respond(client)
        server.__exit__()
        assert set(threading.enumerate()) == before, "while the client still holds its connection"
        with pytest.raises(openai.APIConnectionError):
            respond(client)


def test_each_picture_may_drift_its_own_way() -> None:
    with (
        ModelServer(paint, drift=lambda number: Drift(shift_px=(4.0 * number, 0.0))) as server,
        openai_client(server) as client,
    ):
        first, second = (edited(edit(client)) for _ in range(2))
    assert (first == paint(Picture(scene(), None, ""))).all()
    rods = [np.argwhere((image == ROD).all(axis=2)).mean(axis=0) for image in (first, second)]
    assert np.allclose(rods[1] - rods[0], (0, 4), atol=0.3)
