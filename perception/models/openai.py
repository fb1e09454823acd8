"""OpenAI's API, and every compatible server (``base_url``): text by Responses or chat, image edits with a mask."""

from __future__ import annotations

import base64
from typing import Any

import openai

from bus.codes import Code
from bus.messages import Usage
from config.perception import HostedSettings
from perception.models.errors import ModelError
from perception.models.exchange import Line, Reply
from perception.models.reply import (
    entries,
    member,
    parsed,
    picture,
    quote_of,
    raw,
    refused,
    unreadable,
    usage_of,
    words,
)
from perception.observed_object import Answer

KEY_VARIABLE = "OPENAI_API_KEY"
SERVER = "https://api.openai.com/v1"


class OpenAIProvider:
    """The official ``openai`` package, with its own retries off; the cell's deadline applies."""

    def __init__(self, settings: HostedSettings, key: str, line: Line) -> None:
        self.name = f"{settings.text_model}+{settings.image_model}"
        self._settings, self._line = settings, line
        self._client = openai.OpenAI(
            api_key=key, base_url=settings.base_url or SERVER, max_retries=0, http_client=line.client
        )

    def complete(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        """Return the model's text for a prompt and, optionally, an image, within ``timeout_s``. Raises: ModelError."""
        client, model = self._client.with_options(timeout=timeout_s), self._settings.text_model
        if self._settings.text_api == "chat":
            chat = client.chat.completions.with_raw_response
            messages: list[Any] = [{"role": "user", "content": _chat_content(prompt, image_png)}]
            return _chatted(self._line.exchange(timeout_s, lambda: chat.create(model=model, messages=messages)))
        content = [{"role": "user", "content": _content(prompt, image_png)}]
        respond = client.responses.with_raw_response
        return _responded(self._line.exchange(timeout_s, lambda: respond.create(model=model, input=content)))  # type: ignore[arg-type]

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        """Return the redrawn image, within ``timeout_s``; ``keep_png`` is the mask. Raises: ModelError."""
        size: Any = f"{self._settings.size_px}x{self._settings.size_px}"
        images = self._client.with_options(timeout=timeout_s).images.with_raw_response
        reply = self._line.exchange(
            timeout_s,
            lambda: images.edit(
                model=self._settings.image_model,
                image=("object.png", image_png, "image/png"),
                mask=("keep.png", keep_png, "image/png"),
                prompt=prompt,
                size=size,
            ),
        )
        return _edited(reply)

    def close(self) -> None:
        """Close the connection."""
        self._line.close()


# --- requests ---------------------------------------------------------------------------------------------------------


def _content(prompt: str, image_png: bytes | None) -> list[Any]:
    content: list[Any] = [{"type": "input_text", "text": prompt}]
    if image_png is not None:
        content.append({"type": "input_image", "image_url": _data_url(image_png), "detail": "high"})
    return content


def _chat_content(prompt: str, image_png: bytes | None) -> list[Any]:
    content: list[Any] = [{"type": "text", "text": prompt}]
    if image_png is not None:
        content.append({"type": "image_url", "image_url": {"url": _data_url(image_png)}})
    return content


def _data_url(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


# --- replies ----------------------------------------------------------------------------------------------------------


def _responded(reply: Reply) -> Answer:
    body = parsed(reply)
    usage = _usage(body, "input_tokens", "output_tokens", "output_tokens_details")
    contents = [member(item, "content") for item in entries(body.get("output")) if member(item, "type") == "message"]
    if not isinstance(body.get("output"), list) or None in contents:
        raise unreadable(reply, "has no output", usage)
    parts = [part for content in contents for part in _parts(content)]
    text = "".join(words(member(part, "text")) for part in parts if member(part, "type") == "output_text")
    refusals = " ".join(_refusals(parts))
    if text.strip() and not refusals:
        return Answer(text=text, usage=usage)
    raise refused(reply, refusals or words(member(body, "incomplete_details", "reason")), usage)


def _parts(content: object) -> list[Any]:
    """A message's parts; some servers send only its text."""
    return [{"type": "output_text", "text": content}] if isinstance(content, str) else entries(content)


def _refusals(parts: list[Any]) -> list[str]:
    return [words(member(part, "refusal")) for part in parts if member(part, "type") == "refusal"]


def _chatted(reply: Reply) -> Answer:
    body = parsed(reply)
    usage = _usage(body, "prompt_tokens", "completion_tokens", "completion_tokens_details")
    message, ended = (member(body, "choices", 0, name) for name in ("message", "finish_reason"))
    if not isinstance(message, dict):
        raise unreadable(reply, "has no message", usage)
    content = message.get("content")
    text = words(content) or "".join(words(member(part, "text")) for part in entries(content))
    if text.strip() and not message.get("refusal"):
        return Answer(text=text, usage=usage)
    raise refused(reply, words(message.get("refusal")) or (words(ended) if ended != "stop" else ""), usage)


def _edited(reply: Reply) -> Answer:
    body = parsed(reply)
    usage = _usage(body, "input_tokens", "output_tokens", "output_tokens_details")
    drawn, address = (raw(member(body, "data", 0, name)) for name in ("b64_json", "url"))
    if not drawn and address.startswith("data:"):
        drawn = address
    if not drawn:
        raise ModelError(Code.MODEL_NO_IMAGE, f"It answered the edit without a picture: {quote_of(reply)}", usage=usage)
    return Answer(image_png=picture(drawn, usage), usage=usage)


def _usage(body: dict[str, Any], asked: str, answered: str, details: str) -> Usage:
    used = body.get("usage")
    return usage_of(member(used, asked), member(used, answered), member(used, details, "reasoning_tokens"))
