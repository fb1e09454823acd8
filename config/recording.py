"""Settings of recordings: where they lie, and how long they are kept."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from pydantic import field_validator, model_validator
from pydantic_core import PydanticCustomError

from config.base import UNSHOWN, NonNegative, Positive, Settings, SystemPath, wrong


class RecordingSettings(Settings):
    """Folder and retention of the cycles' recordings.

    Attributes:
        folder: of the recordings, one subfolder a day; relative to where the cell is started.
        min_free_mb: below this free space the next cycle is refused.
        patience_s: a disk that takes longer for one message or the end of a file counts as lost (RECORDING).
        keep_gb: space for the recordings; 0 = the whole disk, until `min_free_mb` refuses the next cycle. A cell that
            picks all day records tens of GB. Beyond it the oldest successes are deleted; failures, oldest first too,
            only when no success is left, because they are the ones still worth studying.
        keep_free_gb: space that the disk keeps free; what is beyond goes as with `keep_gb`, whoever fills the disk. It
            must be more than `min_free_mb`, so that no cycle is refused. 0 = none.
        keep_days: a success is deleted when it is older; 0 = never.
        keep_failed_days: a failure is deleted when it is older; 0 = never.
        keep_labelled: what a person labelled or noted (`cell label`) is never deleted or trimmed.
        thin_after_days: a success that is older is trimmed: it loses its pictures, and can be shown, reported and
            counted, but not replayed; 0 = never.
        archive: what is deleted or trimmed is first copied below this address of any fsspec file system
            (``s3://bucket/cell-1``, ``file:///mnt/nas/cell-1``), read back and compared; "" = no copy. Needs
            `vlad-cell[archive]`. It holds no password: a recording shows its station.
    """

    folder: SystemPath = Path("recordings")
    min_free_mb: NonNegative = 500.0
    patience_s: Positive = 10.0
    keep_gb: NonNegative = 0.0
    keep_free_gb: NonNegative = 0.0
    keep_days: NonNegative = 0.0
    keep_failed_days: NonNegative = 0.0
    keep_labelled: bool = True
    thin_after_days: NonNegative = 0.0
    archive: str = ""

    @property
    def rules(self) -> dict[str, float]:
        """The settings that delete or trim anything, by their name; empty: nothing ever goes."""
        names = ("keep_gb", "keep_free_gb", "keep_days", "keep_failed_days", "thin_after_days")
        return {name: getattr(self, name) for name in names if getattr(self, name)}

    @field_validator("archive")
    @classmethod
    def _without_password(cls, address: str) -> str:
        if ":" in urlsplit(address).netloc.rpartition("@")[0]:
            raise PydanticCustomError(UNSHOWN, "a recording shows its station: leave the password to the environment")
        return address

    @model_validator(mode="after")
    def _deletes_before_it_refuses(self) -> RecordingSettings:
        if 0 < self.keep_free_gb * 1e3 <= self.min_free_mb:
            raise wrong("keep_free_gb", "must be more than min_free_mb, below which cycles are refused")
        return self
