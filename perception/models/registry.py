"""Name -> the goal-image model that imagines the rod.

Ours are named here. Another package brings one as an entry point of the group ``vlad_cell.models``: a function or class
that is given the station and returns a `GoalImageModel`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from typing import NamedTuple

from bus.errors import ConfigError
from bus.messages import ModelReply
from config.schema import Station
from perception.models.base import GoalImageModel
from perception.models.geometric import GeometricModel
from perception.models.network import NetworkModel

GROUP = "vlad_cell.models"


class Provider(NamedTuple):
    """The module and class of a provider, imported only when used."""

    module: str
    name: str


PROVIDERS = {
    "openai": Provider("perception.models.openai", "OpenAIProvider"),
    "gemini": Provider("perception.models.gemini", "GeminiProvider"),
}
EMBEDDED: dict[str, Callable[[Station], GoalImageModel]] = {"geometric": GeometricModel, "onnx": NetworkModel}


def names() -> tuple[str, ...]:
    """Every model that a station can name, sorted."""
    return tuple(sorted({*PROVIDERS, *EMBEDDED, *(point.name for point in entry_points(group=GROUP))}))


def reads_text(name: str) -> bool:
    """Whether a model finds a target by any words; the embedded ones understand those of `config.words` only."""
    return name not in EMBEDDED


def require(name: str) -> None:
    """Raises: ConfigError, listing what there is, when no model is called ``name``."""
    if name not in names():
        raise ConfigError(f"Unknown goal-image model {name!r}.", f"perception.model is one of: {', '.join(names())}.")


def open_local(name: str, station: Station) -> GoalImageModel:
    """The model ``name`` that is no provider's: one of ours, or another package's.

    Raises: ConfigError for an unknown name, and for a model whose package cannot be imported here.
    """
    if name in EMBEDDED:
        return EMBEDDED[name](station)
    require(name)
    (point, *_) = entry_points(group=GROUP, name=name)
    try:
        factory: Callable[[Station], GoalImageModel] = point.load()
    except ImportError as error:
        text = f"The goal-image model {name!r} cannot be loaded: {error}."
        raise ConfigError(text, "Install what it needs.") from error
    return factory(station)


def is_replayed(name: str, replies: Iterable[ModelReply]) -> bool:
    """Whether a replay gives back what was recorded instead of asking the model again.

    A provider is never asked again. Another package's model is not either when it answered with pictures: these are
    recorded, while a goal that it painted into the observed image is not.
    """
    return name in PROVIDERS or (name not in EMBEDDED and any(reply.image_png is not None for reply in replies))
