"""The token that carries a stop down to what computes."""

from __future__ import annotations

import pytest

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.threads import OwnedThread, Role


def test_work_goes_on_until_the_stop() -> None:
    cancel = Cancel()
    cancel.raise_if_set("plan")
    cancel.set()
    with pytest.raises(CycleFailure, match="Stopped during 'plan'") as caught:
        cancel.raise_if_set("plan")
    assert caught.value.failure is Code.STOPPED and cancel.is_set


def test_a_pause_ends_with_the_stop_of_another_thread() -> None:
    cancel = Cancel()
    assert not cancel.wait(0.0)
    OwnedThread(Role.DETECT, cancel.set).start()
    assert cancel.wait(60)
