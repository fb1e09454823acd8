"""Chosen recordings as data sets of other programs: LeRobot's, and one of grasps."""

from logs.export.grasps import export_grasps
from logs.export.lerobot import export_lerobot
from logs.export.selection import Done, LeftOut, Runner, Selection, select

__all__ = ["Done", "LeftOut", "Runner", "Selection", "export_grasps", "export_lerobot", "select"]
