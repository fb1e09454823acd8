"""What there is to measure: ``uv run python -m benchmarks NAME --json``. Everything runs on one thread."""

import os

for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
