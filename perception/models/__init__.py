"""The models that fill the paper's roles - goal image, segmentation, depth - opened as a station configures them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import ConfigError
from bus.messages import ModelReply
from bus.redaction import quoted
from config.schema import Station
from perception.detectors.registry import GROUP as DETECTORS
from perception.detectors.registry import open_detector
from perception.detectors.written import replayed_detector
from perception.geometry.crop import Mask
from perception.models.api_key import key_of
from perception.models.base import GoalImageModel
from perception.models.budget import LEDGER, Budget
from perception.models.depth_pro import DepthPro
from perception.models.detector_call import DetectorCall
from perception.models.exchange import Line
from perception.models.hosted import HostedModel
from perception.models.opening import opened_in_time
from perception.models.plug_in_model import PlugInModel
from perception.models.recorded import RecordedModel, SpoiledModel
from perception.models.registry import (
    EMBEDDED,
    GROUP,
    PROVIDERS,
    is_replayed,
    open_local,
    reads_text,
    refuse_settings_of_nobody,
)
from perception.models.salient import Salient
from perception.models.sam import Sam
from perception.models.server_route import ServerRoute


@dataclass(frozen=True)
class Models:
    """The models of one cell.

    Attributes:
        imaginer: the goal-image model.
        sam, salient: at most one; without them the outline is the one that depth gives.
        depth: None = the observed depth is used instead.
        detector: another package's detector, which finds the grasps; None = ours, with the models above.
    """

    imaginer: GoalImageModel
    sam: Sam | None = None
    salient: Salient | None = None
    depth: DepthPro | None = None
    detector: DetectorCall | None = None

    def read_text(self, station: Station) -> bool:
        """Whether one of them finds a target by any words."""
        return reads_text(station.perception.model) or (self.sam is not None and self.sam.reads_text)

    def close(self) -> None:
        """Release connections and memory."""
        self.imaginer.close()
        if self.detector is not None:
            self.detector.close()

    def refined(self, outline: Mask, color: npt.NDArray[np.uint8]) -> Mask:
        """Return the outline (H, W) of an object, redrawn by SAM in its box, or by a salient-object network near it.

        Args:
            outline: (H, W) as depth gives it. ``color``: (H, W, 3) RGB.
        """
        if self.salient is not None:
            return self.salient.outlined(color, outline)
        if self.sam is None:
            return outline
        rows, columns = np.nonzero(outline)
        box_px = (float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max()))
        return self.sam.by_box(color, box_px)


def open_models(station: Station, environ: Mapping[str, str]) -> Models:
    """Open the models that ``station.perception`` names.

    Args:
        environ: environment variables, for keys and proxies.

    Raises:
        ConfigError: an unknown model or detector; a missing key, model id, package or weights; a detector's setting;
            another package's that does not come to its end (`opening.LIMIT_S`).
        RecordingError: the ledger of costs cannot be read.
    """
    refuse_settings_of_nobody(station)
    name = station.perception.detector
    found = opened_in_time(DETECTORS, name, partial(open_detector, station))
    deadline_s = station.perception.detector_deadline_s
    detector = None if found is None else DetectorCall(name, found, deadline_s, DETECTORS.package_of(name))
    return Models(_imaginer(station, environ, station.recording.folder), *_local(station), detector)


def replayed_models(station: Station, replies: Iterable[ModelReply]) -> Models:
    """Return the models of a replay: hosted ones answer from the recorded replies, recorded injected faults recur.

    A detector of another package is asked again if it is deterministic, a goal-image model if it paints, both without a
    deadline; a recorded timeout happens again.
    """
    refuse_settings_of_nobody(station)
    replies = tuple(replies)
    found, name = replayed_detector(station, replies), station.perception.detector
    detector = None if found is None else DetectorCall(name, found, None, DETECTORS.package_of(name))
    imaginer = _replayed_imaginer(station, [reply for reply in replies if reply.step != "detect"])
    return Models(imaginer, *_local(station), detector)


def _replayed_imaginer(station: Station, replies: list[ModelReply]) -> GoalImageModel:
    if is_replayed(station.perception.model, replies):
        return RecordedModel(replies)
    local = _local_imaginer(station, None)
    is_spoiled = station.faults.allowed or any(reply.failure is Code.MODEL_TIMEOUT for reply in replies)
    return SpoiledModel(local, replies) if is_spoiled else local


def _local_imaginer(station: Station, deadline_s: float | None) -> GoalImageModel:
    """Open a model that is no provider's; another package's is checked, and given so long for a call.

    Without a deadline it is opened on the caller's thread, too.
    """
    name = station.perception.model
    open_it = partial(open_local, name, station)
    model = open_it() if deadline_s is None else opened_in_time(GROUP, name, open_it)
    if name in EMBEDDED:
        return model
    return PlugInModel(model, name, GROUP.package_of(name), deadline_s)


def _local(station: Station) -> tuple[Sam | None, Salient | None, DepthPro | None]:
    settings, pro = station.perception, station.perception.depth_pro
    sam = Sam(settings.sam.weights, settings.sam.device) if settings.segmenter == "sam" else None
    salient = Salient(settings.salient.path) if settings.segmenter == "salient" else None
    return sam, salient, DepthPro(pro.weights, pro.device) if settings.goal_depth == "depth_pro" else None


def _imaginer(station: Station, environ: Mapping[str, str], folder: Path) -> GoalImageModel:
    name, settings = station.perception.model, station.perception.hosted
    if name not in PROVIDERS:
        return _local_imaginer(station, settings.deadline_s)
    for role in ("text_model", "image_model"):
        if not getattr(settings, role):
            raise ConfigError(
                f"perception.hosted.{role} is not set.", f"Name one of the provider's models; see config/{name}.toml."
            )
    module: Any = import_module(PROVIDERS[name].module)
    key = key_of(station, module.KEY_VARIABLE, environ)
    line = Line(ServerRoute(settings.base_url or module.SERVER, environ).transport)
    try:
        provider = getattr(module, PROVIDERS[name].name)(settings, key, line)
    except (OSError, ValueError, ImportError) as error:
        what = f"The client package of {name!r} does not start here ({quoted(str(error))})."
        raise ConfigError(what, "Check the environment's proxies and certificates, e.g. SSL_CERT_FILE.") from None
    return HostedModel(provider, settings, Budget(settings, folder / LEDGER))
