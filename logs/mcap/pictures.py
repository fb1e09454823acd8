"""Takes the pictures out of recorded messages: decoding them takes longer than all the rest."""

from __future__ import annotations

import json
import re
from functools import cache

import numpy as np

from bus.packing import pack_image

_PICTURE = re.compile(rb'"(\w+)":\s*\{"png":\s*"[^"]*"\}')
_IN_COLOR = frozenset({b"color", b"goal_image"})


def without_pictures(payload: bytes) -> bytes:
    """Return the message (JSON) with a black pixel in place of every PNG that is a field of its own."""
    return _PICTURE.sub(lambda found: b'"%s":%s' % (found[1], _pixel(found[1] in _IN_COLOR)), payload)


@cache
def _pixel(is_in_color: bool) -> bytes:
    return json.dumps(pack_image(np.zeros((1, 1, 3) if is_in_color else (1, 1), np.uint8))).encode()
