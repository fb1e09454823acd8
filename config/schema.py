"""The station's schema: every setting with its unit in its name, its default, and its reason.

Unknown keys are errors. Values come from defaults < station file < ``--set key=value`` (see `config.load`).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from bus.lazy import LazyModule
from bus.messages.execution import Witness
from bus.secured import is_loopback
from config.base import (
    UNSHOWN,
    Chunk,
    FolderOrName,
    Fraction,
    JointVector,
    Metres,
    NonNegative,
    Positive,
    Seconds,
    Settings,
    Size,
    SizeOrNone,
    SystemPath,
    UnitQuaternion,
    Vector,
)
from config.bus import BusSettings
from config.calibration import CalibrationSettings
from config.fault_injection import FaultSettings
from config.hardware import FemtoMegaSettings, Fr3Settings, PandaHandSettings
from config.http import HttpSettings
from config.opcua import OpcuaSettings
from config.place import NamedPlace
from config.robot import RobotSettings, limits_of
from config.target import Label, TargetSettings

# Imported when a value is checked with them, so that a program that only sends "stop" does not wait for them.
numpy: Any = LazyModule("numpy")


class RecordingSettings(Settings):
    """Folder and retention of the cycles' recordings.

    Attributes:
        min_free_mb: below this free space the next cycle is refused.
        patience_s: a disk that takes longer for one message or the end of a file counts as lost (RECORDING).
        keep_gb: space for the recordings; 0 = the whole disk, until `min_free_mb` refuses the next cycle. A cell that
            picks all day records tens of GB. Beyond it the oldest successes are deleted; failures, oldest first too,
            only when no success is left, because they are the ones still worth studying.
        keep_free_gb: space that the disk keeps free; what is beyond goes as with `keep_gb`, whoever fills the disk. It
            must be more than `min_free_mb`, so that no cycle is refused. 0 = none.
        keep_days: a success is deleted when it is older; 0 = never.
        keep_failed_days: a failure is deleted when it is older; 0 = never.
        keep_labelled: what a person labelled or noted (`cell label`) is never deleted or trimmed.
        thin_after_days: a success that is older is trimmed: it loses its pictures, and can be shown, reported and
            counted, but not replayed; 0 = never.
        archive: what is deleted or trimmed is first copied below this address of any fsspec file system
            (``s3://bucket/cell-1``, ``file:///mnt/nas/cell-1``), read back and compared; "" = no copy. Needs
            `vlad-cell[archive]`. It holds no password: a recording shows its station.
    """

    folder: SystemPath = Path("recordings")
    min_free_mb: NonNegative = 500.0
    patience_s: Positive = 10.0
    keep_gb: NonNegative = 0.0
    keep_free_gb: NonNegative = 0.0
    keep_days: NonNegative = 0.0
    keep_failed_days: NonNegative = 0.0
    keep_labelled: bool = True
    thin_after_days: NonNegative = 0.0
    archive: str = ""

    @property
    def rules(self) -> dict[str, float]:
        """The settings that delete or trim anything, by their name; empty: nothing ever goes."""
        names = ("keep_gb", "keep_free_gb", "keep_days", "keep_failed_days", "thin_after_days")
        return {name: getattr(self, name) for name in names if getattr(self, name)}

    @field_validator("archive")
    @classmethod
    def _without_password(cls, address: str) -> str:
        if ":" in urlsplit(address).netloc.rpartition("@")[0]:
            raise PydanticCustomError(UNSHOWN, "a recording shows its station: leave the password to the environment")
        return address

    @model_validator(mode="after")
    def _deletes_before_it_refuses(self) -> RecordingSettings:
        if 0 < self.keep_free_gb * 1e3 <= self.min_free_mb:
            raise PydanticCustomError(
                "keep_free_gb", "keep_free_gb must be more than min_free_mb, below which cycles are refused"
            )
        return self


class NodeSettings(Settings):
    """A driver node: its driver, the devices it serves, and whether the daemon runs it.

    Attributes:
        driver: `cell drivers` lists those there are. ``settings``: of another package's driver, which checks them
            itself, in its node.
    """

    driver: str
    run: Literal["here", "elsewhere"] = "here"
    serves: tuple[Literal["camera", "arm", "hand"], ...]
    settings: dict[str, Any] = Field(default_factory=dict)


class CameraSettings(Settings):
    """Mounting of the wrist camera: pose of the colour camera (optical) in the hand frame.

    Rotation as unit quaternion wxyz. The default looks along the hand's approach axis, image down = hand -x.

    Attributes:
        max_age_s: a frame older than this is refused (STALE_FRAME).
        least_range_m: the depth camera measures nothing nearer; a hole in its depth may be that. 0.5: Femto Mega, NFOV.
    """

    hand_from_color_position_m: Vector = (0.065, 0.0, 0.02)
    hand_from_color_wxyz: UnitQuaternion = (0.70710678118654752, 0.0, 0.0, 0.70710678118654752)
    max_age_s: Seconds = 2.0
    least_range_m: SizeOrNone = 0.5


class CaptureSettings(Settings):
    """How often the scene is looked at before a pick.

    Attributes:
        views: 1, 2 or 3 looks, fewer where no other place is reached; ``auto`` looks again only when too little was
            seen, nothing can be grasped, the best grasp is weak, or no way to it is free.
        most_views: most looks of ``auto``.
        weak_score: a best grasp that scores less is worth another look.
        mount_correction: several looks are made to agree by one correction of the camera's mounting.
    """

    views: Literal[1, 2, 3, "auto"] = "auto"
    most_views: Annotated[int, Field(ge=1, le=5)] = 3
    weak_score: Fraction = 0.75
    mount_correction: bool = True


class ArmSettings(Settings):
    """Named joint configurations [rad] and the arm's motion limits.

    Attributes:
        speed: share of the allowed joint speed, in 0..1.
        start_tolerance_rad: largest distance of a trajectory's start from the measured position.
        rest_s: longest time for a stopped or held arm, and the cycle that moved it, to come to rest.
    """

    capture_q_rad: JointVector = (0.0, -0.45383069, 0.0, -1.83384904, 0.0, 1.38001835, 0.7853981633974483)
    speed: Annotated[float, Field(gt=0, le=1)] = 1.0
    start_tolerance_rad: Annotated[Positive, Field(le=1)] = 0.02
    rest_s: Seconds = 20.0


class HandSettings(Settings):
    """The Panda hand, and its grasp force.

    Finger geometry is that of the collision mesh: pads `finger_width_m` wide (across the closing axis),
    `finger_thickness_m` thick (along it).
    """

    max_width_m: Size = 0.08
    max_speed_m_s: Positive = 0.1
    """Highest rate of the width: 50 mm/s for each finger (Franka Hand product manual)."""
    max_force_n: Positive = 70.0
    """Highest continuous grasping force (Franka Hand product manual)."""
    speed_m_s: Positive = 0.05
    """Rate of the width while the fingers close on an object; free of it they move at `max_speed_m_s`."""
    grasp_force_n: Positive = 30.0
    release_margin_m: Size = 0.010
    """How much wider than the object the fingers open to let it go; never less than they came with."""
    finger_width_m: Size = 0.020
    finger_thickness_m: Size = 0.012
    min_width_m: SizeOrNone = 0.002

    @model_validator(mode="after")
    def _asks_for_what_it_can(self) -> HandSettings:
        if self.speed_m_s > self.max_speed_m_s or self.grasp_force_n > self.max_force_n:
            raise ValueError("speed_m_s and grasp_force_n must be within max_speed_m_s and max_force_n")
        if self.min_width_m >= self.max_width_m:
            raise ValueError(f"min_width_m {self.min_width_m} must be below max_width_m {self.max_width_m}")
        return self


class Box(Settings):
    """A fixed, axis-aligned box of the scene in ``base``."""

    name: Chunk
    center_m: Vector
    size_m: tuple[Size, Size, Size]


class Table(Box):
    """The table; its top is where objects lie.

    Attributes:
        tolerance_mm, tolerance_deg: the largest height above or below it, and the largest tilt, at which the camera may
            see it. Grasps follow the seen table; beyond this the cycle ends with TABLE_MOVED.
    """

    tolerance_mm: Positive = 15.0
    tolerance_deg: Annotated[float, Field(gt=0, le=12)] = 5.0

    @property
    def top_m(self) -> float:
        """Height of its top in ``base``."""
        return self.center_m[2] + self.size_m[2] / 2


class Bin(Settings):
    """Four walls on the table, axis-aligned in ``base``; the table is the floor.

    Attributes:
        center_m: (x, y) of its middle. ``size_m``: of its inside, along x and y.
    """

    name: Chunk
    center_m: tuple[Metres, Metres]
    size_m: tuple[Size, Size]
    wall_height_m: Size = 0.08
    wall_thickness_m: Size = 0.01

    @property
    def walls(self) -> tuple[Box, ...]:
        """Front (towards the base), back, right and left: ``<name>-front`` and so on."""
        thickness_m = self.wall_thickness_m
        outline_m = (self.size_m[0] + thickness_m, self.size_m[1] + thickness_m)
        return walls_on(self.name, (*self.center_m, 0.0), outline_m, thickness_m, self.wall_height_m)


def walls_on(
    name: str, foot_m: Vector, outline_m: tuple[float, float], thickness_m: float, height_m: float
) -> tuple[Box, ...]:
    """Return four walls centred on a rectangle's outline around ``foot_m``.

    Args:
        foot_m: (x, y, z) middle of the walls' feet.
        outline_m: (along x, along y).
    """
    (x, y, z), (length, width) = foot_m, outline_m
    middle = z + height_m / 2
    along_x, along_y = (length + thickness_m, thickness_m, height_m), (thickness_m, width + thickness_m, height_m)
    sides = (
        ("front", -length / 2, 0.0, along_y),
        ("back", length / 2, 0.0, along_y),
        ("right", 0.0, -width / 2, along_x),
        ("left", 0.0, width / 2, along_x),
    )
    return tuple(
        Box(name=f"{name}-{side}", center_m=(x + dx, y + dy, middle), size_m=size) for side, dx, dy, size in sides
    )


_LEAST_REGION_M = 0.02


class SceneSettings(Settings):
    """The fixed surroundings of the arm. The table's top is the plane z = 0 of ``base``.

    Attributes:
        pick_region_m: (x_min, x_max, y_min, y_max) in ``base``: the region searched for objects.
        place_m: tcp position at which the object is released, above the tray's floor.
        place_pattern_m: offsets from it along x and y of ``base``, one per cycle, so that objects do not pile up.
        place_yaw_rad: heading of the closing axis in ``base`` at the release; None = any.
        places: others by name, which a job may ask for.
        bins: bins with objects to pick; the pick region lies inside one, or outside all.
        max_height_m: what rises higher above the table is no object: the arm, a camera stand.
    """

    table: Table = Table(name="table", center_m=(0.45, 0.0, -0.02), size_m=(0.9, 1.4, 0.04))
    tray: Box = Box(name="tray", center_m=(0.40, 0.45, 0.01), size_m=(0.30, 0.22, 0.02))
    tray_wall_height_m: SizeOrNone = 0.04
    pick_region_m: tuple[Metres, Metres, Metres, Metres] = (0.32, 0.60, -0.20, 0.20)
    place_m: Vector = (0.40, 0.45, 0.20)
    place_pattern_m: Annotated[tuple[tuple[Metres, Metres], ...], Field(min_length=1)] = ((0.0, 0.0),)
    place_yaw_rad: Annotated[float, Field(ge=-7, le=7)] | None = None
    places: tuple[NamedPlace, ...] = ()
    obstacles: tuple[Box, ...] = ()
    bins: tuple[Bin, ...] = ()
    max_height_m: Size = 0.35

    @field_validator("pick_region_m")
    @classmethod
    def _region_is_one(cls, region_m: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        x_min, x_max, y_min, y_max = region_m
        if x_max - x_min < _LEAST_REGION_M or y_max - y_min < _LEAST_REGION_M:
            raise ValueError(f"x_min, x_max, y_min, y_max: from low to high, at least {_LEAST_REGION_M} m apart")
        return region_m

    @model_validator(mode="after")
    def _names_are_unique(self) -> SceneSettings:
        walls = [wall.name for one in self.bins for wall in one.walls]
        boxes = [box.name for box in (self.table, self.tray, *self.obstacles)]
        names = [*boxes, *(one.name for one in self.bins), *walls]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"every box and bin of the scene needs a name of its own; used twice: {', '.join(twice)}")
        places = [place.name for place in self.places]
        if len(set(places)) < len(places):
            raise ValueError(f"every place of the scene needs a name of its own: {', '.join(places)}")
        return self

    @model_validator(mode="after")
    def _pick_region_clear_of_walls(self) -> SceneSettings:
        x_min, x_max, y_min, y_max = self.pick_region_m
        for wall in (wall for one in self.bins for wall in one.walls):
            (x, y, _), (length, width, _) = wall.center_m, wall.size_m
            apart = x + length / 2 <= x_min or x_max <= x - length / 2
            apart = apart or y + width / 2 <= y_min or y_max <= y - width / 2
            if not apart:
                raise ValueError(f"pick_region_m {self.pick_region_m} reaches into the wall {wall.name!r}")
        return self


class ImagineSettings(Settings):
    """Request of the goal image (paper, section III-A)."""

    steps: Literal[1, 3] = 3
    """3 = reason, direct, render; 1 = render at once (the paper's ablation)."""
    samples: Annotated[int, Field(ge=1, le=8)] | Literal["auto"] = "auto"
    """Number of proposals for one object; their agreement is reported. "auto": one; but in several looks the embedded
    model, whose rods cost nothing, makes as many as `targets` in all: planning gets other ways to hold a thing, too."""
    targets: Annotated[int, Field(ge=1, le=20)] = 4
    """Most objects for which a rod is imagined. When one fails the next is tried; the embedded model goes on after a
    success, so that planning has more to choose from."""
    budget_s: Positive = 60.0
    """After so much time no further object is tried."""


class PriceSettings(Settings):
    """The provider's list prices [USD], as you pay them; `cost_usd` is computed from them."""

    usd_per_million_input_tokens: NonNegative = 0.0
    usd_per_million_output_tokens: NonNegative = 0.0
    usd_per_image: NonNegative = 0.0


class HostedSettings(Settings):
    """A hosted model. Keys come from the environment, or from a file outside the project.

    Attributes:
        text_model, image_model: the provider's ids; they expire within a year, so they have no defaults.
        base_url: another server with the same API; None = the provider's own.
        text_api: `responses` (OpenAI) or `chat` (supported by most OpenAI-compatible servers).
        key_variable: the environment variable that holds the key. ``key_file``: a file with the key, one line, not
            readable by others, outside of this folder and of every git work tree; it takes precedence.
        size_px: side of the square window around the object that is sent.
        deadline_s: of one call, all attempts included. ``attempts``: most attempts of one call.
        backoff_s: wait before the second attempt, doubled for each further one; a server's longer Retry-After counts.
        max_cycle_usd, max_day_usd: no call is made after so much was spent in this cycle, or since midnight UTC.
    """

    text_model: str = ""
    image_model: str = ""
    base_url: str | None = None
    text_api: Literal["responses", "chat"] = "responses"
    key_variable: str = ""
    key_file: SystemPath | None = None
    size_px: Annotated[int, Field(ge=256, le=3840, multiple_of=16)] = 1024
    deadline_s: Positive = 120.0
    attempts: Annotated[int, Field(ge=1, le=10)] = 3
    backoff_s: NonNegative = 1.0
    price: PriceSettings = PriceSettings()
    max_cycle_usd: Positive = 1.0
    max_day_usd: Positive = 20.0

    @field_validator("base_url")
    @classmethod
    def _an_address_without_secret(cls, url: str | None) -> str | None:
        if url is None:
            return None
        if "@" in url or "?" in url or "#" in url:
            why = "a user or a query in base_url would be recorded with every cycle; keys: key_file"
            raise PydanticCustomError(UNSHOWN, why)
        if not _is_http(url):
            raise ValueError("base_url is no address of a web server, like https://HOST/v1 or http://127.0.0.1:8000/v1")
        return url

    @field_validator("key_variable")
    @classmethod
    def _names_a_variable(cls, name: str) -> str:
        if name and not re.fullmatch("[A-Z_][A-Z0-9_]*", name):
            why = "key_variable is a variable's name, in capitals, and not the key (which is not shown here)"
            raise PydanticCustomError(UNSHOWN, why)
        return name


def _is_http(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return (
            parts.scheme in ("http", "https")
            and bool(parts.hostname)
            and (parts.port is None or parts.port > 0)
            and all("!" <= sign <= "~" for sign in url)
        )
    except ValueError:  # brackets, a port beyond 65535
        return False


class DriftSettings(Settings):
    """Largest accepted changes of a goal image; beyond them a cycle ends with MODEL_DRIFT. See `bus.messages.Drift`."""

    max_changed_outside: Fraction = 0.05
    max_other_objects: NonNegative = 0.2
    min_silhouette_iou: Fraction = 0.5
    max_color_shift: NonNegative = 45.0


class SamSettings(Settings):
    """SAM, SAM 2 or SAM 3: a folder or a hub id, and its device. Needs the extra ``vlad-cell[models]``."""

    weights: FolderOrName = "facebook/sam2.1-hiera-small"
    device: str = "cpu"


class SalientSettings(Settings):
    """A salient-object network of the U-2-Net family, which marks what stands out. Needs the extra ``vlad-cell[onnx]``.

    Attributes:
        path: its ``.onnx`` file; ``just salient`` fetches u2netp.onnx (4.6 MB).
    """

    path: SystemPath = Path("weights/u2netp.onnx")


class DepthProSettings(Settings):
    """Depth Pro: a folder or a hub id, and its device. Needs the extra ``vlad-cell[models]``."""

    weights: FolderOrName = "apple/DepthPro-hf"
    device: str = "cpu"


class OnnxSettings(Settings):
    """A network of the GG-CNN family; its tensors: `perception.rectangles.network`. Needs ``vlad-cell[onnx]``."""

    path: SystemPath = Path("grasp.onnx")


class PerceptionSettings(Settings):
    """VLAD-Grasp (paper, Algorithm 1) and the models for its roles; or another detector."""

    detector: str = "vlad"
    """Finds the grasps: ``vlad`` is ours; other packages bring others (docs/extend.md), `cell detectors` lists them."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Of another package's detector, or else of another package's goal-image model, which checks them itself."""
    detector_deadline_s: Seconds = 30.0
    """The longest that another package's detector may take for a scene; beyond it the cycle ends with DETECTOR_TIMEOUT.
    """
    model: str = "geometric"
    """Imagines the rod: ``geometric`` is embedded and needs no network; ``onnx`` paints a grasp network's rectangle;
    ``openai`` and ``gemini`` are hosted. Other packages bring others (docs/extend.md)."""
    onnx: OnnxSettings = OnnxSettings()
    imagine: ImagineSettings = ImagineSettings()
    hosted: HostedSettings = HostedSettings()
    segmenter: Literal["depth", "sam", "salient"] = "depth"
    """Depth finds the objects; ``sam`` and ``salient`` redraw their outlines in the colour image."""
    sam: SamSettings = SamSettings()
    salient: SalientSettings = SalientSettings()
    target: TargetSettings = TargetSettings()
    labels: tuple[Label, ...] = ()
    """Words of the station for kinds of things; they name a target without a hosted model."""
    from_above: bool = False
    """Only grasps that come from above; no sides, and no leaning hand."""
    goal_depth: Literal["observed", "depth_pro"] = "observed"
    """Depth of the goal image: the model's own if it knows it, else the height of the observed object; or Depth Pro."""
    depth_pro: DepthProSettings = DepthProSettings()
    align: Literal["silhouette_3d", "pca_cfopt"] = "silhouette_3d"
    max_residual: Positive = 0.20
    """Alignment residual in rms radii: beyond it the goal shows another object (0.20 lets 95 % of true pairs pass)."""
    drift: DriftSettings = DriftSettings()
    compliance: Positive = 1.0
    """lambda: jaw opening of the rectangle = lambda x run length + 2 x margin."""
    rectangle_margin_m: SizeOrNone = 0.0
    """Free space of the opening on each side; 0 as in the paper."""
    min_object_height_m: Size = 0.006
    min_table_seen: Fraction = 0.7
    """Nothing on the table counts as an empty table only when this share of the pick region was seen."""
    rod_radius_m: Size = 0.004
    max_grasps: Annotated[int, Field(ge=1, le=100)] = 12
    approach_clearance_m: SizeOrNone = 0.006
    """Extra opening on each side of the object while approaching."""


Tilt = Annotated[float, Field(ge=-90, le=90)]


class PlanningSettings(Settings):
    """Settings of motion planning.

    Attributes:
        window_ms: moving average behind the time-optimal profile; 64 keeps the FR3's recommended torque rate.
        approach_m, lift_m: straight lines before the grasp and after it.
        clearance_m: smallest distance between any two things; the fingers may come within 2 mm.
        tilts_deg: approach directions tried, about the rod, as turns from the one perception proposes.
        max_approaches: most ways to grasp that are tried, over all grasps and directions.
        budget_s: no further way is tried after so much planning, counted in collision checks and not by the clock.
        max_held_acceleration_m_s2: of what is in the hand. It hangs beside or below the pads, turns between them
            easily, and pulls aside as if it leaned by the angle whose tangent is this share of gravity. None = as fast
            as the joints may.
        searches: number of path searches around obstacles before a goal counts as unreachable.
    """

    window_ms: Annotated[int, Field(ge=16, le=200)] = 64
    approach_m: Size = 0.10
    lift_m: Size = 0.15
    clearance_m: Annotated[float, Field(ge=0.003, le=0.02)] = 0.004
    tilts_deg: Annotated[tuple[Tilt, ...], Field(min_length=1)] = (0.0, 15.0, -15.0, 30.0, -30.0)
    max_approaches: Annotated[int, Field(ge=1, le=1000)] = 1000
    budget_s: Seconds = 2.0
    max_held_acceleration_m_s2: Annotated[float, Field(ge=0.5, le=50)] | None = 5.0
    searches: Annotated[int, Field(ge=1, le=20)] = 3


class ExecuteSettings(Settings):
    """What the arm feels on its way to a grasp.

    Attributes:
        contact_n: on the approach line the arm stops where it meets more force than this against its motion; 0 = it
            feels nothing. The FR3's own reflex (`fr3.collision_wrench`) is to be well above, its noise well below: an
            arm that stops at nothing needs more.
        slow_m: so much of the line, at its end, is slow: only there is what it meets touched softly. 0 = none.
        slow_m_s: fastest speed of the tcp there, where the table or another thing is believed to be within 10 mm of the
            hand at the grasp. Twice the speed is nearly twice the force.
        free_m_s: the same where nothing is: what it meets there was hidden. Faster than 0.03 it may be a reflex.
        beside_m: before that, at most so much of the line is bounded, too: from where anything, or space that no look
            saw, is first within 25 mm of the hand. 0 = none.
        beside_m_s: fastest speed of the tcp there: what it meets is met hard, but without it mostly with a reflex.
        approve: whether a person approves each planned pick before the arm moves for it: ``client``, through any client
            that may command the cell; ``holder``, only the one that holds the lease. Looks before need no approval.
        approve_s: how long the cell waits for the answer; then the cycle ends.
    """

    contact_n: NonNegative = 3.0
    slow_m: SizeOrNone = 0.010
    slow_m_s: Positive = 0.008
    free_m_s: Positive = 0.030
    beside_m: SizeOrNone = 0.020
    beside_m_s: Positive = 0.09
    approve: Literal["no", "client", "holder"] = "no"
    approve_s: Annotated[float, Field(gt=0, le=3600)] = 120.0


class VerifySettings(Settings):
    """Conditions of a successful pick: the object is held for `hold_s`, has weight, and left the table.

    Attributes:
        hold_s: how long the arm stands still with the object. It may be short: the hand is watched from the grasp on.
        samples: readings of the hand during the hold; one a tenth of a second if it is short.
        max_width_loss_m: the width may fall by more only when it is steady in the hold: the object turned flush.
        min_load_n: less is held only when the object's place is seen empty: the arm cannot weigh a few grams.
        look: ``always`` holds the object beside its place and looks there; ``auto`` holds it above the tray, and goes
            back for a look only when width and load do not tell clearly that it is the object.
        clear_load_n: with ``auto``, a load of which it is clear that it is no error of the measurement.
        clear_width_m: with ``auto``, how far the grasped width may be from the grasp's and be clearly the object's.
        clear_density_kg_m3: with ``auto``, a load above that of so dense a thing, as large as was seen, may be that of
            several. Wood, plastic, glass and aluminium are less dense.
        max_density_kg_m3: a load above that of a solid thing so dense, as large as was seen, is that of several: steel.
        max_load_n: what one object weighs at most, where that is known; more is several. Halfway from one to two is
            best. None = not known: of things of one colour that touch, or are nested, nothing else tells.
        several_by: what may tell that several were picked. ``seam`` is for a station whose objects have one colour
            each: of two-coloured ones it takes every one for two. ``place`` errs in heaps, where things slide.
    """

    hold_s: Annotated[float, Field(gt=0, le=60)] = 3.0
    samples: Annotated[int, Field(ge=2, le=100)] = 10
    min_width_m: Size = 0.004
    max_width_loss_m: Size = 0.006
    min_load_n: NonNegative = 0.15
    min_cleared_fraction: Fraction = 0.7
    look: Literal["always", "auto"] = "always"
    clear_load_n: NonNegative = 0.3
    clear_width_m: Size = 0.006
    clear_density_kg_m3: Positive = 3000.0
    max_density_kg_m3: Positive = 7850.0
    max_load_n: NonNegative | None = None
    several_by: tuple[Witness, ...] = ("load", "width", "place")
    look_aside_m: tuple[tuple[Metres, Metres], ...] = ((-0.28, -0.25), (0.05, -0.45), (-0.15, -0.25), (0.0, -0.3))
    """Offsets of the camera for the second capture from above the object's place, along x and y of ``base``; the first
    that the arm reaches is used. The held object hides most of the near field: these keep the place in the free part of
    the depth image (measured on the paper's five objects: the first two see at least 90 % of it)."""


class RetrySettings(Settings):
    """Retries after a failed pick; each is a cycle of its own. 0 everywhere: no retries.

    What fails for good in picks until empty is left where it is, and the next thing is picked.

    Attributes:
        grasps: retries with the next ranked grasp, after the fingers closed on nothing, or the arm met something.
        looks: retries after any other failure that may not repeat: with a new capture, all grasps again.
        hold_after: the cell holds after so many picks of one `start` in a row failed for good (0 = never).
    """

    grasps: Annotated[int, Field(ge=0, le=10)] = 2
    looks: Annotated[int, Field(ge=0, le=10)] = 1
    hold_after: Annotated[int, Field(ge=0, le=100)] = 0


class ManualSettings(Settings):
    """Motion by hand, in mode Manual.

    Attributes:
        jog_m: one step of a jog. ``jog_m_s``: the tcp is never faster.
        home_speed: share of the speed elsewhere, on the way to the capture pose.
        hand_m_s: rate of the hand's width.
    """

    jog_m: Annotated[float, Field(gt=0, le=0.02)] = 0.005
    jog_m_s: Annotated[float, Field(gt=0, le=0.25)] = 0.025
    home_speed: Annotated[float, Field(gt=0, le=0.25)] = 0.1
    hand_m_s: Annotated[float, Field(gt=0, le=0.1)] = 0.05


class QueueSettings(Settings):
    """Jobs that wait while the cell works. They are lost with the lease, with a stop, and with the daemon.

    Attributes:
        max: most jobs that wait; a further one is refused.
    """

    max: Annotated[int, Field(ge=0, le=1000)] = 16


class SimSettings(Settings):
    """The simulated cell (MuJoCo).

    Attributes:
        pace: 0 = as fast as possible, in lockstep; 1 = real time.
        friction: sliding friction of the finger pads on objects.
        objects: folder of ``<name>/object.xml`` MJCF objects, and of meshes ``<name>.obj``, ``.stl`` or ``.ply`` in
            metres; None = the paper's five, built in.
        board: the calibration board lies on the table, and no object does.
        mounting_error_mm, mounting_error_deg: distance and angle of the true camera pose from the station's, in a
            seeded direction.
        clutter: 0 = every cycle brings one object; n = the pick region is filled once, with n.
        heaped: they are dropped, and lie on one another; otherwise they lie apart, of which far fewer fit.
    """

    pace: Annotated[float, Field(ge=0, le=10)] = 0.0
    friction: NonNegative = 0.8
    seed: int = 0
    objects: SystemPath | None = None
    clutter: Annotated[int, Field(ge=0, le=30)] = 0
    heaped: bool = False
    board: bool = False
    mounting_error_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    mounting_error_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    depth_noise: NonNegative = 1.0
    """Scale of the Femto Mega noise model; 0 = perfect depth."""

    @model_validator(mode="after")
    def _heaps_are_of_something(self) -> SimSettings:
        if self.heaped and self.clutter == 0:
            raise ValueError("heaped says how the objects of clutter lie: set clutter to their number")
        return self


class Station(Settings):
    """The complete configuration of one cell."""

    cell_id: Chunk = "sim"
    bus: BusSettings = BusSettings()
    recording: RecordingSettings = RecordingSettings()
    nodes: dict[Chunk, NodeSettings] = Field(min_length=1)
    camera: CameraSettings = CameraSettings()
    capture: CaptureSettings = CaptureSettings()
    robot: RobotSettings | None = None
    arm: ArmSettings = ArmSettings()
    hand: HandSettings = HandSettings()
    scene: SceneSettings = SceneSettings()
    perception: PerceptionSettings = PerceptionSettings()
    planning: PlanningSettings = PlanningSettings()
    execute: ExecuteSettings = ExecuteSettings()
    verify: VerifySettings = VerifySettings()
    retry: RetrySettings = RetrySettings()
    queue: QueueSettings = QueueSettings()
    manual: ManualSettings = ManualSettings()
    sim: SimSettings = SimSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    fr3: Fr3Settings = Fr3Settings()
    panda_hand: PandaHandSettings = PandaHandSettings()
    femto_mega: FemtoMegaSettings = FemtoMegaSettings()
    faults: FaultSettings = FaultSettings()
    http: HttpSettings = HttpSettings()
    opcua: OpcuaSettings = OpcuaSettings()

    @model_validator(mode="after")
    def _every_device_served_once(self) -> Station:
        served = [device for node in self.nodes.values() for device in node.serves]
        if sorted(served) != ["arm", "camera", "hand"]:
            raise ValueError(f"nodes must serve camera, arm and hand exactly once each; they serve {sorted(served)}")
        return self

    @model_validator(mode="after")
    def _describes_the_arm_that_is_there(self) -> Station:
        if self.robot is not None and any(node.driver == "fr3" for node in self.nodes.values()):
            raise ValueError("robot describes another arm than the driver fr3's: leave [robot] out")
        return self

    @model_validator(mode="after")
    def _captures_within_the_joints_range(self) -> Station:
        if self.robot is None and "capture_q_rad" not in self.arm.model_fields_set:
            return self  # the default is the FR3's, and checking it would import NumPy
        q, range_ = numpy.array(self.arm.capture_q_rad), limits_of(self)
        if len(q) != range_.joints:
            raise ValueError(f"arm.capture_q_rad has {len(q)} numbers, and the arm {range_.joints} joints")
        beyond = range_.outside(q) or range_.stuck(q)
        if beyond is not None:
            raise ValueError(f"arm.capture_q_rad: {beyond}")
        return self

    @model_validator(mode="after")
    def _feels_before_the_reflex(self) -> Station:
        reflex_n = min(self.fr3.collision_wrench[:3])
        if self.execute.contact_n >= reflex_n:
            raise ValueError(f"execute.contact_n must be below the arm's reflex, fr3.collision_wrench ({reflex_n:g} N)")
        return self

    @property
    def simulated(self) -> bool:
        """Whether a node stands in for real devices."""
        return any(node.driver == "sim" for node in self.nodes.values())

    @property
    def is_simulation(self) -> bool:
        """True when every device is simulated, and every process is on this machine."""
        bus = self.bus
        is_here = is_loopback(bus.endpoint) and bus.listen is None and bus.router is None
        return is_here and all(node.driver == "sim" for node in self.nodes.values())

    @property
    def silence_s(self) -> float:
        """Longest silence of the sender of motions (``bus.silence_s``); longer where simulated time is not real."""
        is_timeless = self.sim.pace == 0 and all(node.driver == "sim" for node in self.nodes.values())
        return max(self.bus.silence_s, self.bus.stale_s) if is_timeless else self.bus.silence_s
