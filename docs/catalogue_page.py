"""Writes docs/catalogue.md from the columns of the catalogue: ``uv run python -m docs.catalogue_page``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from logs.catalogue.ask import MAX_ROWS, MAX_S
from logs.catalogue.columns import FILE_COLUMNS, GROUPS, LABEL_COLUMNS
from logs.catalogue.figures import DEFINITIONS

PAGE = Path(__file__).with_name("catalogue.md")
EXAMPLES: tuple[tuple[str, str], ...] = (
    ("How often each code", "SELECT code, count(*) AS n FROM cycles GROUP BY code ORDER BY n DESC"),
    (
        "Success by day",
        "SELECT day, count(*) AS picks, avg(result = 'SUCCESS') AS success FROM cycles"
        " WHERE retried_as = '' AND result <> 'EMPTY' GROUP BY day",
    ),
    ("Which configuration does better", "SELECT station_hash, count(*), avg(held) FROM cycles GROUP BY station_hash"),
    (
        "Where the time goes",
        "SELECT avg(capture_s), avg(detect_s), avg(plan_s), avg(execute_s), avg(verify_s) FROM cycles",
    ),
    (
        "Does a better score hold better?",
        "SELECT round(score, 1) AS score, count(*), avg(held) FROM cycles WHERE executed GROUP BY 1",
    ),
    (
        "Why ways to grasp were rejected",
        "SELECT j.key AS code, sum(j.value) AS ways FROM cycles, json_each(rejected_codes) AS j"
        " GROUP BY 1 ORDER BY 2 DESC",
    ),
    (
        "One term of the score, held or not",
        "SELECT held, avg(json_extract(terms, '$.central')) FROM cycles WHERE executed GROUP BY held",
    ),
    ("What the models cost", "SELECT day, model, sum(model_calls), sum(cost_usd) FROM cycles GROUP BY day, model"),
    (
        "What people called bad, and what the cell thought",
        "SELECT cycle_id, result, score, load_n, reason FROM cycles WHERE label = 'bad' ORDER BY started_ns DESC",
    ),
    (
        "The slowest looks, with their recordings",
        "SELECT file, looks, looked_again, detect_s FROM cycles WHERE looks > 1 ORDER BY detect_s DESC LIMIT 20",
    ),
)
"""The question, and the query."""


def page() -> str:
    """The page's text."""
    return "\n".join([_HEAD, *_figures(), *_examples(), *_fleet(), *_columns(), ""])


def _figures() -> Iterator[str]:
    yield from ("## Figures", "", _FIGURES, "", "| figure | what it is |", "|---|---|")
    yield from (f"| `{name}` | {meaning} |" for name, meaning in DEFINITIONS.items())
    yield ""


def _examples() -> Iterator[str]:
    yield from ("## Ask it", "", _ASK, "")
    for number, (answers, sql) in enumerate(EXAMPLES, 1):
        yield from (f"{number}. {answers}:", "", "   ```sql", f"   {sql}", "   ```", "")


def _fleet() -> Iterator[str]:
    yield from ("## Ask several cells", "", _FLEET, "")


def _columns() -> Iterator[str]:
    yield from ("## Columns of `cycles`", "", _COLUMNS, "")
    for title, columns in GROUPS:
        yield from (f"### {title}", "", "| column | type | unit | what |", "|---|---|---|---|")
        yield from (f"| `{one.name}` | {one.type} | {one.unit} | {one.meaning} |" for one in columns)
        yield ""
    yield from ("### The recording", "", "| column | type | what |", "|---|---|---|")
    yield from (f"| `{name}` | {kind} | {meaning} |" for name, kind, meaning in FILE_COLUMNS)
    yield from ("", "### What people said of it", "", "| column | type | what |", "|---|---|---|")
    yield from (f"| `{name}` | {kind} | {meaning} |" for name, kind, meaning in _SAID)
    yield from ("", "## Columns of `labels`", "", "Every label, in the order in which they were given.", "")
    yield from ("| column | type | what |", "|---|---|---|")
    yield from (f"| `{name}` | {kind} | {meaning} |" for name, kind, meaning in LABEL_COLUMNS)


_FLEET = """Each cell exports its rows, a file a day, to where all of them lie; its `cell_id` is in every row:

```
uv run cell query "SELECT * FROM cycles WHERE day = '2026-11-28'" --parquet exports/hall-1/2026-11-28.parquet
uv run cell query "SELECT cell_id, avg(result = 'SUCCESS') AS success FROM cycles GROUP BY 1" --fleet exports/
```

`--fleet` takes files and folders, and may be repeated. Only the columns that the query names are read, into memory: a
million cycles are some seconds. A cell of an older version lacks newer columns: they are NULL. A cycle that is in two
files counts once, as the later name has it; `label` is what was said before the export. For more than memory holds, any
column store reads the same files: `SELECT ... FROM read_parquet('exports/*/*.parquet', union_by_name = true)` in
DuckDB."""

_SAID = (
    ("label", "TEXT", "The last `good` or `bad`; NULL: none."),
    ("notes", "INTEGER", "How many notes."),
)
_HEAD = """\
# The catalogue of recorded cycles

<!-- Written by docs/catalogue_page.py from logs/catalogue/columns.py; do not edit. -->

`catalogue.sqlite`, beside the recordings, has one row a cycle: how it ended, what was measured in every stage, what
it ran with. The daemon writes it when a cycle's recording is closed; `cell cycles`, the page of a day and `cell
query` read it, also while the cell runs. `cell cycles --summary` gives the figures below.

It is derived from the recordings and loses nothing they hold: delete it, and the next reader makes it anew. So it
does with one that is damaged (kept as `.damaged`) or of another version of this program (kept as `.older`). What the
recordings lack comes in as soon as it is read; a file that was overwritten in place, by `cell catalogue rebuild`.
Where the folder cannot be written, the catalogue is made in memory, and that is said. It belongs on a local disk,
like every SQLite file in WAL mode.

Lists are sorted by the time of the cycle's id. A time that is still to come, as after the machine's clock was set back,
counts as the oldest: what the cell records now is the newest.

What the cell or `cell prune` deletes keeps its row: `deleted_ns` says when, `deleted_by` by which setting, `archived`
where its whole recording is. It is counted in all figures, and left out of lists of what can be opened. The truth of it
is `deleted.jsonl` beside the recordings: a line each, written before the recording goes, with its row, and only ever
appended; keep it, for nothing else knows these cycles. A recording that a person deletes takes its row along; one that
comes back from an archive is there again.

`cell label CYCLE good|bad|NOTE` says what a person thinks of a cycle. Labels are lines of `labels.jsonl` beside the
recordings, with who and when; they are only ever appended, `cell show` shows them, and the catalogue has a copy.
"""
_FIGURES = "Of `cell cycles --summary [--day DAY] [--json]`, and in Python `logs.catalogue.summary(folder, day)`:"
_ASK = f"""\
`cell query "SELECT ..."` prints a table; `--json` an object a row, `--csv` CSV, `--parquet FILE` writes Parquet, for
which `vlad-cell[export]` must be installed. A query only reads: anything else is refused, and so is what takes longer
than {MAX_S:g} s (`--seconds`) or has more than {MAX_ROWS} rows (`--rows`). What is JSON is taken apart by
`json_extract` and `json_each`."""
_COLUMNS = "SI units. NULL: the cycle did not come so far, or its recording is older than that figure."

if __name__ == "__main__":
    PAGE.write_text(page())
