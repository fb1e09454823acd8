"""The OpenAPI document of the interface, made from its table and the messages, and a plain page that lists it."""

from __future__ import annotations

import html
import re
from typing import Any

from pydantic.json_schema import models_json_schema

from bus.commands import ErrorReply
from bus.frozen import Message
from cell.http.events import SESSION
from cell.http.routes import TABLE, Served
from cell.machine.states import VERBS

_REF = "#/components/schemas/{model}"
_ALWAYS = {
    401: "No token, or one that nobody has.",
    403: "This role may not; or a foreign Host or Origin.",
}
_STATUSES = {
    **_ALWAYS,
    404: "There is none.",
    409: "The cell refuses: code, reason, advice, and the commands available now.",
    413: "The body is too large.",
    415: "The body is no application/json.",
    422: "A field does not fit; the reason names it.",
    503: "No cell answers, or there are too many streams.",
    504: "The cell is there, and does not answer in time.",
}
_FIELD = re.compile(r"{(\w+)}")


def document() -> dict[str, Any]:
    """Return the OpenAPI 3.1 document."""
    models = {model for one in TABLE for model in (one.takes, one.says) if model is not None}
    ordered: list[type[Message]] = [*sorted(models, key=lambda model: model.__name__), ErrorReply]
    _, schemas = models_json_schema([(model, "validation") for model in ordered], ref_template=_REF)
    paths: dict[str, dict[str, Any]] = {}
    for one in TABLE:
        paths.setdefault(one.path, {})[one.method.lower()] = _operation(one)
    return {
        "openapi": "3.1.0",
        "info": {"title": "VLAD Cell", "version": "1", "description": "Commands and state of one cell: docs/http.md."},
        "paths": paths,
        "components": {
            "schemas": schemas["$defs"],
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{"token": []}, {}],
    }


def _operation(one: Served) -> dict[str, Any]:
    operation: dict[str, Any] = {"summary": one.what, "parameters": _parameters(one), "responses": _responses(one)}
    if one.takes is not None:
        operation["requestBody"] = {"content": {"application/json": {"schema": _ref(one.takes)}}}
    return operation


def _parameters(one: Served) -> list[dict[str, Any]]:
    text: dict[str, Any] = {"type": "string"}
    found = [
        {
            "name": name,
            "in": "path",
            "required": True,
            "schema": {**text, "enum": list(VERBS)} if name == "verb" else text,
        }
        for name in _FIELD.findall(one.path)
    ]
    found += [{"name": name, "in": "query", "description": what, "schema": text} for name, what in one.queries]
    if one.needs_session:
        found.append({"name": SESSION, "in": "header", "description": "Of GET /api/events.", "schema": text})
    return found


def _responses(one: Served) -> dict[str, Any]:
    schema = _ref(one.says) if one.says is not None else {}
    found: dict[str, Any] = {"200": {"description": "Done.", "content": {one.media_type: {"schema": schema}}}}
    body = (413, 415) if one.method == "POST" else ()
    for status in sorted({*_ALWAYS, *one.refusals, *body}):
        content = {"application/json": {"schema": _ref(ErrorReply)}}
        found[str(status)] = {"description": _STATUSES[status], "content": content}
    return found


def _ref(model: type) -> dict[str, str]:
    return {"$ref": _REF.format(model=model.__name__)}


def page() -> str:
    """Return the page ``/api``: every path, and what it is for. It loads nothing, and runs nothing."""
    rows = "\n".join(
        f"<tr><td>{one.method}</td><td><code>{html.escape(one.path)}</code></td><td>{html.escape(one.what)}</td></tr>"
        for one in TABLE
    )
    return _PAGE.format(rows=rows, verbs=", ".join(VERBS))


_PAGE = """\
<!doctype html>
<html lang="en">
<head><meta charset="utf-8"><title>VLAD Cell: HTTP</title></head>
<body>
<h1>VLAD Cell over HTTP</h1>
<p>Commands: {verbs}. Every field of every message: <a href="/api/openapi.json">openapi.json</a>.</p>
<table>
<thead><tr><th>method</th><th>path</th><th>what</th></tr></thead>
<tbody>
{rows}
<tr><td>GET</td><td><code>/recordings/NAME.mcap</code></td><td>A recording; ranges are possible.</td></tr>
<tr><td>GET</td><td><code>/reports/NAME.html</code></td><td>The report page of a cycle or a day.</td></tr>
</tbody>
</table>
</body>
</html>
"""
