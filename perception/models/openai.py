"""OpenAI's API, and every server that speaks it (``base_url``): words by Responses or chat, edits with a mask."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import openai

from bus.codes import Code
from bus.messages import Usage
from config.schema import HostedSettings
from perception.models.base import Answer
from perception.models.hosted import ModelFault

KEY_VARIABLE = "OPENAI_API_KEY"
_BLOCKED = ("moderation_blocked", "content_policy_violation")
_OUT_OF_CREDIT = "insufficient_quota"


class OpenAIProvider:
    """The official ``openai`` package; its own retries are off, the cell's deadline holds."""

    def __init__(self, settings: HostedSettings, key: str) -> None:
        self.name = f"{settings.text_model}+{settings.image_model}"
        self._settings = settings
        self._client = openai.OpenAI(api_key=key, base_url=settings.base_url, max_retries=0)

    def say(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        with _faults():
            client = self._client.with_options(timeout=timeout_s)
            ask = _respond if self._settings.text_api == "responses" else _chat
            return ask(client, self._settings.text_model, prompt, image_png)

    def close(self) -> None:
        self._client.close()

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        size: Any = f"{self._settings.size_px}x{self._settings.size_px}"
        with _faults():
            reply = self._client.with_options(timeout=timeout_s).images.edit(
                model=self._settings.image_model,
                image=("object.png", image_png, "image/png"),
                mask=("keep.png", keep_png, "image/png"),
                prompt=prompt,
                size=size,
            )
        drawn = reply.data[0].b64_json if reply.data else None
        if not drawn:
            raise ModelFault(Code.MODEL_NO_IMAGE, "It answered the edit without a picture.")
        try:
            image = base64.b64decode(drawn, validate=True)
        except binascii.Error as error:
            raise ModelFault(Code.MODEL_BAD_IMAGE, f"The picture is no base64 text ({error}).") from error
        used = reply.usage
        usage = Usage(input_tokens=used.input_tokens, output_tokens=used.output_tokens) if used is not None else Usage()
        return Answer(image_png=image, usage=usage)


def _respond(client: openai.OpenAI, model: str, prompt: str, image_png: bytes | None) -> Answer:
    content: list[Any] = [{"type": "input_text", "text": prompt}]
    if image_png is not None:
        content.append({"type": "input_image", "image_url": _data_url(image_png), "detail": "high"})
    reply = client.responses.create(model=model, input=[{"role": "user", "content": content}])
    refusals = [
        part.refusal
        for item in reply.output
        if item.type == "message"
        for part in item.content
        if part.type == "refusal"
    ]
    if refusals or not reply.output_text.strip():
        raise ModelFault(Code.MODEL_REFUSED, f"It refused: {' '.join(refusals) or 'it said nothing'}")
    used = reply.usage
    if used is None:
        return Answer(text=reply.output_text)
    reasoning = used.output_tokens_details.reasoning_tokens
    usage = Usage(input_tokens=used.input_tokens, output_tokens=used.output_tokens, reasoning_tokens=reasoning)
    return Answer(text=reply.output_text, usage=usage)


def _chat(client: openai.OpenAI, model: str, prompt: str, image_png: bytes | None) -> Answer:
    content: list[Any] = [{"type": "text", "text": prompt}]
    if image_png is not None:
        content.append({"type": "image_url", "image_url": {"url": _data_url(image_png)}})
    reply = client.chat.completions.create(model=model, messages=[{"role": "user", "content": content}])
    message = reply.choices[0].message if reply.choices else None
    if message is None or message.refusal or not (message.content or "").strip():
        why = message.refusal if message is not None and message.refusal else "it said nothing"
        raise ModelFault(Code.MODEL_REFUSED, f"It refused: {why}")
    used = reply.usage
    usage = (
        Usage(input_tokens=used.prompt_tokens, output_tokens=used.completion_tokens) if used is not None else Usage()
    )
    return Answer(text=message.content or "", usage=usage)


def _data_url(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


@contextmanager
def _faults() -> Iterator[None]:
    """The package's errors as ours."""
    try:
        yield
    except openai.APITimeoutError as error:
        raise ModelFault(Code.MODEL_TIMEOUT, "It did not answer in time.", again=True) from error
    except openai.APIConnectionError as error:
        raise ModelFault(
            Code.MODEL_UNAVAILABLE, f"It cannot be reached ({error.__cause__ or error}).", again=True
        ) from error
    except openai.APIStatusError as error:
        raise _fault_of_status(error) from error
    except openai.OpenAIError as error:
        raise ModelFault(Code.MODEL_UNAVAILABLE, f"The answer could not be read ({error}).") from error


def _fault_of_status(error: openai.APIStatusError) -> ModelFault:
    what = f"{error.message} (HTTP {error.status_code})"
    match error:
        case openai.RateLimitError():
            after_s = _seconds(error.response.headers.get("retry-after"))
            return ModelFault(Code.MODEL_QUOTA, what, again=error.code != _OUT_OF_CREDIT, after_s=after_s)
        case openai.AuthenticationError() | openai.PermissionDeniedError() | openai.NotFoundError():
            return ModelFault(Code.MODEL_ACCESS, what)
        case openai.InternalServerError():
            return ModelFault(Code.MODEL_UNAVAILABLE, what, again=True)
        case _:
            blocked = "It refused: " if error.code in _BLOCKED else "It did not take the request: "
            return ModelFault(Code.MODEL_REFUSED, blocked + what)


def _seconds(header: str | None) -> float:
    """Retry-After in seconds; a date (rare) or nothing counts as 0."""
    return float(header) if header is not None and header.replace(".", "", 1).isdigit() else 0.0
