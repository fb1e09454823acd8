"""Google's Gemini API: one method for text and images, without a mask."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Mapping
from typing import Any

from .asked import BadRequest, Fault, Reply, Request, decode, from_base64, image_tokens, text_tokens, to_base64

PATH = re.compile(r"/v1(?:beta)?/models/(?P<model>[^/:]+):generateContent")
THOUGHTS_TOKENS, PICTURE_TOKENS = 48, 1290
_RPC = "type.googleapis.com/google.rpc."
_BAD_KEY = "API key not valid. Please pass a valid API key."
_STATUS = {400: "INVALID_ARGUMENT", 404: "NOT_FOUND", 429: "RESOURCE_EXHAUSTED", 500: "INTERNAL"}


def read(path: str, headers: Mapping[str, str], body: bytes) -> Request:
    """Raises: BadRequest."""
    named = PATH.fullmatch(path)
    asked = json.loads(body)
    contents = [asked.get("systemInstruction") or {}, *asked.get("contents", ())]
    parts = [part for content in contents for part in content.get("parts", ())]
    files = [data for part in parts if (data := part.get("inlineData") or part.get("inline_data"))]
    images = [decode(from_base64(file["data"])) for file in files]
    wants = (asked.get("generationConfig") or {}).get("responseModalities", ())
    kind = "image" if "IMAGE" in [str(each).upper() for each in wants] else "text"
    if kind == "image" and not images:
        raise BadRequest("The stand-in only edits pictures; there is none in the request.")
    prompt = "\n".join(part["text"] for part in parts if part.get("text"))
    model = named["model"] if named else ""
    first = next(iter(images), None)
    return Request(path, "image" if kind == "image" else "text", model, prompt, first, tuple(images[1:]))


def said(request: Request, text: str) -> Reply:
    """Words."""
    return _answer(request, {"parts": [{"text": text}], "role": "model"}, "STOP", text_tokens(text))


def drawn(request: Request, text: str, png: bytes | None) -> Reply:
    """Words and a picture; ``None`` = none, where one was asked for."""
    parts: list[dict[str, Any]] = [{"text": text}]
    if png is not None:
        parts.append({"inlineData": {"mimeType": "image/png", "data": to_base64(png)}})
    tokens = text_tokens(text) + PICTURE_TOKENS * (png is not None)
    return _answer(request, {"parts": parts, "role": "model"}, "STOP", tokens)


def empty(request: Request) -> Reply:
    """An answer with nothing in it: the content has no parts."""
    return _answer(request, {"role": "model"}, "STOP" if request.kind == "text" else "NO_IMAGE", 0)


def refused(request: Request) -> Reply:
    """The safety system's no: to the picture it drew, or to the prompt."""
    if request.kind == "image":
        return _answer(request, None, "IMAGE_SAFETY", 0)
    feedback = {"blockReason": "PROHIBITED_CONTENT"}
    return Reply(200, {"promptFeedback": feedback, "usageMetadata": _usage(request, 0), **_named(request)})


def failed(fault: Fault, retry_after_s: int) -> Reply:
    """Return what the API answers in place of the model; the time to wait is in the body."""
    match fault:
        case Fault.RATE_LIMIT:
            violation = {"quotaId": "GenerateRequestsPerMinutePerProjectPerModel", "quotaValue": "3"}
            quota = {"@type": _RPC + "QuotaFailure", "violations": [violation]}
            retry = {"@type": _RPC + "RetryInfo", "retryDelay": f"{retry_after_s}s"}
            text = f"You exceeded your current quota. Please retry in {retry_after_s}s."
            return _error(429, text, [quota, retry], {"Retry-After": str(retry_after_s)})
        case Fault.UNAUTHORIZED:
            where = {"domain": "googleapis.com", "metadata": {"service": "generativelanguage.googleapis.com"}}
            return _error(400, _BAD_KEY, [{"@type": _RPC + "ErrorInfo", "reason": "API_KEY_INVALID", **where}])
        case _:
            return _error(500, "An internal error has occurred. Please retry.")


def rejected(status: int, text: str) -> Reply:
    """The request is not taken (4xx), or the stand-in itself broke (500)."""
    return _error(status, text)


def _answer(request: Request, content: dict[str, Any] | None, finish: str, tokens: int) -> Reply:
    candidate: dict[str, Any] = {"finishReason": finish, "index": 0}
    if content is not None:
        candidate["content"] = content
    return Reply(200, {"candidates": [candidate], "usageMetadata": _usage(request, tokens), **_named(request)})


def _usage(request: Request, tokens: int) -> dict[str, int]:
    asked = text_tokens(request.prompt) + image_tokens(request)
    counts = {"promptTokenCount": asked, "totalTokenCount": asked + tokens + THOUGHTS_TOKENS}
    if tokens:
        counts["candidatesTokenCount"] = tokens
    return {**counts, "thoughtsTokenCount": THOUGHTS_TOKENS}


def _named(request: Request) -> dict[str, str]:
    return {"modelVersion": request.model, "responseId": uuid.uuid4().hex}


def _error(
    status: int, text: str, details: list[dict[str, Any]] | None = None, headers: Mapping[str, str] | None = None
) -> Reply:
    error: dict[str, Any] = {"code": status, "message": text, "status": _STATUS[status]}
    if details:
        error["details"] = details
    return Reply(status, {"error": error}, headers or {})
