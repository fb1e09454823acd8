from pathlib import Path

from logs.reader import CycleRecord


def write_report(record: CycleRecord, path: Path) -> Path:
    return path
