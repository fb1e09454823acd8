"""Hosted models: the official clients against a loopback server, what they draw, what they cost, and how they fail."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np
import pytest

from benchmarks.baselines.flat import flat_object
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import ConfigError, CycleFailure, RecordingError
from bus.messages import ModelReply
from config.load import load_station
from config.perception import HostedSettings
from config.schema import Station
from perception.geometry.window import Window, decode_picture, encode_png
from perception.goal.imagine import Conversation
from perception.models import open_models, replayed_models
from perception.models.budget import Budget
from perception.observed_object import ObservedObject
from perception.proposal import Proposal, propose
from stand_ins.drift import NONE, Drift
from stand_ins.model_server import Fault, ModelServer
from stand_ins.painter import paint, say

PROVIDERS = ("openai", "gemini")
KEYS = {"OPENAI_API_KEY": "x", "GEMINI_API_KEY": "x"}
Serve = Callable[..., ModelServer]


@pytest.fixture(scope="module")
def observed_object() -> ObservedObject:
    """A two-coloured bar, 40 x 130 mm at 1 mm a pixel, turned by 30 degrees."""
    color = np.full((360, 480, 3), 170, np.uint8)
    corners = cv2.boxPoints(((240, 180), (130, 40), 30)).astype(int)
    cv2.fillPoly(color, [corners], (40, 90, 200))
    mask = np.zeros((360, 480), np.uint8)
    cv2.fillPoly(mask, [corners], 1)
    cv2.circle(color, (275, 200), 12, (230, 220, 60), -1)
    return flat_object(color, mask > 0, 0.001, load_station())


@pytest.fixture
def serve(request: pytest.FixtureRequest) -> Serve:
    """A running model server, closed after the test."""

    def start(drift: Drift = NONE, **how: Any) -> ModelServer:
        server = ModelServer(paint, say=say, drift=drift, **how)
        server.__enter__()
        request.addfinalizer(lambda: server.__exit__(None, None, None))
        return server

    return start


def _station(server: ModelServer, provider: str, folder: Path, *overrides: str) -> Station:
    base = server.url + ("/v1" if provider == "openai" else "")
    return load_station(
        None,
        [
            f"perception.model={provider}",
            f"perception.hosted.base_url={base}",
            "perception.hosted.text_model=words-1",
            "perception.hosted.image_model=pictures-1",
            "perception.hosted.backoff_s=0",
            "perception.hosted.price.usd_per_million_input_tokens=5",
            "perception.hosted.price.usd_per_image=0.04",
            f"recording.folder={folder}",
            *overrides,
        ],
    )


def _propose(station: Station, observed_object: ObservedObject, replies: list[ModelReply]) -> Proposal:
    with closing(open_models(station, KEYS)) as models:
        models.imaginer.begin()
        return propose(Conversation(models.imaginer, replies.append), observed_object, models, station)


def _fails(station: Station, observed_object: ObservedObject) -> tuple[Code, list[ModelReply]]:
    replies: list[ModelReply] = []
    with pytest.raises(CycleFailure) as failure:
        _propose(station, observed_object, replies)
    return failure.value.failure, replies


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_hosted_model_reasons_directs_and_renders(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server, replies = serve(), list[ModelReply]()
    station = _station(server, provider, tmp_path)
    best = _propose(station, observed_object, replies).rectangles[0]
    assert np.degrees(best.angle_rad) == pytest.approx(120, abs=4), "across the bar"
    assert best.width_px == pytest.approx(40, abs=4) and np.allclose(best.center_px, (240, 180), atol=12)
    assert [reply.step for reply in replies] == ["reason", "direct", "render"]
    assert [asked.kind for asked in server.requests] == ["text", "text", "image"]
    assert all(reply.usage.input_tokens > 0 and reply.usage.cost_usd > 0 for reply in replies)
    assert replies[-1].usage.cost_usd > 0.04 and replies[-1].image_png is not None
    assert "magenta" in replies[-1].prompt and replies[0].text in replies[1].prompt


@pytest.mark.parametrize("provider", PROVIDERS)
def test_one_step_asks_for_the_picture_at_once(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server, replies = serve(), list[ModelReply]()
    _propose(_station(server, provider, tmp_path, "perception.imagine.steps=1"), observed_object, replies)
    assert [reply.step for reply in replies] == ["render"]


def test_servers_that_only_chat_are_asked_by_chat(
    serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server = serve()
    _propose(_station(server, "openai", tmp_path, "perception.hosted.text_api=chat"), observed_object, [])
    assert server.requests[0].path.endswith("/chat/completions")


def test_openai_protects_the_object_by_a_mask_and_gemini_by_a_map(
    serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server = serve()
    for provider in PROVIDERS:
        _propose(_station(server, provider, tmp_path), observed_object, [])
    openai_edit, gemini_edit = (asked for asked in server.requests if asked.kind == "image")
    assert openai_edit.mask is not None and not openai_edit.mask[512, 512] and openai_edit.mask[5, 5]
    assert gemini_edit.mask is None and gemini_edit.others[0][512, 512].min() == 255
    assert "second image" in gemini_edit.prompt


@pytest.mark.parametrize("provider", ["openai", pytest.param("gemini", marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "drift",
    [Drift(rotation_deg=75), Drift(scale=0.8), Drift(shift_px=(60, -40)), Drift(rotation_deg=-40, tilt_deg=15)],
    ids=["turned", "shrunk", "shifted", "tilted"],
)
def test_a_moved_object_is_carried_back(
    provider: str, drift: Drift, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    best = _propose(_station(serve(drift), provider, tmp_path), observed_object, []).rectangles[0]
    assert np.degrees(best.angle_rad) == pytest.approx(120, abs=8)
    assert np.allclose(best.center_px, (240, 180), atol=15)


@pytest.mark.parametrize(
    ("drift", "code"),
    [
        (Drift(rod="none"), Code.MODEL_NO_ROD),
        (Drift(rod="two"), Code.MODEL_NO_ROD),
        (Drift(second_object=True), Code.MODEL_DRIFT),
        (Drift(recolor=0.9), Code.MODEL_DRIFT),
    ],
    ids=["no rod", "two rods", "second object", "recoloured"],
)
def test_another_picture_is_refused(
    drift: Drift, code: Code, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    assert _fails(_station(serve(drift), "openai", tmp_path), observed_object)[0] is code


@pytest.mark.parametrize("provider", PROVIDERS)
@pytest.mark.parametrize(
    ("fault", "code", "attempts"),
    [
        (Fault.RATE_LIMIT, Code.MODEL_QUOTA, 3),
        (Fault.SERVER_ERROR, Code.MODEL_UNAVAILABLE, 3),
        (Fault.UNAUTHORIZED, Code.MODEL_ACCESS, 1),
        (Fault.TRUNCATED_PNG, Code.MODEL_BAD_IMAGE, 1),
        (Fault.WRONG_SIZE, Code.MODEL_BAD_IMAGE, 1),
        (Fault.REFUSAL, Code.MODEL_REFUSED, 1),
        (Fault.TEXT_ONLY, Code.MODEL_NO_IMAGE, 1),
    ],
)
def test_every_fault_has_its_code_and_a_bounded_number_of_attempts(
    provider: str,
    fault: Fault,
    code: Code,
    attempts: int,
    serve: Serve,
    observed_object: ObservedObject,
    tmp_path: Path,
) -> None:
    server = serve(faults=[fault] * 5, faults_for="image", retry_after_s=0)
    found, replies = _fails(_station(server, provider, tmp_path), observed_object)
    assert found is code
    assert sum(asked.kind == "image" for asked in server.requests) == attempts
    said = replies[-1]
    assert said.failure is code or (code is Code.MODEL_BAD_IMAGE and said.image_png), "the reply or its failure is kept"


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_refusal_in_words_is_one_too(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server = serve(faults=[Fault.REFUSAL], faults_for="text")
    assert _fails(_station(server, provider, tmp_path), observed_object)[0] is Code.MODEL_REFUSED


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_model_that_hangs_is_given_up_at_the_deadline(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server = serve(faults=[Fault.HANG] * 3)
    assert _fails(_station(server, provider, tmp_path, "perception.hosted.deadline_s=0.6"), observed_object)[0] in (
        Code.MODEL_TIMEOUT,
    )


def test_a_server_that_is_not_there_is_unavailable(
    serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server = serve()
    for provider in PROVIDERS:
        gone = _station(server, provider, tmp_path, "perception.hosted.base_url=http://127.0.0.1:9/v1")
        assert _fails(gone, observed_object)[0] is Code.MODEL_UNAVAILABLE


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_passing_fault_is_asked_again(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server, replies = serve(faults=[Fault.SERVER_ERROR, Fault.RATE_LIMIT], retry_after_s=0), list[ModelReply]()
    _propose(_station(server, provider, tmp_path), observed_object, replies)
    assert [reply.attempts for reply in replies] == [3, 1, 1]


@pytest.mark.parametrize("provider", PROVIDERS)
def test_recorded_replies_give_the_same_proposal_without_the_network(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    replies: list[ModelReply] = []
    station = _station(serve(Drift(rotation_deg=20)), provider, tmp_path)
    then = _propose(station, observed_object, replies)
    through_json = [ModelReply.model_validate_json(reply.model_dump_json()) for reply in replies]
    models = replayed_models(station, through_json)
    models.imaginer.begin()
    now = propose(Conversation(models.imaginer, lambda _: None), observed_object, models, station)
    assert now.rectangles == then.rectangles
    np.testing.assert_array_equal(now.goal.image, then.goal.image)
    with pytest.raises(RecordingError, match="no further reply"):
        propose(Conversation(models.imaginer, lambda _: None), observed_object, models, station)


def test_a_recorded_failure_fails_again(serve: Serve, observed_object: ObservedObject, tmp_path: Path) -> None:
    station = _station(serve(faults=[Fault.REFUSAL], faults_for="image"), "openai", tmp_path)
    _, replies = _fails(station, observed_object)
    models = replayed_models(station, replies)
    models.imaginer.begin()
    with pytest.raises(CycleFailure) as failure:
        propose(Conversation(models.imaginer, lambda _: None), observed_object, models, station)
    assert failure.value.failure is Code.MODEL_REFUSED and failure.value.text == replies[-1].text_of_failure


def test_nothing_is_asked_once_the_cycle_has_spent_its_limit(
    serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    server = serve()
    code, replies = _fails(
        _station(server, "openai", tmp_path, "perception.hosted.max_cycle_usd=1e-6"), observed_object
    )
    assert code is Code.SPEND_LIMIT and len(server.requests) == 1 and replies[-1].failure is Code.SPEND_LIMIT


def test_the_days_spending_outlives_the_process_and_ends_at_midnight_utc(tmp_path: Path) -> None:
    now = datetime(2026, 11, 23, 23, 59, tzinfo=UTC)
    settings, ledger = HostedSettings(max_cycle_usd=9.0, max_day_usd=0.5), tmp_path / "spend.jsonl"
    Budget(settings, ledger, lambda: now).pay("m", 0.6)
    with pytest.raises(CycleFailure, match="today"):
        Budget(settings, ledger, lambda: now).require()
    Budget(settings, ledger, lambda: now + timedelta(minutes=2)).require()


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_missing_key_says_which_variable(provider: str, serve: Serve, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"{provider.upper()}_API_KEY"):
        open_models(_station(serve(), provider, tmp_path), {})


def test_a_missing_model_id_says_which(serve: Serve, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="image_model"):
        open_models(_station(serve(), "openai", tmp_path, 'perception.hosted.image_model=""'), KEYS)


@pytest.mark.parametrize("provider", PROVIDERS)
@pytest.mark.parametrize(
    "key", ["“sk-0123456789”", "sk-01234\n56789", "sk-01234 56789", "'sk-0123456789'", "sk-\0123456789"]
)
def test_a_key_that_no_header_can_carry_is_refused_unseen(
    provider: str, key: str, serve: Serve, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=f"{provider.upper()}_API_KEY") as refusal:
        open_models(_station(serve(), provider, tmp_path), {f"{provider.upper()}_API_KEY": key})
    assert "56789" not in str(refusal.value)


@pytest.mark.parametrize("provider", PROVIDERS)
def test_a_key_with_a_line_end_is_a_key(
    provider: str, serve: Serve, observed_object: ObservedObject, tmp_path: Path
) -> None:
    station = _station(serve(), provider, tmp_path)
    with closing(open_models(station, {f"{provider.upper()}_API_KEY": " sk-0123456789\r\n"})) as models:
        models.imaginer.begin()
        assert models.imaginer.reason(observed_object, "", Cancel()).text


def test_a_key_in_a_setting_would_be_recorded(serve: Serve, tmp_path: Path) -> None:
    key = "sk-with/slashes+0123"
    for setting in (f"base_url=http://models.example/{quote(key, safe='')}/v1", f"text_model={key}"):
        station = _station(serve(), "openai", tmp_path, f"perception.hosted.{setting}")
        with pytest.raises(ConfigError, match="every recording holds") as refusal:
            open_models(station, {"OPENAI_API_KEY": key})
        assert "0123" not in str(refusal.value)


@pytest.mark.parametrize(
    "setting",
    [
        "base_url=http://models.example/v1?key=sk-0123456789",
        "base_url=http://anna:sk-0123456789@models.example/v1",
        "base_url=http://:sk-0123456789@models.example/v1",
        "key_variable=sk-0123456789",
    ],
)
def test_a_key_where_none_belongs_is_refused_unseen(setting: str, serve: Serve, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refusal:
        _station(serve(), "openai", tmp_path, f"perception.hosted.{setting}")
    assert "0123" not in str(refusal.value)


@pytest.mark.parametrize(
    "url", ["models.example/v1", "ftp://models.example", "http://", "http://h:99999", "http://[", "http://a b"]
)
def test_a_base_url_is_an_address_of_a_web_server(url: str, serve: Serve, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="base_url"):
        _station(serve(), "openai", tmp_path, f"perception.hosted.base_url={url}")


@pytest.mark.parametrize("provider", PROVIDERS)
def test_no_package_looks_for_proxies_by_itself(
    provider: str, serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ALL_PROXY", "socks5://127.0.0.1:1080")
    with closing(open_models(_station(serve(), provider, tmp_path), KEYS)) as models:
        assert models.imaginer.name == "words-1+pictures-1"


def test_a_package_that_does_not_start_here_says_why(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "none.pem"))
    with pytest.raises(ConfigError, match="SSL_CERT_FILE"):
        open_models(_station(serve(), "gemini", tmp_path), KEYS)


def test_a_proxy_that_cannot_be_used_is_told_at_the_start(serve: Serve, tmp_path: Path) -> None:
    station = _station(serve(), "openai", tmp_path, "perception.hosted.base_url=https://models.example/v1")
    with pytest.raises(ConfigError, match="SOCKS"):
        open_models(station, KEYS | {"ALL_PROXY": "socks5://127.0.0.1:1080"})


# --- the window ------------------------------------------------------------------------------------------------------


def test_a_picture_goes_through_the_window_and_back() -> None:
    mask = np.zeros((200, 300), bool)
    mask[150:195, 10:60] = True
    image = np.random.default_rng(0).integers(0, 255, (200, 300, 3), dtype=np.uint8)
    window = Window.around(mask)
    part = window.cut(image, 7)
    assert part.shape == (window.side_px, window.side_px, 3) and (part[-1] == 7).all(), "beyond the image"
    np.testing.assert_array_equal(window.paste(part, np.zeros_like(image))[mask], image[mask])


@pytest.mark.parametrize("data", [b"", b"no picture", encode_png(np.zeros((200, 200, 3), np.uint8), 256)[:-40]])
def test_what_is_no_whole_picture_is_refused(data: bytes) -> None:
    with pytest.raises(CycleFailure) as failure:
        decode_picture(data, Window(0, 0, 128))
    assert failure.value.failure is Code.MODEL_BAD_IMAGE
