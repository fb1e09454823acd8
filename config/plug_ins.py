"""Entry points of installed packages, and the settings that each plug-in has of its own in the station file.

A plug-in with settings carries a pydantic model as the attribute ``Settings`` of what its entry point names: a class
has it in its body, a function gets it from `with_settings`. It is called with the station and its checked settings; one
without is called with the station alone.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bus.distribution import OURS
from bus.errors import CellError, ConfigError, PlugInMissing
from bus.first_mistake import first_mistake
from bus.redaction import raised
from config.schema import Station

FunctionT = TypeVar("FunctionT", bound=Callable[..., object])


def with_settings(model: type[BaseModel]) -> Callable[[FunctionT], FunctionT]:
    """Return a decorator that gives a function its settings' model."""

    def give(function: FunctionT) -> FunctionT:
        setattr(function, "Settings", model)  # noqa: B010 - a function has no attribute of that name for mypy
        return function

    return give


def packaged(point: EntryPoint) -> str:
    """Return name and version of the package that brings an entry point; "" when its metadata do not tell."""
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else ""


@dataclass(frozen=True)
class Group:
    """The plug-ins of one kind.

    Attributes:
        name: of the entry points' group. ``kind``: in words, e.g. ``driver``. ``key``: the setting that names one.
        reserved: names that are ours without an entry point.
        former: an older name of the group, which is not read any more; None = there is none.
        failure: what is raised when the package of a plug-in does not load or start here.
    """

    name: str
    kind: str
    key: str
    reserved: tuple[str, ...] = ()
    former: str | None = None
    failure: type[CellError] = ConfigError

    def points(self) -> tuple[EntryPoint, ...]:
        """Return all entry points of installed packages, by name and package, whether they can be used or not."""
        return _sorted(entry_points(group=self.name))

    def names(self) -> tuple[str, ...]:
        """Return the names that a station can use, sorted."""
        return tuple(sorted({*self.reserved, *(point.name for point in self.points())}))

    def require(self, name: str) -> None:
        """Raises: PlugInMissing, listing what there is, when nothing is called ``name``; ConfigError: it is renamed."""
        if name in self.names():
            return
        if renamed := [
            packaged(point) for point in _sorted(entry_points(group=self.former or "")) if point.name == name
        ]:
            what = f"The {self.kind} {name!r} of {renamed[0]} is in the group {self.former}: it is {self.name} now."
            raise ConfigError(what, "Rename the group in that package's pyproject.toml, and install it again.")
        raise PlugInMissing(
            f"Unknown {self.kind} {name!r}.",
            f"{self.key} is one of: {', '.join(self.names())}.",
            kind=self.kind,
            name=name,
            key=self.key,
            group=self.name,
        )

    def package_of(self, name: str) -> str:
        """Return the package of another maker that brings ``name``, with its version; "" for ours, and for none."""
        if name in self.reserved:
            return ""
        return next((packaged(one) for one in self.points() if one.name == name and not _is_ours(one)), "")

    def why_not(self, point: EntryPoint) -> str | None:
        """Return why a station cannot use this entry point because of its name; None = it can."""
        if point.name in self.reserved:
            return f"The name {point.name!r} is taken by {OURS}."
        rivals = [other for other in self.points() if other.name == point.name]
        ours = [other for other in rivals if _is_ours(other)]
        if ours:
            return None if _is_ours(point) else f"The name {point.name!r} is taken by {OURS}."
        others = [package for other in rivals if (package := packaged(other)) != packaged(point)]
        return f"{' and '.join(others)} has the name {point.name!r}, too." if others else None

    def load(self, name: str) -> Any:
        """Return what the entry point ``name`` names.

        Raises: ConfigError for an unknown name, one of ours and one that two packages have; `failure` when it does not
            load.
        """
        self.require(name)
        if name in self.reserved:
            raise ConfigError(f"The {self.kind} {name!r} is ours, and no plug-in.", f"Leave {self.key} as it is.")
        usable = [point for point in self.points() if point.name == name and self.why_not(point) is None]
        if not usable:
            packages = " and ".join(packaged(point) for point in self.points() if point.name == name)
            raise ConfigError(f"The {self.kind} {name!r} is brought by {packages}.", "Uninstall all but one of them.")
        return self.loaded(usable[0])

    def loaded(self, point: EntryPoint) -> Any:
        """Return what this entry point names. Raises: `failure` when its package cannot be imported."""
        try:
            return point.load()
        except self.failure:  # it says itself what is missing
            raise
        except (Exception, SystemExit) as error:
            what = f"The {self.kind} {point.name!r} cannot be loaded: {raised(error)}."
            raise self.failure(what, _what_to_do_about(error, point)) from error

    def opened(self, name: str, station: Station, given: Mapping[str, Any], where: str) -> Any:
        """Return what the plug-in ``name`` makes of the station and its settings.

        Args:
            given: its table of the station file. ``where``: that table's name, e.g. ``nodes.hand.settings``.

        Raises: as `load`; ConfigError for a setting, which it names; `failure` when the plug-in raises anything that is
            no error of this project.
        """
        factory = self.load(name)
        settings = self.settings_of(name, factory, given, where)
        try:
            return factory(station) if settings is None else factory(station, settings)
        except CellError:
            raise
        except (Exception, SystemExit) as error:
            what = f"The {self.kind} {name!r} does not start: {raised(error)}."
            raise self.failure(what, "Its own documentation says what it needs.") from error

    def settings_of(self, name: str, factory: object, given: Mapping[str, Any], where: str) -> BaseModel | None:
        """Return the checked settings; None for a plug-in that has none. Raises: ConfigError, which names the field."""
        model = model_of(factory)
        if model is None:
            if given:
                what = f"{where}.{next(iter(given))}: the {self.kind} {name!r} has no settings."
                raise ConfigError(what, f"Leave {where} out.")
            return None
        try:
            return model.model_validate(dict(given))
        except ValidationError as error:
            raise ConfigError(*_explained(error, model, f"{self.kind} {name!r}", where)) from error


def model_of(factory: object) -> type[BaseModel] | None:
    """Return the model of a plug-in's settings; None for one without. Raises: ConfigError when it is no model."""
    model = getattr(factory, "Settings", None)
    if model is None or (isinstance(model, type) and issubclass(model, BaseModel)):
        return model
    raise ConfigError(f"Settings of {factory!r} is no pydantic model.", "Derive it from pydantic.BaseModel.")


def _explained(error: ValidationError, model: type[BaseModel], whose: str, where: str) -> tuple[str, str]:
    what = f"{first_mistake(error, inside=where)} (the {whose} says)."
    first = error.errors()[0]
    near = difflib.get_close_matches(str(first["loc"][-1]), model.model_fields, n=1) if first["loc"] else []
    meant = f"Did you mean '{where}.{near[0]}'? " if near and first["type"] == "extra_forbidden" else ""
    known = ", ".join(model.model_fields) or "none"
    return what, f"{meant}Correct it where it is given. Its settings: {known}."


def _what_to_do_about(error: BaseException, point: EntryPoint) -> str:
    """Return what to do about an entry point that does not load: it is wrong itself, or its package lacks something."""
    package = packaged(point) or "its package"
    module = point.module.partition(".")[0]
    is_nowhere = isinstance(error, ModuleNotFoundError) and error.name == module
    if is_nowhere or (isinstance(error, AttributeError) and error.name == point.attr.partition(".")[0]):
        return f"The entry point of {package} is {point.value!r}: correct it there, or package what it names."
    return f"Install what {package} needs."


def _is_ours(point: EntryPoint) -> bool:
    return point.dist is not None and point.dist.name == OURS


def _sorted(points: Iterable[EntryPoint]) -> tuple[EntryPoint, ...]:
    return tuple(sorted(points, key=lambda point: (point.name, packaged(point))))
