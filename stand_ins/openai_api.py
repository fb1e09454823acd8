"""OpenAI's API: Responses and chat for text, image edits for images."""

from __future__ import annotations

import json
import re
import time
import uuid
from collections.abc import Mapping
from email.message import Message
from email.parser import BytesHeaderParser
from typing import Any

from .asked import (
    BadRequest,
    Fault,
    Reply,
    Request,
    decode,
    decode_mask,
    from_base64,
    image_tokens,
    text_tokens,
    to_base64,
)

RESPONSES, EDITS, CHAT = "/v1/responses", "/v1/images/edits", "/v1/chat/completions"
PATHS = (RESPONSES, EDITS, CHAT)
REASONING_TOKENS = 64
_REFUSED = "I'm sorry, but I can't assist with that request."
_BLOCKED = (
    "Your request was rejected by the safety system. If you believe this is an error, contact us at help.openai.com."
)


def read(path: str, headers: Mapping[str, str], body: bytes) -> Request:
    """Raises: BadRequest."""
    if path == EDITS:
        return _read_edit(path, headers.get("Content-Type", ""), body)
    asked = json.loads(body)
    told = asked.get("input" if path == RESPONSES else "messages") or ()
    messages = [{"content": told}] if isinstance(told, str) else told
    parts = [part for message in messages for part in _parts(message.get("content"))]
    words = [asked.get("instructions") or "", *(part.get("text", "") for part in parts)]
    images = [decode(_of_data_url(part["image_url"])) for part in parts if "image_url" in part]
    prompt = "\n".join(filter(None, words))
    return Request(path, "text", asked.get("model", ""), prompt, next(iter(images), None), tuple(images[1:]))


def said(request: Request, text: str) -> Reply:
    """Words."""
    return _message(request, {"type": "output_text", "text": text, "annotations": [], "logprobs": []}, text)


def drawn(request: Request, text: str, png: bytes | None) -> Reply:
    """A picture; ``None`` = none, where one was asked for. The API has no place for words beside it."""
    data = [] if png is None else [{"b64_json": to_base64(png)}]
    words, shown, made = text_tokens(request.prompt), image_tokens(request), 1056 * len(data)
    usage = {
        "input_tokens": words + shown,
        "input_tokens_details": {"text_tokens": words, "image_tokens": shown},
        "output_tokens": made,
        "output_tokens_details": {"text_tokens": 0, "image_tokens": made},
        "total_tokens": words + shown + made,
    }
    return Reply(200, {"created": int(time.time()), "output_format": "png", "data": data, "usage": usage})


def empty(request: Request) -> Reply:
    """An answer with nothing in it."""
    if request.kind == "text":
        return said(request, "")
    reply = drawn(request, "", b"")
    return Reply(200, {**reply.body, "data": [{"b64_json": ""}]})


def refused(request: Request) -> Reply:
    """The model's or the safety system's no."""
    if request.kind == "image":
        return _error(400, _BLOCKED, "image_generation_user_error", "moderation_blocked")
    return _message(request, {"type": "refusal", "refusal": _REFUSED}, _REFUSED)


def failed(fault: Fault, retry_after_s: int) -> Reply:
    """Return what the API answers in place of the model."""
    match fault:
        case Fault.RATE_LIMIT:
            text = f"Rate limit reached on requests per min (RPM): Limit 3. Please try again in {retry_after_s}s."
            return _error(429, text, "requests", "rate_limit_exceeded", {"Retry-After": str(retry_after_s)})
        case Fault.UNAUTHORIZED:
            text = "Incorrect API key provided: x. You can find your API key at https://platform.openai.com/account/api-keys."
            return _error(401, text, "invalid_request_error", "invalid_api_key")
        case _:
            text = "The server had an error while processing your request. Sorry about that!"
            return _error(500, text, "server_error", None)


def rejected(status: int, text: str) -> Reply:
    """The request is not taken (4xx), or the stand-in itself broke (500)."""
    return _error(status, text, "invalid_request_error" if status < 500 else "server_error", None)


def _error(status: int, text: str, kind: str, code: str | None, headers: Mapping[str, str] | None = None) -> Reply:
    return Reply(status, {"error": {"message": text, "type": kind, "param": None, "code": code}}, headers or {})


def _message(request: Request, part: dict[str, Any], text: str) -> Reply:
    return _chat(request, part, text) if request.path == CHAT else _response(request, part, text)


def _response(request: Request, part: dict[str, Any], text: str) -> Reply:
    asked, answered = text_tokens(request.prompt) + image_tokens(request), text_tokens(text) + REASONING_TOKENS
    message = {"type": "message", "id": _id("msg"), "status": "completed", "role": "assistant", "content": [part]}
    body = {
        "id": _id("resp"),
        "object": "response",
        "created_at": int(time.time()),
        "status": "completed",
        "error": None,
        "incomplete_details": None,
        "instructions": None,
        "metadata": {},
        "model": request.model,
        "output": [{"type": "reasoning", "id": _id("rs"), "summary": []}, message],
        "parallel_tool_calls": True,
        "tool_choice": "auto",
        "tools": [],
        "usage": {
            "input_tokens": asked,
            "input_tokens_details": {"cached_tokens": 0, "cache_write_tokens": 0},
            "output_tokens": answered,
            "output_tokens_details": {"reasoning_tokens": REASONING_TOKENS},
            "total_tokens": asked + answered,
        },
    }
    return Reply(200, body)


def _chat(request: Request, part: dict[str, Any], text: str) -> Reply:
    asked, answered = text_tokens(request.prompt) + image_tokens(request), text_tokens(text)
    message = {"role": "assistant", "content": part.get("text"), "refusal": part.get("refusal")}
    body = {
        "id": _id("chatcmpl"),
        "object": "chat.completion",
        "created": int(time.time()),
        "model": request.model,
        "choices": [{"index": 0, "message": message, "logprobs": None, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": asked, "completion_tokens": answered, "total_tokens": asked + answered},
    }
    return Reply(200, body)


def _parts(content: str | list[dict[str, Any]] | None) -> list[dict[str, Any]]:
    return [{"text": content}] if isinstance(content, str) else content or []


def _of_data_url(url: str | dict[str, str]) -> bytes:
    text = url["url"] if isinstance(url, dict) else url
    if not text.startswith("data:"):
        raise BadRequest("Only data URLs are taken.")
    return from_base64(text.partition(",")[2])


def _read_edit(path: str, content_type: str, body: bytes) -> Request:
    fields = _multipart(content_type, body)
    images = [decode(data) for name in ("image", "image[]") for data in fields.get(name, ())]
    if not images:
        raise BadRequest("Missing required parameter: 'image'.")
    masks = [decode_mask(data) for name in ("mask", "mask_image") for data in fields.get(name, ())]
    if masks and masks[0].shape != images[0].shape[:2]:
        raise BadRequest("Invalid mask image format - mask size does not match image size.")
    words = {name: data[0].decode() for name, data in fields.items() if name in ("prompt", "model", "size")}
    size = re.fullmatch(r"(\d+)x(\d+)", words.get("size", "auto"))
    return Request(
        path=path,
        kind="image",
        model=words.get("model", ""),
        prompt=words.get("prompt", ""),
        image=images[0],
        others=tuple(images[1:]),
        mask=masks[0] if masks else None,
        size=(int(size[1]), int(size[2])) if size else None,
    )


def _multipart(content_type: str, body: bytes) -> dict[str, list[bytes]]:
    """The parts of a form, by name."""
    head = Message()
    head["Content-Type"] = content_type
    boundary = head.get_boundary()
    if boundary is None:
        raise BadRequest("Invalid Content-Type: expected multipart/form-data.")
    fields: dict[str, list[bytes]] = {}
    for part in body.split(b"--" + boundary.encode())[1:-1]:
        described, _, data = part.removeprefix(b"\r\n").partition(b"\r\n\r\n")
        name = BytesHeaderParser().parsebytes(described).get_param("name", header="content-disposition")
        fields.setdefault(str(name), []).append(data.removesuffix(b"\r\n"))
    return fields


def _id(prefix: str) -> str:
    return f"{prefix}_{uuid.uuid4().hex}"
