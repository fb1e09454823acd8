"""The Franka Hand's dimensions along and across its approach axis, for planning, perception, simulation and views.

Source: franka_description's URDF and collision meshes, and the Franka Hand manual. What a station may have otherwise
(its jaw's width, its pads) is a setting: `config.schema.HandSettings`.
"""

from __future__ import annotations

HAND_FROM_TCP_M = 0.1034
"""From the hand's origin to the tcp, along the approach axis (URDF frame ``fr3_hand_tcp``)."""
FINGER_LENGTH_M = 0.0545
"""Of a finger, from its root to its tip; the root lies 0.0584 m before the hand's origin."""
FINGER_TIP_M = 0.0095
"""How far the finger tips reach beyond the tcp: 0.0584 + 0.0545 - 0.1034 m."""
FINGER_TIP_SIZE_M = (0.0175, 0.0152)
"""Finger tip across and along the closing axis, outward from the pad."""
PALM_ABOVE_TIP_M = 0.0465
"""The lowest of the hand's body above the finger tips, in the collision mesh."""
