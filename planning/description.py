"""The URDF of a station's whole robot: the FR3's as it is shipped, or another arm's with the Franka hand on it."""

from __future__ import annotations

import re
from copy import deepcopy
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

from bus.errors import ConfigError
from config.robot import RobotSettings
from config.schema import Station

ASSETS = Path(str(files("franky_sim"))) / "assets"
_HAND = re.compile(r"fr3_(hand|leftfinger|rightfinger|finger|hand_tcp)")
_MOUNT = "fr3_hand_joint"
_BASE = """<robot>
<link name="base"/>
<joint name="base_joint" type="fixed"><parent link="base"/><child link="link0"/></joint>
</robot>"""
"""All poses are in ``base``, which is the arm's link0."""


@dataclass(frozen=True)
class Description:
    """A robot's URDF, and the names in it that planning needs.

    Attributes:
        urdf: its text. ``links``: of the arm, from the base to the last joint's. ``flange``: the link of the hand.
    """

    urdf: str
    links: tuple[str, ...]
    flange: str


def describe(station: Station) -> Description:
    """Return the description of the station's robot. Raises: ConfigError when its URDF cannot be used."""
    if station.robot is None:
        return Description(_shipped(), tuple(f"fr3_link{n}" for n in range(8)), "fr3_link8")
    links = tuple(f"link{n}" for n in range(len(station.robot.joints) + 1))
    return Description(_with_hand(station.robot, links), links, "flange")


def _shipped() -> str:
    return (ASSETS / "fr3.urdf").read_text()


def _with_hand(robot: RobotSettings, links: tuple[str, ...]) -> str:
    """Return the arm's URDF with the links and joints of the Franka hand."""
    try:
        arm = ElementTree.parse(robot.urdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ConfigError(f"robot.urdf: {robot.urdf} cannot be read: {error}.", "Correct robot.urdf.") from error
    _require_chain(robot, arm, links)
    if "base" not in {link.get("name") for link in arm.findall("link")}:
        arm.extend(ElementTree.fromstring(_BASE))
    for part in ElementTree.fromstring(_shipped()):
        if part.tag in ("link", "joint") and _HAND.match(part.get("name", "")):
            arm.append(_on_flange(part) if part.get("name") == _MOUNT else part)
    return ElementTree.tostring(arm, encoding="unicode")


def _on_flange(mount: ElementTree.Element) -> ElementTree.Element:
    """Return the joint that carries the hand, on the arm's own flange."""
    joint = deepcopy(mount)
    parent = joint.find("parent")
    assert parent is not None
    parent.set("link", "flange")
    return joint


def _require_chain(robot: RobotSettings, arm: ElementTree.Element, links: tuple[str, ...]) -> None:
    """Raises: ConfigError unless link0 to link6 and the flange are a chain of the station's joints, about their z."""
    joints = {joint.get("name"): joint for joint in arm.findall("joint")}
    for number, settings in enumerate(robot.joints):
        joint = joints.get(settings.name)
        if joint is None:
            raise ConfigError(f"{robot.urdf} has no joint {settings.name!r}.", "robot.joints names them, base first.")
        ends = [_named(joint, "parent", "link"), _named(joint, "child", "link")]
        if ends != [links[number], links[number + 1]] or joint.get("type") != "revolute":
            what = f"The joint {settings.name!r} of {robot.urdf} does not turn {links[number + 1]} on {links[number]}."
            raise ConfigError(what, "The links are called link0 (the base) to link6.")
        if not _is_z(_named(joint, "axis", "xyz")):
            raise ConfigError(f"The joint {settings.name!r} of {robot.urdf} does not turn about z.", 'axis xyz="0 0 1"')
    mounts = {_named(joint, "parent", "link") for joint in arm.findall("joint") if joint.get("type") == "fixed"
              and _named(joint, "child", "link") == "flange"}  # fmt: skip
    if mounts != {links[-1]}:
        what = f"{robot.urdf} has no link 'flange' fixed to {links[-1]}."
        raise ConfigError(what, f"The hand is mounted on it: a fixed joint from {links[-1]} to flange.")


def _is_z(axis: str) -> bool:
    try:
        return [float(part) for part in axis.split()] == [0.0, 0.0, 1.0]
    except ValueError:
        return False


def _named(joint: ElementTree.Element, tag: str, attribute: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get(attribute, "")
