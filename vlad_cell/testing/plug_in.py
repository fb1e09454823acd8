"""The common part of all suites: the plug-in's name and settings, and the station that it is opened with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import pytest

from bus.errors import ConfigError
from config.load import load_station
from config.plug_ins import Group
from config.schema import Station


class PlugInSuite:
    """A suite of checks.

    Attributes:
        group: of the entry points; each kind of suite has its own.
        name: of the entry point. ``settings``: of the plug-in, as its table of the station file has them.
        station_file: the station; None = the simulated cell. ``overrides``: settings on top, ``key=value``.
    """

    group: ClassVar[Group]
    name: ClassVar[str]
    settings: ClassVar[Mapping[str, Any]] = {}
    station_file: ClassVar[Path | None] = None
    overrides: ClassVar[Sequence[str]] = ()

    @pytest.fixture(scope="class")
    @classmethod
    def station(cls) -> Station:
        """Return the station that the plug-in is opened with."""
        return cls.configured()

    @classmethod
    def configured(cls) -> Station:
        """Return the station of ``station_file`` and ``overrides``. Raises: ConfigError."""
        given_by = {one.partition("=")[0].strip(): f"{cls.__name__}.overrides" for one in cls.overrides}
        return load_station(cls.station_file, cls.overrides, given_by=given_by)

    def test_it_loads_without_being_opened(self) -> None:
        """`cell drivers` and its like load it for its settings, on machines without its device, weights or licence."""
        self._entry_point()

    def test_a_setting_that_it_does_not_have_is_refused_with_its_name(self) -> None:
        factory = self._entry_point()
        with pytest.raises(ConfigError, match=r"^table\.no_such_setting: "):
            self.group.settings_of(self.name, factory, {**self.settings, "no_such_setting": 1}, "table")

    def _entry_point(self) -> object:
        """Return what the entry point names; ours that have none are not asked for it."""
        if self.name in self.group.reserved:
            pytest.skip(f"{self.name} is no entry point")
        return self.group.load(self.name)
