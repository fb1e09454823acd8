"""Name -> the goal-image model that imagines the rod.

Ours are named here. Another package brings one as an entry point of the group ``vlad_cell.goal_models``: a function or
class that is given the station, and its checked settings if it has any, and returns a `GoalImageModel`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from bus.errors import ConfigError
from bus.messages import ModelReply
from config.plug_ins import Group
from config.schema import Station
from perception.detectors.registry import OURS as OUR_DETECTOR
from perception.models.base import GoalImageModel
from perception.models.geometric import GeometricModel
from perception.models.network import NetworkModel


class Provider(NamedTuple):
    """The module and class of a provider, imported only when used."""

    module: str
    name: str


PROVIDERS = {
    "openai": Provider("perception.models.openai", "OpenAIProvider"),
    "gemini": Provider("perception.models.gemini", "GeminiProvider"),
}
EMBEDDED: dict[str, Callable[[Station], GoalImageModel]] = {"geometric": GeometricModel, "onnx": NetworkModel}


GROUP = Group(
    "vlad_cell.goal_models",
    kind="goal-image model",
    key="perception.model",
    reserved=(*PROVIDERS, *EMBEDDED),
    former="vlad_cell.models",
)
_MEMBERS = ("name", "is_hosted", "begin", "locate", "reason", "direct", "render", "close")


def reads_text(name: str) -> bool:
    """Whether a model finds a target by any words; the embedded ones understand those of `config.words` only."""
    return name not in EMBEDDED


def settings_of(station: Station) -> dict[str, Any]:
    """Return the settings for the goal-image model: ``[perception.settings]``, if no other detector has that table."""
    return station.perception.settings if station.perception.detector == OUR_DETECTOR else {}


def refuse_settings_of_nobody(station: Station) -> None:
    """Raises: ConfigError when ``[perception.settings]`` is there, and detector and goal-image model are ours."""
    settings = station.perception
    if settings.settings and settings.detector == OUR_DETECTOR and settings.model in GROUP.reserved:
        raise ConfigError(
            f"perception.settings.{next(iter(settings.settings))}: neither the detector {settings.detector!r} nor the"
            f" goal-image model {settings.model!r} has settings of its own.",
            "Leave [perception.settings] out, or name the plug-in that it is for.",
        )


def open_local(name: str, station: Station) -> GoalImageModel:
    """Return the model ``name`` that is no provider's: one of ours, or another package's.

    Raises: ConfigError for an unknown name, for a package that cannot be imported here, and for a setting.
    """
    if name in EMBEDDED:
        return EMBEDDED[name](station)
    model: GoalImageModel = GROUP.opened(name, station, settings_of(station), "perception.settings")
    if lacking := [what for what in _MEMBERS if not hasattr(model, what)]:
        raise ConfigError(f"The goal-image model {name!r} has no {lacking[0]!r}.", "See docs/extend.md.")
    if not isinstance(model.name, str) or not model.name:
        raise ConfigError(f"The name of the goal-image model {name!r} is no text: {model.name!r}.", "Correct it there.")
    if not isinstance(model.is_hosted, bool):
        what = f"is_hosted of the goal-image model {name!r} is {model.is_hosted!r}, and no True or False."
        raise ConfigError(what, "Correct it there: one that costs money or minutes is asked less often.")
    return model


def is_replayed(name: str, replies: Iterable[ModelReply]) -> bool:
    """Whether a replay gives back what was recorded instead of asking the model again.

    A provider is never asked again. Another package's model is not either when it answered with pictures: these are
    recorded, while a goal that it painted into the observed image is not.
    """
    return name in PROVIDERS or (name not in EMBEDDED and any(reply.image_png is not None for reply in replies))
