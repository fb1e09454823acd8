"""The public Python API of VLAD Cell: detect grasps, read recordings, command a cell.

`detect` finds grasps in a saved RGB-D image, `read_cycle` reads a recorded cycle, `Cell` commands a running cell, and
`simulated_cell` starts a simulated one. What begins with an underscore, and every other package of this project, may
change between two releases. Frames and units: docs/frames.md.
"""

from bus.errors import (
    BadFrame,
    BusError,
    CellError,
    CellUnreachable,
    ConfigError,
    CycleFailure,
    NotReached,
    RecordingError,
    Refused,
    ReplyTimeout,
)
from bus.messages import CycleResult, Place, Rectangle, Target
from bus.messages import Instance as Thing
from vlad_cell.cycle import Cycle, read_cycle
from vlad_cell.detection import Detections, Grasp, detect
from vlad_cell.look import Look
from vlad_cell.pick import Pick
from vlad_cell.picture import Picture
from vlad_cell.running import Cell, simulated_cell
from vlad_cell.tracks import HandTrack, JointTrack

__all__ = [
    "BadFrame",
    "BusError",
    "Cell",
    "CellError",
    "CellUnreachable",
    "ConfigError",
    "Cycle",
    "CycleFailure",
    "CycleResult",
    "Detections",
    "Grasp",
    "HandTrack",
    "JointTrack",
    "Look",
    "NotReached",
    "Pick",
    "Picture",
    "Place",
    "RecordingError",
    "Rectangle",
    "Refused",
    "ReplyTimeout",
    "Target",
    "Thing",
    "detect",
    "read_cycle",
    "simulated_cell",
]
