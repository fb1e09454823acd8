"""Google's Gemini API. It takes no mask: what must stay is drawn into the request, and looked at in what comes back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx2
from google import genai
from google.genai import errors, types

from bus.codes import Code
from bus.messages import Usage
from config.schema import HostedSettings
from perception.models.base import Answer
from perception.models.hosted import ModelFault

KEY_VARIABLE = "GEMINI_API_KEY"
_KEEP = (
    "\n\nThe second image is a map of the first: what is white there is the object, which must stay exactly as it is; "
    "draw only where the map is black. Answer with one square picture of the first image's framing."
)
_BAD_KEY = "API_KEY_INVALID"


class GeminiProvider:
    """The official ``google-genai`` package; its own retries are off, the cell's deadline holds."""

    def __init__(self, settings: HostedSettings, key: str) -> None:
        self.name = f"{settings.text_model}+{settings.image_model}"
        self._settings = settings
        options = types.HttpOptions(base_url=settings.base_url, retry_options=types.HttpRetryOptions(attempts=1))
        self._client = genai.Client(api_key=key, http_options=options)

    def say(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        contents: list[Any] = [types.Part.from_text(text=prompt)]
        if image_png is not None:
            contents.append(types.Part.from_bytes(data=image_png, mime_type="image/png"))
        reply = self._generate(self._settings.text_model, contents, ["TEXT"], timeout_s)
        text = "".join(part.text or "" for part in _parts(reply) if not part.thought)
        if not text.strip():
            raise ModelFault(Code.MODEL_REFUSED, f"It refused: {_why(reply)}")
        return Answer(text=text, usage=_usage(reply))

    def close(self) -> None:
        self._client.close()

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        contents: list[Any] = [types.Part.from_text(text=prompt + _KEEP)]
        contents += [types.Part.from_bytes(data=png, mime_type="image/png") for png in (image_png, keep_png)]
        reply = self._generate(self._settings.image_model, contents, ["TEXT", "IMAGE"], timeout_s)
        parts = _parts(reply)
        drawn = [part.inline_data.data for part in parts if part.inline_data is not None and part.inline_data.data]
        said = "".join(part.text or "" for part in parts if not part.thought)
        if not drawn:
            code = Code.MODEL_NO_IMAGE if said else Code.MODEL_REFUSED
            raise ModelFault(code, f"It drew nothing, but said: {said}" if said else f"It refused: {_why(reply)}")
        return Answer(text=said, image_png=drawn[-1], usage=_usage(reply))

    def _generate(
        self, model: str, contents: list[Any], modalities: list[str], timeout_s: float
    ) -> types.GenerateContentResponse:
        options = types.HttpOptions(timeout=max(1, int(timeout_s * 1e3)))  # milliseconds
        image = types.ImageConfig(aspect_ratio="1:1") if "IMAGE" in modalities else None
        config = types.GenerateContentConfig(response_modalities=modalities, image_config=image, http_options=options)
        with _faults():
            return self._client.models.generate_content(model=model, contents=contents, config=config)


def _parts(reply: types.GenerateContentResponse) -> list[types.Part]:
    content = reply.candidates[0].content if reply.candidates else None
    return list(content.parts or ()) if content is not None else []


def _why(reply: types.GenerateContentResponse) -> str:
    """The reason it gives for giving nothing."""
    blocked = reply.prompt_feedback.block_reason if reply.prompt_feedback is not None else None
    finished = reply.candidates[0].finish_reason if reply.candidates else None
    reason = blocked or finished
    return reason.value if reason is not None else "it said nothing"


def _usage(reply: types.GenerateContentResponse) -> Usage:
    used = reply.usage_metadata
    if used is None:
        return Usage()
    thoughts = used.thoughts_token_count or 0
    # Thoughts are billed as output, but not counted among the candidates' tokens.
    return Usage(
        input_tokens=used.prompt_token_count or 0,
        output_tokens=(used.candidates_token_count or 0) + thoughts,
        reasoning_tokens=thoughts,
    )


@contextmanager
def _faults() -> Iterator[None]:
    """The package's errors, and its transport's, as ours."""
    try:
        yield
    except errors.APIError as error:
        raise _fault_of_status(error) from error
    except httpx2.TimeoutException as error:
        raise ModelFault(Code.MODEL_TIMEOUT, "It did not answer in time.", again=True) from error
    except httpx2.TransportError as error:
        raise ModelFault(Code.MODEL_UNAVAILABLE, f"It cannot be reached ({error}).", again=True) from error
    except (errors.UnknownApiResponseError, ValueError) as error:
        raise ModelFault(Code.MODEL_UNAVAILABLE, f"The answer could not be read ({error}).") from error


def _fault_of_status(error: errors.APIError) -> ModelFault:
    what = f"{error.message} (HTTP {error.code})"
    if error.code == 429:
        return ModelFault(Code.MODEL_QUOTA, what, again=True, after_s=_retry_delay_s(error))
    if error.code in (401, 403, 404) or _BAD_KEY in str(error.details):
        return ModelFault(Code.MODEL_ACCESS, what)
    if error.code >= 500:
        return ModelFault(Code.MODEL_UNAVAILABLE, what, again=True)
    return ModelFault(Code.MODEL_REFUSED, f"It did not take the request: {what}")


def _retry_delay_s(error: errors.APIError) -> float:
    """The delay a rate limit's details ask for ("17s"), or 0."""
    found = re.search(r"'retryDelay': '([\d.]+)s'", str(error.details))
    return float(found.group(1)) if found else 0.0
