"""Heaps of real shapes, and single hard things: scenes, a judge of grasps on the true shapes, and the figures of both.

Nothing here but `detectors` imports perception: scenes, judge and oracle share no code with what they measure.
"""

import drivers.sim  # noqa: F401  sets how MuJoCo renders, before MuJoCo is first imported
