"""Google's Gemini API. It takes no mask: the region to keep is drawn into the request, and the result is checked."""

from __future__ import annotations

from typing import Any

import httpx2
from google import genai
from google.genai import types

from bus.codes import Code
from bus.messages import Usage
from bus.redaction import quoted
from config.perception import HostedSettings
from perception.models.errors import ModelError
from perception.models.exchange import Line, Reply
from perception.models.reply import entries, member, parsed, picture, raw, refused, unreadable, usage_of, words
from perception.observed_object import Answer

KEY_VARIABLE = "GEMINI_API_KEY"
SERVER = "https://generativelanguage.googleapis.com"
_KEEP = (
    "\n\nThe second image is a map of the first: what is white there is the object, which must stay exactly as it is; "
    "draw only where the map is black. Answer with one square picture of the first image's framing."
)


class GeminiProvider:
    """The official ``google-genai`` package, with its own retries off; the cell's deadline applies."""

    def __init__(self, settings: HostedSettings, key: str, line: Line) -> None:
        self.name = f"{settings.text_model}+{settings.image_model}"
        self._settings, self._line = settings, line
        options = types.HttpOptions(
            base_url=settings.base_url or SERVER,
            retry_options=types.HttpRetryOptions(attempts=1),
            httpx_client=line.client,
            # Never used; the package's default would read the proxy settings and could fail on them.
            httpx_async_client=httpx2.AsyncClient(transport=httpx2.AsyncBaseTransport(), trust_env=False),
        )
        self._client = genai.Client(api_key=key, http_options=options)

    def complete(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        """Return the model's text for a prompt and an image, within ``timeout_s``. Raises: ModelError."""
        contents: list[Any] = [types.Part.from_text(text=prompt)]
        if image_png is not None:
            contents.append(types.Part.from_bytes(data=image_png, mime_type="image/png"))
        return _said(self._generate(self._settings.text_model, contents, ["TEXT"], timeout_s))

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        """Return the redrawn image, within ``timeout_s``; the mask is sent as a second image. Raises: ModelError."""
        contents: list[Any] = [types.Part.from_text(text=prompt + _KEEP)]
        contents += [types.Part.from_bytes(data=png, mime_type="image/png") for png in (image_png, keep_png)]
        return _drawn(self._generate(self._settings.image_model, contents, ["TEXT", "IMAGE"], timeout_s))

    def close(self) -> None:
        """Close the connection."""
        self._client.close()
        self._line.close()

    def _generate(self, model: str, contents: list[Any], modalities: list[str], timeout_s: float) -> Reply:
        config = types.GenerateContentConfig(
            response_modalities=modalities,
            image_config=types.ImageConfig(aspect_ratio="1:1") if "IMAGE" in modalities else None,
            http_options=types.HttpOptions(timeout=max(1, int(timeout_s * 1e3))),  # milliseconds
            should_return_http_response=True,
        )
        generate = self._client.models.generate_content
        return self._line.exchange(timeout_s, lambda: generate(model=model, contents=contents, config=config))


def _said(reply: Reply) -> Answer:
    body = parsed(reply)
    text, _ = _parts(body)
    if not text.strip():
        _require_candidate(reply, body)
        raise refused(reply, _why(body), _usage(body))
    return Answer(text=text, usage=_usage(body))


def _drawn(reply: Reply) -> Answer:
    body = parsed(reply)
    usage = _usage(body)
    text, drawn = _parts(body)
    if drawn:
        return Answer(text=text, image_png=picture(drawn[-1], usage), usage=usage)
    if text.strip():
        raise ModelError(Code.MODEL_NO_IMAGE, f"It drew nothing, but said: {quoted(text, 1000)}", usage=usage)
    _require_candidate(reply, body)
    raise refused(reply, _why(body), usage)


def _parts(body: dict[str, Any]) -> tuple[str, list[str]]:
    """The text of the first candidate, without its thoughts, and its pictures (base64)."""
    parts = entries(member(body, "candidates", 0, "content", "parts"))
    text = "".join(words(member(part, "text")) for part in parts if not member(part, "thought"))
    drawn = [raw(member(part, "inlineData", "data")) for part in parts]
    return text, [one for one in drawn if one]


def _require_candidate(reply: Reply, body: dict[str, Any]) -> None:
    """Raises: ModelError for a reply with neither content nor a reason."""
    if not _why(body) and not isinstance(member(body, "candidates", 0, "content"), dict):
        raise unreadable(reply, "holds nothing", _usage(body))


def _why(body: dict[str, Any]) -> str:
    """The reason that the reply gives for having no content."""
    return words(member(body, "promptFeedback", "blockReason")) or words(member(body, "candidates", 0, "finishReason"))


def _usage(body: dict[str, Any]) -> Usage:
    used = body.get("usageMetadata")
    asked, answered, thoughts = (member(used, f"{name}TokenCount") for name in ("prompt", "candidates", "thoughts"))
    counted = usage_of(asked, answered if answered is not None else 0, thoughts)
    # Thoughts are billed as output, but not counted among the candidates' tokens.
    return counted.model_copy(update={"output_tokens": counted.output_tokens + counted.reasoning_tokens})
