"""``python -m drivers.fr3 SOCKET BLOCK``: the control process of `drivers.fr3.arm`, with two inherited descriptors."""

import sys
from multiprocessing.connection import Connection

from drivers.fr3.loop import serve
from drivers.fr3.shared_state import SharedState

if __name__ == "__main__":
    sys.exit(serve(Connection(int(sys.argv[1])), SharedState(int(sys.argv[2]))))
