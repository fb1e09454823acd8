"""Settings of the search for grasps: the goal-image model, segmentation, alignment, targets."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from config.base import (
    UNSHOWN,
    FolderOrName,
    Fraction,
    JawSize,
    JawSizeOrNone,
    NoBoolean,
    NonNegative,
    Positive,
    Seconds,
    Settings,
    SystemPath,
)
from config.target import Label, TargetSettings


class ImagineSettings(Settings):
    """Request of the goal image (paper, section III-A)."""

    steps: Annotated[Literal[1, 3], NoBoolean] = 3
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
    """Of what is sent: the words, and the pictures in tokens."""
    usd_per_million_output_tokens: NonNegative = 0.0
    """Of what comes back as words."""
    usd_per_image: NonNegative = 0.0
    """Of a goal image."""


class HostedSettings(Settings):
    """A hosted model. Keys come from the environment, or from a file outside the project.

    Attributes:
        text_model, image_model: the provider's ids; they expire within a year, so they have no defaults.
        base_url: another server with the same API; None = the provider's own.
        text_api: `responses` (OpenAI) or `chat` (supported by most OpenAI-compatible servers).
        key_variable: the environment variable that holds the key. ``key_file``: a file with the key, one line, not
            readable by others, outside of this folder and of every git work tree; it takes precedence.
        size_px: side of the square window around the object that is sent.
        deadline_s: of one call, all attempts included; of another package's goal-image model, too.
        attempts: most attempts of one call.
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
    """Share of the background whose colour changed."""
    max_other_objects: NonNegative = 0.2
    """Area of new things, as a share of the object's."""
    min_silhouette_iou: Fraction = 0.5
    """Overlap of the imagined object's outline with the observed one, where they fit best."""
    max_color_shift: NonNegative = 45.0
    """Distance of the object's median colours (CIE76)."""


class SamSettings(Settings):
    """SAM, SAM 2 or SAM 3: a folder or a hub id, and its device. Needs the extra ``vlad-cell[models]``."""

    weights: FolderOrName = "facebook/sam2.1-hiera-small"
    """A folder that ``save_pretrained`` wrote, or a hub id, which needs the network."""
    device: str = "cpu"
    """Of PyTorch: ``cpu``, ``cuda``."""


class SalientSettings(Settings):
    """A salient-object network of the U-2-Net family, which marks what stands out. Needs the extra ``vlad-cell[onnx]``.

    Attributes:
        path: its ``.onnx`` file; ``just salient`` fetches u2netp.onnx (4.6 MB).
    """

    path: SystemPath = Path("weights/u2netp.onnx")


class DepthProSettings(Settings):
    """Depth Pro: a folder or a hub id, and its device. Needs the extra ``vlad-cell[models]``."""

    weights: FolderOrName = "apple/DepthPro-hf"
    """A folder that ``save_pretrained`` wrote, or a hub id, which needs the network."""
    device: str = "cpu"
    """Of PyTorch: ``cpu``, ``cuda``."""


class OnnxSettings(Settings):
    """A network of the GG-CNN family; its tensors: `perception.rectangles.network`. Needs ``vlad-cell[onnx]``."""

    path: SystemPath = Path("grasp.onnx")
    """Its ``.onnx`` file."""


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
    """Carries the rod back from the goal image: ours by outline and depth, or the paper's by principal axes."""
    max_residual: Positive = 0.20
    """Alignment residual in rms radii: beyond it the goal shows another object (0.20 lets 95 % of true pairs pass)."""
    drift: DriftSettings = DriftSettings()
    compliance: Positive = 1.0
    """lambda: jaw opening of the rectangle = lambda x run length + 2 x margin."""
    rectangle_margin_m: JawSizeOrNone = 0.0
    """Free space of the opening on each side; 0 as in the paper."""
    min_object_height_m: JawSize = 0.006
    """A thing that rises less above the table is no object."""
    min_table_seen: Fraction = 0.7
    """Nothing on the table counts as an empty table only when this share of the pick region was seen."""
    rod_radius_m: JawSize = 0.004
    """Of the imagined rod, as it is asked for and painted."""
    max_grasps: Annotated[int, Field(ge=1, le=100)] = 12
    """Most grasps of a scene, the best ones; the plan takes the first that can be reached."""
    approach_clearance_m: JawSizeOrNone = 0.006
    """Extra opening on each side of the object while approaching."""
