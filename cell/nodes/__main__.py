"""``python -m cell.nodes NAME``: a node as the daemon's child, without the imports of the command line."""

from __future__ import annotations

import logging
import os
import sys

from cell.nodes.child import serve_supervised
from cell.terminal.printing import log_plainly

if __name__ == "__main__":
    log_plainly()
    code = serve_supervised(sys.argv[1])
    logging.shutdown()
    os._exit(code)  # immediately: a thread inside MuJoCo or an SDK would abort the interpreter
