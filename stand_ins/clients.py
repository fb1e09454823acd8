"""The official client packages, connected to the stand-in, with one request each."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import openai
from google import genai
from google.genai import types

from .asked import Image, decode, encode
from .model_server import ModelServer, Picture

ROD = (255, 0, 200)


def scene() -> Image:
    """A green box on white."""
    image = np.full((96, 128, 3), 255, dtype=np.uint8)
    image[30:70, 50:80] = 40, 160, 60
    return image


def paint(picture: Picture) -> Image:
    """A bar through the box."""
    painted = picture.image.copy()
    painted[46:52, 30:50], painted[46:52, 80:100] = ROD, ROD
    return painted


@contextmanager
def openai_client(server: ModelServer, timeout_s: float = 10.0) -> Iterator[openai.OpenAI]:
    with openai.OpenAI(base_url=server.url + "/v1", api_key="x", max_retries=0, timeout=timeout_s) as client:
        yield client


@contextmanager
def gemini_client(server: ModelServer, timeout_s: float = 10.0, attempts: int = 1) -> Iterator[genai.Client]:
    retry = types.HttpRetryOptions(attempts=attempts, initial_delay=0.0, max_delay=0.0, jitter=0.0)
    options = types.HttpOptions(base_url=server.url, timeout=int(timeout_s * 1e3), retry_options=retry)
    with genai.Client(api_key="x", http_options=options) as client:
        yield client


def respond(client: openai.OpenAI, image: Image | None = None) -> Any:
    content: list[Any] = [{"type": "input_text", "text": "Where?"}]
    if image is not None:
        content.append({"type": "input_image", "image_url": data_url(image), "detail": "high"})
    return client.responses.create(model="words", input=[{"role": "user", "content": content}])


def chat(client: openai.OpenAI) -> Any:
    content: list[Any] = [
        {"type": "text", "text": "Where?"},
        {"type": "image_url", "image_url": {"url": data_url(scene())}},
    ]
    return client.chat.completions.create(model="open", messages=[{"role": "user", "content": content}])


def edit(client: openai.OpenAI, **more: Any) -> Any:
    image = ("object.png", encode(scene()), "image/png")
    return client.images.edit(model="draws", image=image, prompt="A rod.", **more)


def generate(client: genai.Client, *, draw: bool) -> types.GenerateContentResponse:
    parts = [types.Part.from_text(text="A rod."), types.Part.from_bytes(data=encode(scene()), mime_type="image/png")]
    wanted = ["TEXT", "IMAGE"] if draw else ["TEXT"]
    config = types.GenerateContentConfig(response_modalities=wanted)
    return client.models.generate_content(
        model="gem", contents=[types.Content(role="user", parts=parts)], config=config
    )


def data_url(image: Image) -> str:
    return "data:image/png;base64," + base64.b64encode(encode(image)).decode()


def edited(reply: Any) -> Image:
    return decode(base64.b64decode(reply.data[0].b64_json))


def pictures(reply: types.GenerateContentResponse) -> list[bytes]:
    assert reply.candidates is not None
    content = reply.candidates[0].content
    parts = (content.parts or []) if content is not None else []
    return [part.inline_data.data for part in parts if part.inline_data is not None and part.inline_data.data]
