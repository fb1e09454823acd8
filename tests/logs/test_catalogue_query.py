"""A person's own query, and what persons say of cycles."""

from __future__ import annotations

import csv
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from bus.errors import CatalogueError, ConfigError
from docs.catalogue_page import EXAMPLES
from logs.catalogue import Catalogue, open_catalogue
from logs.catalogue.ask import Answer, ask
from logs.catalogue.export import csv_lines, write_parquet
from logs.catalogue.fleet import ask_fleet
from logs.catalogue.labels import LABELS, Label, append, read_labels
from logs.catalogue.opening import open_store
from logs.catalogue.store import CATALOGUE

Record = Callable[..., Path]
MORNING, NOON = "20260101T080000000", "20260101T120000000"
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT"


@pytest.fixture
def catalogue(record: Record, tmp_path: Path) -> Iterator[Catalogue]:
    """Of one picked and one failed cycle; the second is labelled."""
    record(None, MORNING)
    record("plan", NOON, again="The best grasp is weak.")
    append(tmp_path, Label(cycle_id=NOON, at_ns=1, who="anna", label="bad"))
    append(tmp_path, Label(cycle_id=NOON, at_ns=2, who="ben", label="good", note="Only the light was off."))
    with open_catalogue(tmp_path) as opened:
        yield opened


def test_a_query_is_answered_with_names_and_rows(catalogue: Catalogue) -> None:
    answer = ask(catalogue, "SELECT code, count(*) AS n, avg(json_extract(terms, '$.flat')) FROM cycles GROUP BY code")
    assert answer.columns[:2] == ("code", "n")
    assert answer.rows == [("", 1, 0.9), ("NO_GRASP", 1, None)]


def test_what_a_json_column_holds_can_be_taken_apart(catalogue: Catalogue) -> None:
    sql = "SELECT j.key, j.value FROM cycles, json_each(rejected_codes) AS j"
    sql += " UNION SELECT 'n', count(*) FROM json_tree('[1]')"
    assert ask(catalogue, sql).rows == [("COLLISION", 1), ("n", 2)]


@pytest.mark.parametrize(
    "sql",
    [
        "DELETE FROM cycle",
        "UPDATE cycle SET code = ''",
        "CREATE TABLE mine (x)",
        "DROP VIEW cycles",
        "ATTACH DATABASE '/etc/passwd' AS other",
        "PRAGMA journal_mode = DELETE",
        "PRAGMA query_only = OFF",
        "VACUUM INTO 'copy.sqlite'",
        "BEGIN EXCLUSIVE",
        "SELECT load_extension('evil')",
        "SELECT 1; DELETE FROM cycle",
        "SELECT * FROM nothing",
        "SELECT randomblob(1000000000)",
        "SELEC",
        "",
        "SELECT '\ud800'",
        "SELECT 1\0",
    ],
)
def test_what_does_more_than_read_is_refused_and_changes_nothing(catalogue: Catalogue, sql: str) -> None:
    before = ask(catalogue, "SELECT * FROM cycles").rows
    with pytest.raises(CatalogueError):
        ask(catalogue, sql)
    assert ask(catalogue, "SELECT * FROM cycles").rows == before
    assert not Path("copy.sqlite").exists()


def test_a_query_ends_in_its_time_and_with_so_many_rows(catalogue: Catalogue) -> None:
    with pytest.raises(CatalogueError, match=r"longer than 0.05 s. Ask for less, or raise --seconds"):
        ask(catalogue, f"{ENDLESS} count(*) FROM n", max_s=0.05)
    with pytest.raises(CatalogueError, match=r"more than 10 rows. Add a LIMIT, or raise --rows"):
        ask(catalogue, f"{ENDLESS} i FROM n", max_rows=10)


def test_a_catalogue_in_memory_is_asked_in_the_same_way(record: Record, tmp_path: Path) -> None:
    record(None, MORNING)
    (tmp_path / ".catalogue.lock").mkdir()
    with open_catalogue(tmp_path) as catalogue:
        for _ in range(2):
            assert ask(catalogue, "SELECT result FROM cycles").rows == [("SUCCESS",)]
        with pytest.raises(CatalogueError, match="more than read"):
            ask(catalogue, "DELETE FROM cycle")
    assert not (tmp_path / CATALOGUE).exists()


@pytest.mark.parametrize(("answers", "sql"), EXAMPLES, ids=[answers for answers, _ in EXAMPLES])
def test_every_example_of_the_page_is_answered(catalogue: Catalogue, answers: str, sql: str) -> None:
    assert ask(catalogue, sql).columns
    assert ask(catalogue, sql).rows or "bad" in answers, "the label of the last word is good"


# --- export -----------------------------------------------------------------------------------------------------------

ANSWER = Answer(("code", "n"), [("NO_GRASP", 1.5), ('say "no",\nthen', None)])


def test_csv_comes_back_as_it_was() -> None:
    assert list(csv.reader(csv_lines(ANSWER))) == [["code", "n"], ["NO_GRASP", "1.5"], ['say "no",\nthen', ""]]


def test_parquet_comes_back_as_it_was(tmp_path: Path) -> None:
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    for answer in (ANSWER, Answer(("code",), [])):
        write_parquet(answer, tmp_path / "a.parquet")
        rows = [tuple(row.values()) for row in parquet.read_table(tmp_path / "a.parquet").to_pylist()]
        assert rows == answer.rows
    in_a_new_folder = tmp_path / "exports" / "hall-1" / "a.parquet"
    write_parquet(Answer(("mixed",), [(1,), ("one",)]), in_a_new_folder)
    assert parquet.read_table(in_a_new_folder).to_pylist() == [{"mixed": "1"}, {"mixed": "one"}]


def test_without_pyarrow_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logs.catalogue.export.pyarrow", _Lacking())
    with pytest.raises(ConfigError, match=r"vlad-cell\[export\]"):
        write_parquet(ANSWER, tmp_path / "a.parquet")


class _Lacking:
    def __getattr__(self, name: str) -> Any:
        raise ImportError(name)


# --- labels -----------------------------------------------------------------------------------------------------------


def test_the_last_word_of_a_person_counts_and_all_are_kept(catalogue: Catalogue, tmp_path: Path) -> None:
    assert ask(catalogue, "SELECT cycle_id, label, notes FROM cycles ORDER BY 1").rows == [
        (MORNING, None, 0),
        (NOON, "good", 1),
    ]
    assert ask(catalogue, "SELECT who, label FROM labels ORDER BY at_ns").rows == [("anna", "bad"), ("ben", "good")]
    assert len((tmp_path / LABELS).read_text().splitlines()) == 2


def test_labels_outlive_the_catalogue_and_one_that_comes_later_is_found(catalogue: Catalogue, tmp_path: Path) -> None:
    (tmp_path / CATALOGUE).unlink()
    append(tmp_path, Label(cycle_id=MORNING, at_ns=3, who="anna", note="Slow."))
    with open_catalogue(tmp_path) as again:
        assert ask(again, "SELECT count(*) FROM labels").rows == [(3,)]


def test_a_line_that_a_power_cut_tore_is_left_out_and_ends_there(tmp_path: Path) -> None:
    first, last = (Label(cycle_id=NOON, at_ns=n, who="anna", note="ä\u2028\n") for n in (1, 2))
    path = append(tmp_path, first)
    path.write_bytes(path.read_bytes() + b'{"cycle_id": "2026')
    append(tmp_path, last)
    assert read_labels(tmp_path) == [first, last]


def test_labels_of_several_writers_are_whole(tmp_path: Path) -> None:
    def write(who: str) -> None:
        for number in range(10):
            append(tmp_path, Label(cycle_id=NOON, at_ns=number, who=who))

    writers = [threading.Thread(target=write, args=(who,)) for who in ("anna", "ben")]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [one.at_ns for one in read_labels(tmp_path) if one.who == "ben"] == list(range(10))
    with closing(open_store(tmp_path)) as store:
        store.copy_labels()
        assert store.connection.execute("SELECT count(*) FROM labels").fetchone() == (20,)


# --- several cells ----------------------------------------------------------------------------------------------------


def _export(catalogue: Catalogue, path: Path, cell_id: str, columns: str = "*") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    answer = ask(catalogue, f"SELECT {columns} FROM cycles")
    place = answer.columns.index("cell_id")
    write_parquet(Answer(answer.columns, [(*row[:place], cell_id, *row[place + 1 :]) for row in answer.rows]), path)
    return path


def test_the_exports_of_several_cells_are_one_table(catalogue: Catalogue, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    exports = tmp_path / "exports"
    for cell_id in ("hall-1", "hall-2"):
        _export(catalogue, exports / cell_id / "2026-01-01.parquet", cell_id)
    _export(catalogue, exports / "hall-2" / "2026-01-01-again.parquet", "hall-2")
    older = _export(catalogue, tmp_path / "older.parquet", "hall-3", "cell_id, cycle_id, result")
    sql = "SELECT cell_id, count(*) AS n, sum(result = 'SUCCESS'), sum(score IS NULL) FROM cycles GROUP BY 1"
    answer = ask_fleet([exports, older], sql)
    assert answer.rows == [("hall-1", 2, 1, 1), ("hall-2", 2, 1, 1), ("hall-3", 2, 1, 2)]
    one = ask_fleet([exports], f"SELECT * FROM cycles WHERE cell_id = 'hall-1' AND cycle_id = '{MORNING}'")
    alone = ask(catalogue, f"SELECT * FROM cycles WHERE cycle_id = '{MORNING}'")
    place = alone.columns.index("cell_id")
    assert one.columns == alone.columns and one.rows[0][place + 1 :] == alone.rows[0][place + 1 :]


def test_what_is_no_export_of_a_cell_is_refused_by_name(catalogue: Catalogue, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    with pytest.raises(CatalogueError, match="no Parquet file below"):
        ask_fleet([tmp_path], "SELECT 1")
    (tmp_path / "torn.parquet").write_bytes(b"PAR1")
    with pytest.raises(CatalogueError, match=r"torn\.parquet cannot be read"):
        ask_fleet([tmp_path], "SELECT 1")
    write_parquet(ask(catalogue, "SELECT cycle_id FROM cycles"), tmp_path / "torn.parquet")
    with pytest.raises(CatalogueError, match="no column cell_id"):
        ask_fleet([tmp_path], "SELECT 1")
    whose = _export(catalogue, tmp_path / "whole.parquet", "hall-1")
    with pytest.raises(CatalogueError, match="does more than read"):
        ask_fleet([whose], "DELETE FROM cycles")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"x": [[1, 2]]}, "has a value that is no number, text or bytes"),
        ({"x": [2**63]}, "has a value that is no number, text or bytes"),
        ({"x": [1], "X": [2]}, "cannot tell the columns x and X apart. Rename one"),
        ({f"c{number}": [1] for number in range(2001)}, "are no table: too many columns"),
    ],
    ids=["a list", "beyond 64 bits", "names that differ in case", "too many columns"],
)
def test_what_no_catalogue_holds_is_refused_by_name(columns: dict[str, list[Any]], words: str, tmp_path: Path) -> None:
    pyarrow: Any = pytest.importorskip("pyarrow")
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    made = {"cell_id": ["hall-1"], "cycle_id": [MORNING], **columns}
    arrays = [pyarrow.array(one, pyarrow.uint64() if one == [2**63] else None) for one in made.values()]
    parquet.write_table(pyarrow.table(arrays, names=list(made)), tmp_path / "strange.parquet")
    with pytest.raises(CatalogueError, match=rf"strange\.parquet.*{words}") as refusal:
        ask_fleet([tmp_path], "SELECT * FROM cycles")
    assert "cell query" in refusal.value.advice


def test_two_files_whose_columns_differ_in_case_are_refused_by_name(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    for name in ("x", "X"):
        write_parquet(Answer(("cell_id", "cycle_id", name), [("hall-1", MORNING, 1)]), tmp_path / f"{name}.parquet")
    with pytest.raises(CatalogueError, match=r"x\.parquet: SQL cannot tell the columns X and x apart"):
        ask_fleet([tmp_path], "SELECT * FROM cycles")


def test_a_file_whose_body_is_damaged_is_refused_by_name(catalogue: Catalogue, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    damaged = _export(catalogue, tmp_path / "damaged.parquet", "hall-1")
    content = bytearray(damaged.read_bytes())
    content[4:2000] = b"\xff" * 1996  # the end, which names the columns, stays whole
    damaged.write_bytes(content)
    with pytest.raises(CatalogueError, match=r"damaged\.parquet cannot be read"):
        ask_fleet([damaged], "SELECT * FROM cycles")
