"""Settings of how a pick is planned, executed, verified and tried again."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bus.messages.execution import Witness
from config.base import (
    Fraction,
    JawSize,
    Metres,
    NonNegative,
    Positive,
    Seconds,
    Settings,
    Size,
    SizeOrNone,
)

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
    """Execution: what the arm feels on its way to a grasp.

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
        min_width_m: fingers that closed further hold nothing.
        max_width_loss_m: the width may fall by more only when it is steady in the hold: the object turned flush.
        min_load_n: less is held only when the object's place is seen empty: the arm cannot weigh a few grams.
        min_cleared_fraction: the object left its place when so much of it, of what is seen, is seen empty.
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
    min_width_m: JawSize = 0.004
    max_width_loss_m: JawSize = 0.006
    min_load_n: NonNegative = 0.15
    min_cleared_fraction: Fraction = 0.7
    look: Literal["always", "auto"] = "always"
    clear_load_n: NonNegative = 0.3
    clear_width_m: JawSize = 0.006
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
