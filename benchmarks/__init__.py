"""The benchmarks: ``uv run python -m benchmarks NAME --json``. All numeric libraries use one thread."""

import os

for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
