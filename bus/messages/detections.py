"""The result of detect: ranked grasps and their evidence, the models' replies among it."""

from __future__ import annotations

from typing import Literal

from bus.arrays import Blob, ColorImage, Mask, Points, Transform, Vector3
from bus.codes import Code
from bus.frozen import Message
from bus.messages.grasps import Grasp, Rectangle
from bus.messages.scene import ObservedScene, Tried


class Usage(Message):
    """Token use of one call of a hosted model, as its provider counts it, and its price.

    Attributes:
        input_tokens, output_tokens, reasoning_tokens: sent, received, and of the received those that nobody reads.
        cost_usd: price of the call.
        is_complete: the provider reported every figure; else tokens and price are lower bounds.
    """

    input_tokens: int = 0
    output_tokens: int = 0
    reasoning_tokens: int = 0
    cost_usd: float = 0.0
    is_complete: bool = True


class ModelReply(Message):
    """One call of a goal-image model, or of another package's detector: request and reply.

    It is published as it happens, so that failed calls are kept too.

    Attributes:
        usage: tokens and price.
        step, sample: place in the imagination stage; ``sample`` counts the proposals from 0. ``detect``: a detector;
            ``begin``: a goal-image model that failed before it was asked anything.
        model: name of the model. ``prompt``: the complete text sent.
        text: the reply's text. ``image_png``: the reply's image, unchanged.
        failure, text_of_failure: code and reason when no usable reply came; then a model's text and image are empty.
        attempts: how often it was called. ``latency_s``: from the first attempt to the reply.
    """

    step: Literal["begin", "locate", "reason", "direct", "render", "detect"]
    sample: int = 0
    model: str
    prompt: str
    text: str = ""
    image_png: Blob | None = None
    failure: Code | None = None
    text_of_failure: str = ""
    usage: Usage = Usage()
    attempts: int = 1
    latency_s: float = 0.0


class Drift(Message):
    """The departure of the goal image from the parts it must keep (hosted models treat masks as advisory).

    Attributes:
        changed_outside: share of the background whose colour changed.
        other_objects: area of new other regions, as a share of the object's.
        silhouette_iou: overlap of the imagined object's outline with the observed one, after registration.
        shift_px, turn_rad, scale: that registration.
        color_shift: CIE76 distance of the object's median colours.
    """

    changed_outside: float
    other_objects: float
    silhouette_iou: float
    shift_px: float
    turn_rad: float
    scale: float
    color_shift: float


class Alignment(Message):
    """The transform from the imagined object to the observed one (paper, Algorithm 1, stage 2), and its quality.

    Attributes:
        method: e.g. ``silhouette_3d``; ``painted``: the model painted into the observed image, so nothing has moved.
        observed_from_goal: (4, 4) in the colour frame: rotation x scale and translation [m]; where the method allows
            for it, also a stretch along the goal's optical axis (monocular relief is unreliable).
        scale: its scale.
        chamfer_m2: sum of the two mean squared nearest-neighbour distances after alignment.
        goal_to_observed_m, observed_to_goal_m: the one-way Hausdorff distances.
        residual: two-way mean distance, the worst 15 % left out, as a share of the object's rms radius.
        hypotheses: how many orientations were tried. ``took_s``: wall time.
    """

    method: str
    observed_from_goal: Transform
    scale: float
    chamfer_m2: float
    goal_to_observed_m: float
    observed_to_goal_m: float
    residual: float
    hypotheses: int
    took_s: float


class Evidence(Message):
    """The intermediate results that lead to the grasps, for display and for the report.

    Images are in the undistorted colour image; points in the ``color`` frame [m]. Of several proposals these belong to
    the chosen one.

    Attributes:
        color: (H, W, 3) what the camera saw.
        object_mask: (H, W) the thing. ``goal_object_mask``, ``goal_rod_mask``: thing and rod in the goal image.
        observed_points: (n, 3) the seen surface of the thing. ``goal_points``, ``rod_points``: thing and rod lifted
            from the goal image.
        aligned_points: (n, 3) `goal_points` carried into the observed scene.
        rod_ends: (3,) each, of the rod's axis, carried into the observed scene.
        alignment: how they were carried. ``drift``: what the goal image changed that it must keep.
        goal_image: I_G on its plain background.
        sample: index of the chosen proposal. ``agreement``: share of the proposals whose rod grasps at the same place
            (their rectangles match as in Jiang et al. 2011); 1 with a single one.
    """

    color: ColorImage
    object_mask: Mask
    goal_image: ColorImage
    goal_object_mask: Mask
    goal_rod_mask: Mask
    observed_points: Points
    goal_points: Points
    aligned_points: Points
    rod_points: Points
    rod_ends: tuple[Vector3, Vector3]
    alignment: Alignment
    drift: Drift
    sample: int
    agreement: float


class Detections(Message):
    """detect: ranked grasps, best first, and the evidence.

    Attributes:
        rectangles, grasps: of every proposal that survived; ``evidence``: of the one with the best grasp.
        scene: what was seen. ``tried``: every rod that was imagined, in order; of another package's detector, every
            thing that it found grasps on.
        detector: name of the other package's detector that gave the grasps; "" = ours. Then the evidence's rod is
            drawn along the best grasp's closing axis.
    """

    rectangles: tuple[Rectangle, ...]
    grasps: tuple[Grasp, ...]
    evidence: Evidence
    scene: ObservedScene
    tried: tuple[Tried, ...]
    detector: str = ""
