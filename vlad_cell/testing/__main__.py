"""``python -m vlad_cell.testing driver NAME``: runs the suites on an installed plug-in. Exit 0 = it passes."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Annotated, Literal

import pytest
import typer

from bus.errors import CellError
from config.load import load_station
from config.schema import Station
from vlad_cell.testing import named

_OPTIONS = ("-p", "no:cacheprovider", "-v", "-rs", "--no-header", "-W", "ignore::pytest.PytestAssertRewriteWarning")
_NODE_SETTING = re.compile(r"\s*nodes\.([^.=]+)\.settings\.")
Kind = Literal["driver", "detector", "goal-model"]


def check(
    kind: Annotated[Kind, typer.Argument(help="What it is: driver, detector or goal-model.")],
    name: Annotated[str, typer.Argument(help="Its name, as `cell drivers` and its like list it.")],
    config: Annotated[
        Path | None, typer.Option(help="The station, with its settings; none: the simulated one.")
    ] = None,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key=value, as for `cell start`.")] = None,
) -> None:
    """Check a plug-in. A driver's devices are connected and moved: stand clear of real ones."""
    try:
        named_too = with_its_node(kind, name, config, overrides or [])
        given = _settings(kind, name, load_station(config, named_too))
        group = named.SUITES[kind][0].group
        group.require(name)
        if name not in group.reserved:
            table = "nodes.NAME.settings" if kind == "driver" else "perception.settings"
            group.settings_of(name, group.load(name), given, table)
    except CellError as error:
        print(error, file=sys.stderr)  # noqa: T201
        raise typer.Exit(error.exit_code) from error
    for suite in named.SUITES[kind]:
        suite.name, suite.settings, suite.station_file = name, given, config
        suite.overrides = (*suite.overrides, *named_too)
    chosen = [f"{named.__file__}::{suite.__name__}" for suite in named.SUITES[kind]]
    options = ["-c", os.devnull, "--rootdir", os.getcwd(), *_OPTIONS]
    raise typer.Exit(int(pytest.main([*options, *chosen])))


def with_its_node(kind: Kind, name: str, config: Path | None, overrides: list[str]) -> list[str]:
    """Return the overrides; where they set a node that the station lacks, also those that make it the driver's.

    The node serves nothing there: the suites open the driver by themselves.
    """
    own = [one for one in overrides if kind == "driver" and _NODE_SETTING.match(one)]
    others = [one for one in overrides if one not in own]
    there = load_station(config, others).nodes
    nodes = dict.fromkeys(found[1] for one in own if (found := _NODE_SETTING.match(one)))
    made = [
        part
        for node in nodes
        if node not in there
        for part in (f"nodes.{node}.driver={name}", f"nodes.{node}.serves=[]")
    ]
    return [*others, *made, *own]


def _settings(kind: Kind, name: str, station: Station) -> dict[str, object]:
    """Return the plug-in's own settings in the station; none when it does not name it."""
    if kind == "driver":
        nodes = [node for node in station.nodes.values() if node.driver == name]
        return dict(nodes[0].settings) if nodes else {}
    return dict(station.perception.settings)


if __name__ == "__main__":
    typer.run(check)
