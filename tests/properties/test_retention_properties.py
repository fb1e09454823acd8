"""What is kept: never more than the rule allows where it can be helped, and failures longest."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from config.recording import RecordingSettings
from logs.mcap.retention import DAY_NS, GB, Plan, Recorded, plan_retention

NOW_NS = 1_800_000_000 * 10**9
FILES = st.lists(
    st.builds(
        Recorded,
        path=st.uuids().map(lambda one: Path(str(one))),
        bytes=st.integers(0, 3 * 10**8),
        stamp_ns=st.integers(NOW_NS - 10 * DAY_NS, NOW_NS),
        result=st.sampled_from(["SUCCESS", "EMPTY", "FAILED", "ABORTED", "INTERRUPTED", ""]),
        is_pinned=st.sampled_from([False, False, False, True]),
    ),
    max_size=20,
    unique_by=lambda file: file.stamp_ns,
)
RULES = st.builds(
    RecordingSettings,
    keep_gb=st.just(0.0) | st.floats(0.01, 4.0),
    keep_days=st.just(0.0) | st.floats(0.1, 12.0),
)


def _gone(files: list[Recorded], rule: RecordingSettings) -> list[Recorded]:
    return [one.file for one in plan_retention(files, NOW_NS, rule).delete]


def _left(files: list[Recorded], rule: RecordingSettings) -> list[Recorded]:
    gone = set(_gone(files, rule))
    return [file for file in files if file not in gone]


def _bytes(files: list[Recorded]) -> int:
    return sum(file.bytes for file in files)


@given(FILES)
def test_without_a_rule_nothing_goes_ever(files: list[Recorded]) -> None:
    assert plan_retention(files, NOW_NS, RecordingSettings()) == Plan()


@given(FILES, RULES)
def test_what_is_pinned_and_the_newest_stay(files: list[Recorded], rule: RecordingSettings) -> None:
    left = _left(files, rule)
    assert all(file in left for file in files if file.is_pinned)
    free = [file for file in files if not file.is_pinned]
    assert not free or max(free, key=lambda file: file.stamp_ns) in left


@given(FILES, RULES)
def test_no_failure_goes_while_a_success_is_left_to_go(files: list[Recorded], rule: RecordingSettings) -> None:
    gone = _gone(files, rule)
    left = [file for file in _left(files, rule) if not file.is_pinned]
    newest_ns = max((file.stamp_ns for file in files if not file.is_pinned), default=0)
    if any(not file.is_fine for file in gone):
        assert not any(file.is_fine and file.stamp_ns < newest_ns for file in left)
        assert rule.keep_gb > 0
    for alike in (True, False):  # of each kind the oldest first
        ages_ns = [file.stamp_ns for file in gone if file.is_fine is alike]
        kept_ns = [file.stamp_ns for file in left if file.is_fine is alike]
        assert not ages_ns or not kept_ns or max(ages_ns) < min(kept_ns)


@given(FILES, RULES)
def test_as_much_goes_as_must_and_not_one_more(files: list[Recorded], rule: RecordingSettings) -> None:
    gone, left = _gone(files, rule), _left(files, rule)
    if rule.keep_gb and _bytes(left) > rule.keep_gb * GB:
        assert sum(not file.is_pinned for file in left) <= 1, "nothing that may go is left"
    if gone and not rule.keep_days:
        assert _bytes(left) + gone[-1].bytes > rule.keep_gb * GB
    if rule.keep_days and not rule.keep_gb:
        assert all(NOW_NS - file.stamp_ns > rule.keep_days * DAY_NS and file.is_fine for file in gone)


@given(FILES, RULES)
def test_what_was_tidied_is_tidy(files: list[Recorded], rule: RecordingSettings) -> None:
    assert plan_retention(_left(files, rule), NOW_NS, rule).delete == ()


@given(FILES, RULES)
def test_what_is_said_a_day_ahead_is_another_thing_than_what_goes_now(
    files: list[Recorded], rule: RecordingSettings
) -> None:
    plan = plan_retention(files, NOW_NS, rule)
    now, soon = ({one.file for one in due} for due in (plan.delete, plan.soon))
    assert not now & soon
    assert {one.file for one in plan_retention(files, NOW_NS + DAY_NS, rule).delete} <= now | soon


@given(FILES, RULES, st.integers(0, 10**10))
def test_the_disk_keeps_its_free_space_or_it_is_said_why_not(
    files: list[Recorded], rule: RecordingSettings, free_bytes: int
) -> None:
    rule = rule.model_copy(update={"keep_free_gb": 2.0})
    plan = plan_retention(files, NOW_NS, rule, free_bytes)
    free_then = free_bytes + _bytes([one.file for one in plan.delete])
    assert free_then >= 2 * GB or plan.short


@given(FILES, RULES, st.floats(0.1, 12.0))
def test_only_old_successes_that_stay_are_trimmed_and_once(
    files: list[Recorded], rule: RecordingSettings, days: float
) -> None:
    rule = rule.model_copy(update={"thin_after_days": days})
    files = [file._replace(is_thin=file.bytes % 2 == 1) for file in files]
    plan = plan_retention(files, NOW_NS, rule)
    thin = [one.file for one in plan.thin]
    assert not {*thin} & {one.file for one in plan.delete}
    assert all(file.is_fine and not file.is_thin and not file.is_pinned for file in thin)
    assert all(NOW_NS - file.stamp_ns > days * DAY_NS for file in thin)
