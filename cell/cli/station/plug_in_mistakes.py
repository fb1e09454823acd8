"""Finds mistakes in the plug-ins that a station names: one is not installed here, or refuses a setting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from pydantic import ValidationError

from bus.errors import CellError
from bus.first_mistake import reason
from config.mistakes import Said
from config.origins import Place
from config.plug_ins import Group
from config.schema import Station
from drivers.node.registry import GROUP as DRIVERS
from perception.detectors.registry import GROUP as DETECTORS
from perception.models.registry import GROUP as GOAL_MODELS
from perception.models.registry import refuse_settings_of_nobody, settings_of

_SETTINGS: Place = ("perception", "settings")


class _Named(NamedTuple):
    """A plug-in, where a station names it, and its settings with their place."""

    group: Group
    name: str
    place: Place
    given: Mapping[str, Any]
    settings: Place


def plug_in_mistakes(station: Station) -> Iterator[Said]:
    """Yield what is wrong of the drivers, the detector and the goal-image model. Other packages' ones are imported."""
    own = station.perception
    named = [
        _Named(DRIVERS, node.driver, ("nodes", name, "driver"), node.settings, ("nodes", name, "settings"))
        for name, node in station.nodes.items()
    ]
    named.append(_Named(DETECTORS, own.detector, ("perception", "detector"), own.settings, _SETTINGS))
    named.append(_Named(GOAL_MODELS, own.model, ("perception", "model"), settings_of(station), _SETTINGS))
    for one in named:
        yield from _mistakes(one)
    try:
        refuse_settings_of_nobody(station)
    except CellError as error:
        yield _said((*_SETTINGS, next(iter(own.settings))), error)


def _mistakes(named: _Named) -> Iterator[Said]:
    """Yield what is wrong of one plug-in; nothing of ours is imported for settings that are not given."""
    group, name, settings = named.group, named.name, named.settings
    try:
        group.require(name)
        if name in group.reserved or not (named.given or group.package_of(name)):
            return
        factory = group.load(name)
    except CellError as error:
        yield _said(named.place, error)
        return
    try:
        group.settings_of(name, factory, named.given, ".".join(map(str, settings)))
    except CellError as error:
        if not isinstance(error.__cause__, ValidationError):
            yield _said((*settings, *named.given)[: len(settings) + 1], error)
            return
        for one in error.__cause__.errors():
            yield Said((*settings, *one["loc"]), f"{reason(one)} (the {group.kind} {name!r} says)", error.advice)


def _said(place: Place, error: CellError) -> Said:
    return Said(place, error.text.removeprefix(f"{'.'.join(map(str, place))}: ").rstrip("."), error.advice)
