"""What is read of a station is noted, so that a "what if?" can say that a setting could not matter."""

from __future__ import annotations

from config.base import Settings
from config.load import load_station, station_from
from config.reads import Reads, noted, unnoted


def test_a_setting_counts_as_read_by_whom_reads_it() -> None:
    station, reads = load_station(), Reads()
    with noted(station, reads):
        reads.reader = "detect"
        assert station.hand.max_width_m > 0
        reads.reader = "plan"
        assert station.hand.max_width_m > 0 and station.scene.table.size_m
    assert reads.of("hand.max_width_m") == ("detect", "plan")
    assert reads.of("hand.min_width_m") == (), "its table alone was on the way"
    assert reads.of("scene.table") == reads.of("scene") == ("plan",), "a part of it was read"


def test_whoever_takes_a_whole_table_may_read_all_of_it() -> None:
    for takes in (Settings.model_dump, Settings.model_dump_json, Settings.model_copy, hash):
        station, reads = load_station(), Reads()
        with noted(station, reads):
            takes(station.hand)
        assert reads.of("hand.max_width_m") and not reads.of("verify.look"), takes
    station, reads = load_station(), Reads()
    with noted(station, reads):
        assert station.nodes
        assert station.model_dump()
    assert reads.of("nodes.sim.driver") and reads.of("verify.look")


def test_a_property_counts_for_what_it_reads() -> None:
    station, reads = load_station(), Reads()
    with noted(station, reads):
        assert station.scene.table.top_m is not None
    assert reads.of("scene.table.center_m")


def test_other_stations_the_key_of_a_cache_and_what_comes_later_do_not_count() -> None:
    station, other, reads = load_station(), load_station(None, ["hand.max_width_m=0.07"]), Reads()
    with noted(station, reads):
        assert other.hand.max_width_m
        with unnoted():
            assert station.hand.max_width_m
    assert station.hand.max_width_m and reads.of("hand.max_width_m") == ()


def test_an_override_leaves_the_tree_as_it_is() -> None:
    tree = load_station().model_dump(mode="json")
    changed = station_from(tree, ["hand.max_width_m=0.03", "nodes.sim.run=here"])
    assert changed.hand.max_width_m == 0.03
    assert tree == load_station().model_dump(mode="json"), "a recording's station, and what is asked with it next"
